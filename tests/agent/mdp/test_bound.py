"""Exact optima, against the octile distance and another algorithm, and policies that reach them."""

import heapq
import itertools
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.mdp import grid
from agent.mdp import optimum as optimum_module
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import evaluate_on_grid, joint_starts
from agent.mdp.interpretations import build_process
from agent.mdp.optimum import optimum, ratios
from agent.training.methods import method_config
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from cosim.base.errors import UserError
from cosim.model.outcome import RUNNING, SUCCESS, Outcome
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import Observation


def mean_bounds(scenario, **interpretations):
    process = build_process(scenario, ProcessConfig(**interpretations))
    path, steps = optimum(process).of_starts(joint_starts(process), scenario.rows)
    return 100.0 * scenario.cell_m * path.mean(), steps.mean()


@pytest.mark.parametrize("name", ["1a", "1b"])
def test_lone_robot_takes_the_octile_path(name):
    scenario = find_scenario(name)
    (gx, gy), starts = scenario.targets[0], scenario.starts[0]
    spans = [sorted((abs(x - gx), abs(y - gy))) for x, y in starts]
    octile = [long + (math.sqrt(2.0) - 1.0) * short for short, long in spans]
    path, steps = mean_bounds(scenario)
    assert path == pytest.approx(np.mean(octile), rel=1e-12)
    assert steps == pytest.approx(np.mean([long for _, long in spans]), rel=1e-12)


def crossing(diameter_m=0.02):
    """Two robots that must pass each other on a small board with a wall, wide for small robots."""
    wall = ((0, 3),) if diameter_m == 0.02 else ((1, 3), (2, 3))
    return Scenario(
        "crossing", "", ((2, 1), (2, 4)), (((1, 5), (2, 5)), ((2, 0), (3, 0))),
        columns=5, rows=6, zone=(2, 2, 2, 2), obstacles=wall,
        robot_diameter_m=diameter_m,
    )  # fmt: skip


def dijkstra(process, starts, diagonal):
    """Least cost of all robots together, forward over the moves of the learning process itself."""
    world = np.zeros((2, grid.COLUMN_COUNT), dtype=np.int64)
    rewards = np.empty(2, dtype=np.float32)
    first = (tuple(map(tuple, starts.tolist())), (False, False))
    best: dict[Any, float] = {first: 0.0}
    queue: list[tuple[float, Any]] = [(0.0, first)]
    while queue:
        cost, state = heapq.heappop(queue)
        if state[1] == (True, True):
            return cost
        if cost > best[state]:
            continue
        for actions in itertools.product(range(8), range(8)):
            assert grid.place(process, world, np.array(state[0]))
            world[:, grid.STATUS] = [grid.ARRIVED if done else grid.MOVING for done in state[1]]
            outcome = grid.move(process, world, np.array(actions), rewards)
            if outcome not in {RUNNING, SUCCESS}:
                continue
            cells = tuple(map(tuple, world[:, : grid.VX].tolist()))
            done = tuple(bool(s == grid.ARRIVED) for s in world[:, grid.STATUS])
            paid = sum(
                diagonal if a % 2 else 1.0
                for a, was_done in zip(actions, state[1], strict=True)
                if not was_done
            )
            after = (cells, done)
            if cost + paid < best.get(after, math.inf) - 1e-12:
                best[after] = cost + paid
                heapq.heappush(queue, (cost + paid, after))
    return math.inf


@pytest.mark.long
@pytest.mark.parametrize("collision", ["cells", "swept"])
@pytest.mark.parametrize("diameter_m", [0.02, 0.009])
def test_pair_agrees_with_dijkstra_over_the_learning_process(collision, diameter_m):
    scenario = crossing(diameter_m=diameter_m)
    process = build_process(scenario, ProcessConfig(collision=collision))
    starts = joint_starts(process)[[0, 3]]
    path, steps = optimum(process).of_starts(starts, scenario.rows)
    for k, start in enumerate(starts):
        assert 2.0 * path[k] == pytest.approx(dijkstra(process, start, math.sqrt(2.0)))
        assert 2.0 * steps[k] == pytest.approx(dijkstra(process, start, 1.0))


@pytest.mark.slow
def test_optimum_of_scenario_2_is_the_known_one():
    assert mean_bounds(find_scenario("2")) == pytest.approx((14.852, 11.917), abs=5e-3)


@pytest.mark.long
def test_optimum_is_cached_whatever_does_not_matter_to_it(monkeypatch):
    began = mean_bounds(crossing())
    monkeypatch.setattr(optimum_module, "cells_after", None)  # nothing is computed again
    assert mean_bounds(crossing()) == began
    # the step limit and the rewards do not matter to the optimum
    assert mean_bounds(crossing(), step_limit=7, approach_coefficient=5.0) == began


def test_optima_of_one_cache_are_those_of_their_own(monkeypatch, tmp_path):
    """Whatever of a process was computed before: nothing that matters is left out of the key."""
    usual, clear = crossing(), replace(crossing(), obstacles=())
    changes = {"targets": ((2, 1), (3, 4))}, {"obstacles": ()}, {"columns": 6}
    boards = [usual, *(replace(usual, **change) for change in changes)]
    boards += [replace(clear, robot_diameter_m=d) for d in (0.008, 0.012, 0.024)]
    cases = [(usual, ProcessConfig(collision="swept")), *((b, ProcessConfig()) for b in boards)]
    found = []
    for k, (board, config) in enumerate(cases):
        process = build_process(board, config)
        monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / "shared"))
        together = optimum(process)
        monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / str(k)))
        alone = optimum(process)
        np.testing.assert_array_equal(together.path_cells, alone.path_cells)
        np.testing.assert_array_equal(together.steps, alone.steps)
        found.append(alone.path_cells.tobytes())
    assert len({*found}) == len(cases)


@pytest.mark.long
def test_no_policy_beats_the_optimum():
    learning = LearningConfig(episodes=30_000, epsilon_episodes=10, greedy_points=0)
    policy, _, _ = find_or_make(PolicyConfig(crossing(), ProcessConfig(), learning, Seed(0)))
    result = evaluate_on_grid(policy.process, policy.values)
    assert result.rate(Outcome.SUCCESS) > 0.0
    path_ratio, steps_ratio = ratios(policy.process, result)
    assert path_ratio >= 1.0 - 1e-12
    assert steps_ratio >= 1.0 - 1e-12


def test_large_joint_processes_are_relaxed_to_robots_alone(monkeypatch):
    exact = mean_bounds(crossing())
    monkeypatch.setattr(optimum_module, "MAX_JOINT_STATES", 10)
    process = build_process(crossing(), ProcessConfig())
    assert optimum(process).relaxed
    relaxed = mean_bounds(crossing())
    assert relaxed[0] < exact[0]
    assert relaxed[1] <= exact[1]


CROSSING = crossing()
PAIR = ("x", "y", "p")
SHORTEST = "shortest"


def require_bound(policy):
    result = evaluate_on_grid(policy.process, policy.values)
    assert (result.outcome == SUCCESS).all()
    bound, _ = optimum(policy.process).of_starts(result.starts, policy.config.scenario.rows)
    np.testing.assert_allclose(result.path_cells.mean(axis=1), bound, rtol=1e-12)


@pytest.mark.parametrize(
    "name", ["1b", *(pytest.param(n, marks=pytest.mark.slow) for n in ("2", "3", "4", "5-doorway"))]
)
def test_computed_policies_reach_the_bound_from_every_start(name):
    policy, log, path = find_or_make(method_config(SHORTEST, find_scenario(name)))
    require_bound(policy)
    assert log is None
    assert Policy.load(path).config.method == SHORTEST
    assert path.stat().st_size < 6_000_000  # the tables of a pair take 52 MB


@pytest.mark.parametrize("collision", ["cells", "swept"])
def test_pairs_keep_to_one_of_several_optimal_joint_moves(collision):
    process = ProcessConfig(features=PAIR, collision=collision)
    config = PolicyConfig(CROSSING, process, LearningConfig(), Seed(0), method=SHORTEST)
    policy, *_ = find_or_make(config)
    assert isinstance(policy, Policy)
    require_bound(policy)
    # in every joint state one move of each robot is better than its others, by a grain at least
    best = np.sort(policy.values[policy.visits > 0], axis=1)
    assert (best[:, -1] - best[:, -2] >= 2.0**-10).all()
    seen = Observation(*(np.array(v) for v in (((1, 5), (3, 0)), (2, 2), (0, 0), (2, 2))))
    rows = [(1 * 6 + 5) * 30 + 3 * 6 + 0, (3 * 6 + 0) * 30 + 1 * 6 + 5]
    assert policy.states(seen).tolist() == rows
    assert policy.act(seen).unit == "cells"


def test_the_cell_of_a_partner_off_the_board_is_one_at_its_edge():
    process = build_process(CROSSING, ProcessConfig(features=PAIR))
    world = np.zeros((2, grid.COLUMN_COUNT), dtype=np.int64)
    assert grid.place(process, world, np.array([(0, 5), (4, 0)]))
    assert world[:, grid.PARTNER].tolist() == [4 * 6, 5]
    rewards = np.empty(2, dtype=np.float32)
    grid.move(process, world, np.array([3, 7]), rewards)  # off the corners
    assert world[:, grid.PARTNER].tolist() == [4 * 6, 5]


def test_three_robots_are_bounded_one_by_one_on_the_smallest_board():
    targets, starts = ((1, 1), (5, 5), (9, 9)), (((1, 4),), ((5, 8),), ((9, 3),))
    three = Scenario("three", "", targets, starts, 12, 12, zone=(0, 0, 1, 1), robot_diameter_m=0.02)
    process = build_process(three, ProcessConfig())
    bound = optimum(process)
    assert bound.relaxed
    assert bound.of_starts(joint_starts(process), 12)[1].tolist() == [4.0]
    with pytest.raises(UserError, match="3 robots on 144 cells"):
        find_or_make(method_config(SHORTEST, three))


def test_a_board_without_a_path_is_refused(command, tmp_path):
    path = tmp_path / "walled.toml"
    path.write_text(
        "columns = 30\nrows = 20\nobstacles = [[14, 0, 14, 19]]\n"
        "[[robots]]\ntarget = [24, 10]\nstarts = [[5, 7], [5, 8], [20, 8]]\n"
    )
    message = r"from start cells \[\[5, 7\]\] there is no path to the targets, and from 1 other"
    with pytest.raises(UserError, match=message):
        find_or_make(method_config(SHORTEST, find_scenario(str(path))))
    ended = command("bound", "--scenario", path)
    assert ended.returncode == 2
    assert re.search(message, ended.stderr)


def test_what_cannot_be_computed_is_refused(command, monkeypatch, tmp_path):
    with pytest.raises(UserError, match="4 robots on 900 cells"):
        find_or_make(method_config(SHORTEST, find_scenario("4-cross")))
    with pytest.raises(UserError, match=r"at most 2 robots.* 4-cross has 4"):
        method_config("fastest", find_scenario("4-cross"))
    with pytest.raises(UserError, match="shortest is computed, not trained"):
        method_config("shortest", CROSSING, episodes=5)
    with pytest.raises(UserError, match="feature p makes a robot's table"):
        large = Scenario("l", "", ((9, 9), (40, 40)), (((0, 0),), ((59, 59),)), 60, 60)
        build_process(large, ProcessConfig(features=PAIR))
    monkeypatch.chdir(tmp_path)
    ended = command("run", "--method", "shortest", "--train-seed", "3")
    assert ended.returncode == 2
    assert not any(tmp_path.glob("runs/*"))  # what is refused leaves no folder
    assert "method shortest is computed, not trained; leave them out" in ended.stderr
