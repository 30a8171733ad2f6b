"""What is said of a training at its end: its success, whether it rises, and what it lacks."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from agent.mdp.config import ProcessConfig
from agent.training import methods
from agent.training.loop import TrainingLog, learn, learnt
from agent.training.methods import METHODS, method_config
from agent.training.policy import PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.base.errors import UserError
from cosim.model.scenario_file import find_scenario
from tests.agent.conftest import NEAR

USUAL = LearningConfig().episodes


def log_of(success, exact=(), epsilon=0.0) -> TrainingLog:
    curve = np.array(success, dtype=float)
    nothing = dict.fromkeys(TrainingLog._fields, np.zeros(0))
    known = {"success": curve, "epsilon": np.full(len(curve), epsilon)}
    return TrainingLog(**nothing | known | {"greedy_success": np.array(exact, dtype=float)})


def config_of(episodes, moves=None) -> PolicyConfig:
    learning = LearningConfig(episodes=episodes)
    name = "paper" if moves is None else "moves"
    return PolicyConfig(NEAR, ProcessConfig(), learning, Seed(0), moves, name)


def test_a_training_on_the_grid_is_judged_exactly():
    few, enough = (learnt(*of) for of in map(trained, (30, 5000)))
    assert (enough.success, enough.where, enough.suffices) == (1.0, "on the grid", True)
    assert str(enough) == "success 100.0% on the grid after 5000 episodes"
    assert few.success is not None and few.success <= 0.5
    assert not few.suffices
    assert str(few).endswith(f": it lacks {USUAL - 30} of the {USUAL} that the method has")


def trained(episodes):
    policy, log = learn(config_of(episodes))
    return policy.config, log


@pytest.mark.parametrize(
    ("success", "converged", "text"),
    [
        ([0.99] * 100, True, "success 99.0% on moves after 1500000 episodes"),
        ([*np.linspace(0.0, 0.8, 100)], False, "still rising (+8.1%): train longer"),
        ([0.4] * 100, True, "no longer rising: choose another method or other settings"),
        ([0.4] * 90 + [0.42] * 10, True, "no longer rising"),  # which is chance
        ([], False, "too few for a learning curve"),
    ],
)
def test_a_training_on_moves_is_judged_by_its_last_episodes(success, converged, text):
    config = config_of(1_500_000, method_config("moves", NEAR).moves)
    found = learnt(config, log_of(success, exact=[0.1]))
    assert found.converged == converged
    assert text in str(found)
    assert "ε = 0.3" in str(learnt(config, log_of([0.5] * 20, epsilon=0.3)))


def test_the_commands_say_it(command, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("agent.evaluation.run.run_episodes", lambda *_, **__: [])
    short = ("--scenario", "1a", "--record", "none", "--time-limit", 2, "--train-episodes", 100)
    ended = command("run", *short, "--method", "paper", "--out", tmp_path / "r", "--json")
    assert ended.returncode == 0, ended.stderr
    assert "training: success " in caplog.text  # before the episodes, as it will not suffice
    line = next(line for line in ended.stdout.splitlines() if line.startswith("training: "))
    assert line.endswith(f"it lacks {USUAL - 100} of the {USUAL} that the method has")
    achieved = msgspec.json.decode(ended.stdout.splitlines()[-1])["training"]
    assert achieved["episodes"] == 100
    few = ("--scenario", "1a", "--learning.episodes", 100, "--jobs", 1)
    ended = command("train", *few, "--out", tmp_path / "t")
    assert "training of run_000: success" in ended.stdout


def test_sizes_and_paths_are_checked_before_anything_is_measured(monkeypatch, command, tmp_path):
    measured = pytest.fail
    for name in ("calibrated", "cached_moves"):
        monkeypatch.setattr(methods, name, measured)
    monkeypatch.setattr("minirobots.commands.episodes.resolve", measured)
    wide = "columns = 36\nrows = 30\n[[robots]]\ntarget = [30, 15]\nstarts = 'left'\n"
    wide += "[[robots]]\ntarget = [5, 15]\nstarts = 'right'\n"
    walled = "obstacles = [[14, 0, 14, 29]]\n[[robots]]\ntarget = [24, 10]\nstarts = [[5, 7]]\n"
    for content, method, message in (
        (wide, "fastest", "a robot's table 4,665,600 states large.*such as moves"),
        (walled, "fastest", "there is no path to its target"),
        (walled, "moves", "there is no path to its target"),
    ):
        (path := tmp_path / "board.toml").write_text(content)
        with pytest.raises(UserError, match=message):
            method_config(method, path)
        ended = command("run", "--scenario", path, "--method", method, "--out", tmp_path / "o")
        assert (ended.returncode, ended.stderr.count("\n")) == (2, 1), ended.stderr
    many = replace(find_scenario("4-ring"), columns=200, rows=200)
    with pytest.raises(UserError, match="too much to plan for"):
        method_config("planned", many)
    assert METHODS["planned"].require(find_scenario("4-ring")) is None
