"""Optimal joint paths as policies: they reach the bound from every start, alone and in pairs."""

import re

import numpy as np
import pytest

from agent.mdp import grid
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import evaluate, joint_starts
from agent.mdp.interpretations import build_process
from agent.mdp.optimum import optimum
from agent.training.methods import method_config
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from cosim.base.errors import UserError
from cosim.model.outcome import SUCCESS
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import Observation

CROSSING = Scenario(
    "crossing", "", ((2, 1), (2, 4)), (((1, 5), (2, 5)), ((2, 0), (3, 0))),
    columns=5, rows=6, zone=(2, 2, 2, 2), obstacles=((0, 3),), robot_diameter_m=0.02,
)  # fmt: skip
PAIR = ("x", "y", "p")
SHORTEST = "shortest"


def made(method, scenario):
    return find_or_make(method_config(method, scenario))


def require_bound(policy):
    result = evaluate(policy.process, policy.values)
    assert (result.outcome == SUCCESS).all()
    bound, _ = optimum(policy.process).of_starts(result.starts, policy.config.scenario.rows)
    np.testing.assert_allclose(result.path_cells.mean(axis=1), bound, rtol=1e-12)


@pytest.mark.parametrize(
    "name", ["1b", *(pytest.param(n, marks=pytest.mark.slow) for n in ("2", "3", "4", "5-doorway"))]
)
def test_computed_policies_reach_the_bound_from_every_start(name):
    policy, log, path = made(SHORTEST, find_scenario(name))
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
        made("shortest", three)


def test_a_board_without_a_path_is_refused(command, tmp_path):
    path = tmp_path / "walled.toml"
    path.write_text(
        "columns = 30\nrows = 20\nobstacles = [[14, 0, 14, 19]]\n"
        "[[robots]]\ntarget = [24, 10]\nstarts = [[5, 7], [5, 8], [20, 8]]\n"
    )
    message = r"from start cells \[\[5, 7\]\] there is no path to the targets, and from 1 other"
    with pytest.raises(UserError, match=message):
        made(SHORTEST, find_scenario(str(path)))
    ended = command("bound", "--scenario", path)
    assert ended.returncode == 2
    assert re.search(message, ended.stderr)


def test_what_cannot_be_computed_is_refused(command, monkeypatch, tmp_path):
    with pytest.raises(UserError, match="4 robots on 900 cells"):
        made(SHORTEST, find_scenario("4-cross"))
    with pytest.raises(UserError, match=r"at most 2 robots.* 4-cross has 4"):
        made("fastest", find_scenario("4-cross"))
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
