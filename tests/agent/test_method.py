"""Methods: the records of those built in, and a user's own, trained and compared."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

import agent
import minirobots as mr
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import joint_starts
from agent.mdp.interpretations import build_process
from agent.mdp.joint import BLOCKED, cells_after
from agent.mdp.optimum import optimum
from agent.moves.worlds import WorldRange
from agent.study.policies import is_trained
from agent.study.report import Report
from agent.study.user import read_study
from agent.training import methods
from agent.training.methods import METHODS, best_method, computed, learner, method_config
from agent.training.runs import policy_paths
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.model.outcome import Outcome
from cosim.model.scenario_file import find_scenario
from cosim.simulation.options import Physics


def briefly(_):
    return ProcessConfig(), LearningConfig(episodes=30_000)


@learner(settings=briefly)
def sarsa(q, s, a, reward, discount, s_next, a_next, eta, coin):
    """SARSA: learns the values of what it does, exploration included."""
    q[0, s, a] += eta * (reward + discount * q[0, s_next, a_next] - q[0, s, a])


@learner(tables=2, settings=briefly)
def double_q(q, s, a, reward, discount, s_next, a_next, eta, coin):
    """Double Q-learning (van Hasselt 2010)."""
    k = np.int64(coin & np.uint64(1))
    best = q[k, s_next].argmax()
    q[k, s, a] += eta * (reward + discount * q[1 - k, s_next, best] - q[k, s, a])


@computed(settings=lambda _: (ProcessConfig(features=("x", "y")), LearningConfig()), most_robots=1)
def straight(process):
    """Straight on: minus the distance from the target after a move."""
    after, rows = cells_after(process)[0], process.terrain.shape[2] - 2
    target = np.flatnonzero(after[:, 0] == np.arange(len(after)))[0]
    x, y = np.divmod(after, rows)
    away = np.hypot(x - target // rows, y - target % rows)
    return np.where(after == BLOCKED, -1e6, -away)[None]


@pytest.mark.long
def test_a_users_methods_are_trained_and_compared_in_a_study(tmp_path):
    table = mr.study([sarsa, double_q, straight], "1a", episodes=2, out=tmp_path, progress=None)
    assert [(row.policy, row.success) for row in table.rows] == [
        (method.name, 1.0) for method in (sarsa, double_q, straight)
    ]


@pytest.mark.long
def test_a_users_methods_learn_what_their_rules_say(fresh_cache):
    found = {}
    for rule in (sarsa, double_q):
        policy = agent.train("1a", method=rule, progress=None)
        assert policy.evaluate_on_grid().rate(Outcome.SUCCESS) == 1.0
        assert (policy.config.method, policy.kind) == (rule.name, "table")
        found[rule.name] = policy
    assert [len(policy.q) for policy in found.values()] == [1, 2]
    again = agent.train("1a", method=double_q.name, progress=None)
    assert again.digest() == found[double_q.name].digest()  # found by its name, too
    assert repr(agent.train("1a", method=straight)).endswith(":straight on the grid)")


@pytest.mark.long
@pytest.mark.parametrize("name", ["docs.examples.sarsa:sarsa", "docs.examples.joint:joint"])
def test_methods_of_the_examples_learn(name):
    policy = agent.train("1a", method=name, episodes=30_000, progress=None)
    assert policy.evaluate_on_grid().rate(Outcome.SUCCESS) == 1.0


@pytest.mark.parametrize(
    "file", sorted(Path("docs/studies").glob("*.toml")), ids=lambda file: file.stem
)
def test_studies_of_the_pages_name_methods_and_scenarios_that_there_are(file):
    study = read_study(file)
    policies, scenarios = study["policies"], study["scenario"]
    assert any([*map(is_trained, policies if isinstance(policies, list) else policies.values())])
    for name in scenarios if isinstance(scenarios, list) else [scenarios]:
        find_scenario(name)


@pytest.mark.ci
def test_a_method_of_a_module_is_trained_by_the_command(tmp_path, monkeypatch, command):
    (tmp_path / "my_rules.py").write_text(
        "from agent.training.methods import learner\n"
        "@learner()\n"
        "def rule(q, s, a, reward, discount, s_next, a_next, eta, coin):\n"
        "    q[0, s, a] += eta * (reward + discount * q[0, s_next].max() - q[0, s, a])\n"
    )
    monkeypatch.chdir(tmp_path)
    short = ("--scenario", "1a", "--jobs", 1, "--out", "runs", "--learning.episodes", 2000)
    assert command("train", "--method", "my_rules:rule", *short).returncode == 0
    (path,) = policy_paths(tmp_path / "runs")
    assert mr.load(path).config.method == "my_rules:rule"
    for name, message in (("my_rules:none", "cannot be imported"), ("none", "choose one of paper")):
        ended = command("train", "--method", name)
        assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
        assert message in ended.stderr


@pytest.mark.parametrize("name", ["1b", "4"])
def test_each_method_learns_on_its_own_process(name):
    for method in ("paper", "moves"):
        config = method_config(method, find_scenario(name), seed=3, episodes=1000)
        assert (config.learning.episodes, config.seed.entropy) == (1000, 3)
        assert (config.method, config.moves is not None) == (method, method == "moves")
        expected = {"1b": {"h"}, "4": {"b"}}[name] if method == "moves" else set()
        assert set(config.process.features) & {"b", "h"} == expected


def test_the_default_method_can_learn_every_board():
    wide = replace(find_scenario("4"), columns=40)
    boards = [wide, *map(find_scenario, ("4", "1b", "4-zone", "5-corridor", "6-swap", "swarm-16"))]
    best = [best_method(board) for board in boards]
    assert best == ["moves", "paper", "paper", "moves", "moves", "planned", "moves"]
    assert set(best) <= set(METHODS)
    assert method_config("paper", wide).process  # the board itself is fine


def test_on_moves_a_collision_costs_more_than_any_detour():
    """The dearest detour never ends and closes in on a robot that it almost touches."""
    config = method_config("moves", find_scenario("4"))
    process, contact_m = config.process, config.scenario.diameter_m
    nearness = process.approach_coefficient * (1.0 - contact_m / process.distance_limit_m)
    dearest = (process.step_cost + nearness) / (1.0 - config.learning.gamma)
    assert dearest == pytest.approx(175.0)
    assert process.goal_reward > dearest


def test_moves_are_observed_with_the_motors_and_in_the_worlds_that_are_given(monkeypatch, command):
    moves, seen = method_config("moves", find_scenario("4")).moves, []
    monkeypatch.setattr(methods, "calibrated", lambda config, *_, slower: config)
    monkeypatch.setattr(methods, "cached_moves", lambda *given: seen.append(given) or moves)
    given = (("J", 5e-9),)
    assert method_config("moves", "1b", options=Physics(motor_parameters=given)).moves == moves
    assert (seen[0][0].motor.J, seen[0][0].motor_parameters) == (5e-9, given)
    method_config("moves", find_scenario("4"), worlds=WorldRange(restitution=(0.1, 0.2)))
    assert seen[1][3:] == (WorldRange(mu=(0.15, 0.15), restitution=(0.1, 0.2)), 0.01)
    with pytest.raises(UserError, match="worlds has no effect on method paper"):
        agent.train("1a", method="paper", worlds=WorldRange())
    with pytest.raises(UserError, match="must be ascending"):
        agent.train("1a", method="moves", worlds=WorldRange(mu=(0.3, 0.1)))
    refused = command("moves", "--worlds.mu", 0.1, 0.2)
    assert refused.returncode == 2
    assert "ranges have no effect without --worlds" in refused.stderr


@pytest.mark.long
@pytest.mark.parametrize("options", [(), ("--method", "moves")])
def test_train_takes_a_file_of_moves(options, command, tmp_path):
    moves = method_config("moves", find_scenario("1a")).moves
    assert moves is not None
    moves.save(tmp_path / "moves.json")
    given = ("--scenario", "1a", "--moves", tmp_path / "moves.json", *options)
    short = ("--learning.episodes", 2000, "--learning.epsilon-episodes", 10, "--jobs", 1)
    assert command("train", *given, "--out", tmp_path / "runs", *short).returncode == 0
    (path,) = policy_paths(tmp_path / "runs")
    config = mr.load(path).config
    assert (config.moves, config.method) == (moves, "moves")
    expected = method_config("moves", find_scenario("1a"))
    assert config.process == expected.process
    assert (config.learning.eta, config.learning.episodes) == (expected.learning.eta, 2000)
    refused = command("train", *given, "--method", "paper")
    assert refused.returncode == 2
    assert "no effect on method paper" in refused.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method", "least", "longest_s"),
    [("4", "shortest", 0.99, 100.0), ("4-cross", "planned", 0.98, 200.0)],
)
def test_robots_get_there_in_time(name, method, least, longest_s, tmp_path, command):
    """What the README and docs say policies achieve in the dynamics, from 200 starts each."""
    policy = tmp_path / "policy.npz"
    agent.train(name, method=method).save(policy)
    options = ("--starts", 200, "--through", "--shield", "--recordings", 0, "--json")
    done = command("evaluate", policy, *options, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    (row,) = msgspec.json.decode(done.stdout.splitlines()[-1], type=Report).rows
    assert (row.episodes, row.collision, row.out_of_board) == (200, 0.0, 0.0)
    assert row.success is not None and row.success >= least
    assert row.sim_time_s is not None and row.sim_time_s <= longest_s
    if method == "shortest":
        process = build_process(find_scenario(name), ProcessConfig())
        bound = optimum(process).of_starts(joint_starts(process), 30)[0].mean()
        assert row.path_length_cm is not None and row.path_length_cm <= 1.15 * bound
