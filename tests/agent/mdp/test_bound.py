"""Exact optima: against the octile distance, against another algorithm, and as a bound."""

import heapq
import itertools
import math
from typing import Any

import numpy as np
import pytest

from agent.mdp import grid
from agent.mdp import optimum as optimum_module
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import evaluate, joint_starts
from agent.mdp.interpretations import build_process
from agent.mdp.optimum import optimum, ratios
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from cosim.model.outcome import RUNNING, SUCCESS, Outcome
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario


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


def test_optimum_is_cached_whatever_does_not_matter_to_it(monkeypatch):
    began = mean_bounds(crossing())
    monkeypatch.setattr(optimum_module, "cells_after", None)  # nothing is computed again
    assert mean_bounds(crossing()) == began
    # the step limit and the rewards do not matter to the optimum
    assert mean_bounds(crossing(), step_limit=7, approach_coefficient=5.0) == began


def test_no_policy_beats_the_optimum():
    learning = LearningConfig(episodes=30_000, epsilon_episodes=10, greedy_points=0)
    policy, _, _ = find_or_make(PolicyConfig(crossing(), ProcessConfig(), learning, Seed(0)))
    result = evaluate(policy.process, policy.values)
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
