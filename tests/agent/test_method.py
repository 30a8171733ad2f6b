"""The named methods: what each learns on, and training on a file of moves."""

from dataclasses import replace

import msgspec
import pytest

import agent
from agent import method as methods
from agent.method import method_config, method_of
from agent.moves.model import Move, ObservedMoves
from agent.moves.worlds import WorldRange
from agent.training.policy import Policy
from agent.training.runs import policy_paths
from agent.training.settings import COMPUTED, METHODS
from cosim.base.errors import UserError
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import DIRECTIONS
from minirobots.runner import execute


@pytest.fixture
def moves():
    kinds = [(direction, heading) for direction in (0, 1) for heading in range(4)]
    return ObservedMoves(
        "made by hand",
        0,
        tuple(
            Move(d, h, -1, 1, int(DIRECTIONS[d, 1]), 0.5, 3.5, 0.0, 0.0, 0.0, 0.0) for d, h in kinds
        ),
    )


@pytest.mark.parametrize("method", [m for m in METHODS if m not in COMPUTED])
@pytest.mark.parametrize("name", ["1b", "4"])
def test_each_method_learns_on_its_own_process(method, name, moves, monkeypatch):
    monkeypatch.setattr(methods, "_observed_moves", lambda *_: moves)
    config = method_config(method, find_scenario(name), seed=3, episodes=1000)
    assert config.learning.episodes == 1000
    assert config.seed.entropy == 3
    assert (config.moves is not None) == (method in methods.ON_MOVES)
    expected = {"1b": {"h"}, "4": {"b"}}[name] if method == "moves" else set()
    assert set(config.process.features) & {"b", "h"} == expected
    assert method_of(config) == method
    longer = msgspec.structs.replace(config, learning=replace(config.learning, greedy_points=3))
    assert method_of(longer) == method
    other = msgspec.structs.replace(config, learning=replace(config.learning, eta=0.123))
    assert method_of(other) is None


def test_the_default_method_can_learn_every_board():
    wide = replace(find_scenario("4"), columns=40)
    boards = [wide, *map(find_scenario, ("4", "1b", "4-zone", "5-corridor", "6-swap", "swarm-16"))]
    best = [methods.best_method(board) for board in boards]
    assert best == ["moves", "paper", "paper", "moves", "moves", "planned", "moves"]
    assert method_config("paper", wide).process  # the board itself is fine


@pytest.mark.parametrize("name", ["1b", "4"])
def test_on_moves_a_collision_costs_more_than_any_detour(name, moves, monkeypatch):
    """The dearest detour never ends and closes in on a robot that it almost touches."""
    monkeypatch.setattr(methods, "_observed_moves", lambda *_: moves)
    config = method_config("moves", find_scenario(name))
    process, contact_m = config.process, config.scenario.diameter_m
    nearness = process.approach_coefficient * (1.0 - contact_m / process.distance_limit_m)
    dearest = (process.step_cost + nearness) / (1.0 - config.learning.gamma)
    assert dearest == pytest.approx(175.0)
    assert process.goal_reward > dearest


def test_moves_are_observed_with_the_motor_parameters_that_are_given(moves, monkeypatch):
    seen = []
    monkeypatch.setattr(methods, "calibrated_slower", lambda config, *_: config)
    monkeypatch.setattr(methods, "cached_moves", lambda config, *_: seen.append(config) or moves)
    given = (("J", 5e-9),)
    assert method_config("moves", find_scenario("1b"), motor_parameters=given).moves == moves
    assert (seen[0].motor.J, seen[0].motor_parameters) == (5e-9, given)


def test_moves_are_observed_in_the_worlds_that_are_given(moves, monkeypatch):
    seen = []
    monkeypatch.setattr(methods, "calibrated_slower", lambda config, *_: config)
    monkeypatch.setattr(methods, "cached_moves", lambda *given: seen.append(given[3:]) or moves)
    config = method_config("moves", find_scenario("4"), worlds=WorldRange(restitution=(0.1, 0.2)))
    assert seen == [(WorldRange(mu=(0.15, 0.15), restitution=(0.1, 0.2)), 0.01)]
    assert method_of(config) == "moves"
    with pytest.raises(UserError, match="worlds has no effect on method paper"):
        agent.train("1a", method="paper", worlds=WorldRange())
    with pytest.raises(UserError, match="must be ascending"):
        agent.train("1a", method="moves", worlds=WorldRange(mu=(0.3, 0.1)))


def test_ranges_without_drawn_worlds_are_refused(monkeypatch):
    monkeypatch.setattr("sys.argv", ["moves", "--worlds.mu", "0.1", "0.2"])
    with pytest.raises(UserError, match="ranges have no effect without --worlds"):
        execute("moves")


def test_train_takes_a_file_of_moves(moves, monkeypatch, tmp_path, capsys):
    moves.save(tmp_path / "moves.json")
    out = tmp_path / "runs"
    arguments = ["--scenario", "1a", "--moves", str(tmp_path / "moves.json"), "--out"]
    short = ["--learning.episodes", "2000", "--learning.epsilon-episodes", "10", "--jobs", "1"]
    monkeypatch.setattr("sys.argv", ["train", *arguments, str(out), *short])
    execute("train")
    (path,) = policy_paths(out)
    assert Policy.load(path).config.moves == moves
