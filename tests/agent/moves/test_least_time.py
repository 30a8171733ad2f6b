"""The least time on observed moves: against another algorithm over the kernels that play them."""

import heapq
import os
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from agent.mdp import grid
from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.mdp.rng import seeded_state
from agent.moves import kernels
from agent.moves.model import ObservedMoves, UserError, build_model
from agent.moves.times import at_start, fastest_tables, least_times, mean_seconds
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from cosim.model.outcome import RUNNING, SUCCESS
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTIONS
from tests.agent.moves.test_pair import ONE_WAY, SECONDS, lasting

BOARD = Scenario(
    "board", "", ((1, 4),), (((5, 0), (4, 1)),), columns=6, rows=6, zone=(0, 0, 0, 0),
    robot_diameter_m=0.009,
)  # fmt: skip


def search(process, moves, cell, axis):
    """Least time from a cell and axis, forward over what the kernels make of moves."""
    model, rewards = build_model(moves, 0.9), np.zeros(1, dtype=np.float32)
    world, plans = np.zeros((1, grid.COLUMN_COUNT), np.int64), np.zeros((1, kernels.PLAN_SIZE))
    best, queue = {(cell, axis): 0}, [(0, cell, axis)]
    while queue:
        steps, cell, axis = heapq.heappop(queue)
        if cell == BOARD.targets[0]:
            return moves.rl_step_s * steps
        for direction in range(8):
            assert grid.place(process, world, np.array([cell]))
            kernels.reset_plans(model, world, plans, seeded_state(0))
            world[0, grid.AXIS], taken = axis, steps
            outcome = kernels.begin_move(
                process, model, world, plans, 0, direction, seeded_state(0)
            )
            while outcome == RUNNING and not kernels.waits(plans, 0):
                outcome, passed = kernels.step(process, model, world, plans, rewards)
                taken += passed
            reached = int(world[0, grid.X]), int(world[0, grid.Y])
            after = reached, direction % moves.facings
            if outcome in {RUNNING, SUCCESS} and taken < best.get(after, 1000):
                best[after] = taken
                heapq.heappush(queue, (taken, *after))
    return np.inf


# Of machines that drive sideways, too; backwards, too; and forwards only.
MACHINES = pytest.mark.parametrize("seconds", [SECONDS[2:6], SECONDS, ONE_WAY], ids=len)


@MACHINES
def test_it_is_what_a_search_over_the_kernels_finds(seconds):
    moves = lasting(*seconds)
    facings = moves.facings
    process = build_process(BOARD, ProcessConfig(), facings)
    found = least_times(process, moves)[0].reshape(6, 6, facings)
    cells = [(5, 0), (0, 0), (2, 3), (1, 5), (4, 4)]
    expected = [[search(process, moves, cell, axis) for axis in range(facings)] for cell in cells]
    assert [found[cell].tolist() for cell in cells] == expected
    assert np.unique(expected).size > 6  # where it faces matters


@MACHINES
def test_the_tables_of_the_fastest_lead_to_the_least_time(seconds):
    moves = lasting(*seconds)
    facings = moves.facings
    process = build_process(BOARD, ProcessConfig(features=("x", "y", "h")), facings)
    values, (tables, decided) = least_times(process, moves)[0], fastest_tables(process, moves)
    assert tables[0].max(axis=1)[decided[0]] == pytest.approx(-values.ravel()[decided[0]])
    assert not decided[0].reshape(6, 6, facings)[BOARD.targets[0]].any()
    features, none = ProcessConfig(features=("x", "y", "h")), LearningConfig()
    config = PolicyConfig(BOARD, features, none, Seed(0), moves, method="fastest")
    policy, _, path = find_or_make(config)
    assert isinstance(policy, Policy)
    os.utime(path, (0.0, 0.0))
    for again in (False, True):
        find_or_make(config, again=again)
        assert (path.stat().st_mtime > 0.0) == again
    seconds = mean_seconds(moves)
    for start in [(5, 0), (0, 5), (5, 5), (3, 1)]:
        cell, axis, taken = np.array([start]), (2 if start[1] < 3 else 6) % facings, 0.0
        expected = values.reshape(6, 6, facings)[(*start, axis)]
        assert at_start(process, values)[6 * start[0] + start[1]] == expected
        while tuple(cell[0]) != BOARD.targets[0]:
            row = int(np.ravel_multi_index((*cell[0], axis), (6, 6, facings)))
            direction = int(policy.values[0, row].argmax())
            taken += seconds[direction, axis]
            cell, axis = cell + DIRECTIONS[direction], direction % facings
        assert taken == pytest.approx(expected)


def test_obstacles_are_gone_around():
    wall = tuple((x, 3) for x in range(5))
    process = build_process(replace(BOARD, obstacles=wall), ProcessConfig())
    found = least_times(process, lasting(*[1.9] * 8))[0].reshape(6, 6, 4)
    assert found[0, 2].tolist() == [18.0] * 4  # five moves to the gap in the wall, and four back


def test_times_are_means_in_rl_steps():
    short, long = lasting(*[1.9] * 8), lasting(*[4.1] * 8)
    both = ObservedMoves("", 0, short.moves + long.moves)
    assert (mean_seconds(both) == 4.0).all()  # 1 RL step of 2 s, or 3


@pytest.mark.parametrize("change", [{"stop_x": 0.6}, {"direction": 1}])
def test_moves_that_say_too_little_are_refused(change):
    moves = lasting(*SECONDS)
    odd = msgspec.structs.replace(moves.moves[0], **change)
    with pytest.raises(UserError, match="moves"):
        mean_seconds(ObservedMoves("", 0, (odd, *moves.moves[1:])))
