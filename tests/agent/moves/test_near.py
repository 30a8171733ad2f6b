"""Clearances of computed plans: targets near each other, large robots, other cells, no path."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.moves.times import board_of
from agent.training.loop import learn, move_model
from agent.training.methods import METHODS
from agent.training.policy import GroupPolicy, PairPolicy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.model.outcome import Outcome
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTIONS, Observation
from tests.agent.moves.test_pair import BOARD, MOVES

PAIRS = ProcessConfig(features=("x", "y", "h", "p"))


def config(scenario, objective):
    joint = objective == "fastest" and scenario.robots == 2
    process = PAIRS if joint else ProcessConfig(features=("x", "y", "h"))
    moves = msgspec.structs.replace(MOVES, cell_m=scenario.cell_m)
    return PolicyConfig(scenario, process, LearningConfig(), Seed(0), moves, method=objective)


def made(given):
    compute = METHODS[given.method].compute
    assert compute is not None
    return compute(given)


def near(gap):
    targets = (2, 2), (2 + gap[0], 2 + gap[1])
    return replace(BOARD, name="near", targets=targets, starts=(((0, 7),), ((8, 8), (8, 0))))


@pytest.mark.parametrize("objective", ["fastest", "planned"])
@pytest.mark.parametrize("gap", [(5, 1), (5, 2), (5, 3), (4, 4)])
def test_robots_park_at_targets_that_are_near(gap, objective):
    policy = made(config(near(gap), objective))
    assert policy.evaluate().rate(Outcome.SUCCESS) == 1.0


def test_training_counts_no_contact_where_robots_park():
    for gap, contact_cells in (((5, 1), 0.5 * (5 + np.hypot(5, 1))), ((6, 0), 5.2)):
        process = ProcessConfig(features=("x", "y", "d", "g", "b"))
        model = move_model(PolicyConfig(near(gap), process, LearningConfig(), Seed(0), MOVES))
        assert model is not None
        assert np.sqrt(model.contact_cells) == pytest.approx(contact_cells)


@pytest.mark.parametrize(("diameter_m", "cell_m"), [(0.05, 0.01), (0.07, 0.01), (0.05, 0.02)])
def test_clearances_follow_diameter_and_cells(diameter_m, cell_m):
    scenario = Scenario(
        "sizes", "", ((0, 0), (9, 9)), (((9, 0),), ((0, 9),)), columns=10, rows=10,
        zone=(0, 0, 0, 0), robot_diameter_m=diameter_m, cell_m=cell_m,
    )  # fmt: skip
    process = build_process(scenario, PAIRS)
    kept_m = PairPolicy.computed(config(scenario, "fastest")).times.board.kept ** 0.5 * cell_m
    assert kept_m == pytest.approx(diameter_m + 0.0083)
    assert board_of(process, MOVES).kept ** 0.5 * cell_m == pytest.approx(kept_m)


@pytest.mark.parametrize("objective", ["fastest", "planned", None])
@pytest.mark.parametrize("robots", [1, 2])
def test_targets_that_cannot_be_reached_are_refused(robots, objective):
    board = Scenario(
        "walled", "", ((24, 10), (3, 3))[:robots], (((5, 7), (20, 8)), ((5, 16),))[:robots],
        30, 20, obstacles=tuple((14, y) for y in range(20)),
    )  # fmt: skip
    with pytest.raises(UserError, match="there is no path to"):
        if objective is None:
            learn(PolicyConfig(board, ProcessConfig(), LearningConfig(episodes=1), Seed(0)))
        else:
            made(config(board, objective))


def test_first_moves_of_plans_keep_the_gap():
    """The lines of two moves that begin at once, which may begin and end at any time."""
    board = replace(BOARD, name="wide", targets=((1, 1), (14, 14)), columns=16, rows=16)
    policy, rng = GroupPolicy.computed(config(board, "planned")), np.random.default_rng(0)
    share, none, apart = np.linspace(0.0, 1.0, 101)[:, None], np.zeros(2, dtype=np.int64), []
    for cells in rng.integers(16, size=(400, 2, 2)):
        if not 5.83 <= math.dist(*cells) < 9.0 or (cells == board.targets).all(axis=1).any():
            continue
        seen = Observation(cells, none, none, none, np.array(board.targets), cells)
        if policy.q_values(seen).max(axis=1).min() > -1e4:  # both have a plan
            steps = DIRECTIONS[policy.act(seen).action]
            first, second = cells[:, None] + share * steps[:, None]
            apart.append(np.linalg.norm(first[:, None] - second, axis=2).min())
    nearest, *others = sorted(apart)
    assert nearest > 0.8**0.5 * 5.83  # there is no other plan
    assert others[:5] == pytest.approx([34**0.5] * 5)
