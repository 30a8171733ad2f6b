"""Policies act as their tables say, are refused when they should be, and are found again."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

import agent
from agent.mdp import grid
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import evaluate_on_grid
from agent.training.methods import method_config
from agent.training.policy import Policy, PolicyConfig, Seed, load_policy
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from cosim.base.errors import UserError
from cosim.model.outcome import RUNNING, TIMEOUT, Outcome
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import Observation

pytestmark = pytest.mark.usefixtures("fresh_cache")


SMALL = Scenario(
    "small", "", ((2, 6), (9, 6)), (((0, 0), (3, 0)), ((11, 11), (8, 11))),
    columns=12, rows=12, robot_diameter_m=0.02, zone=(4, 4, 7, 7),
)  # fmt: skip
LEARNING = LearningConfig(episodes=20_000, epsilon_episodes=20, greedy_points=2)


@pytest.fixture(params=["paper", "double_q"])
def policy(request):
    interpretations = ProcessConfig(features=("x", "y", "d", "g", "b"))
    settings = {"process": interpretations, "learning": LEARNING}
    return find_or_make(method_config(request.param, SMALL, 5, **settings))[0]


def test_acting_on_observations_repeats_the_exact_evaluation(policy):
    process = policy.process
    result = evaluate_on_grid(process, policy.values)
    assert result.rate(Outcome.SUCCESS) > 0.5
    for k in range(len(result.outcome)):
        world = np.zeros((2, grid.COLUMN_COUNT), dtype=np.int64)
        grid.place(process, world, result.starts[k])
        facing = np.where(2 * result.starts[k, :, 1] < 12, 2, 6)
        rewards = np.empty(2, dtype=np.float32)
        outcome = RUNNING
        steps = 0
        while outcome == RUNNING and steps < process.step_limit:
            columns = world[:, : grid.VX], world[:, grid.CLASS], world[:, grid.SIGN], facing
            actions = policy.act(Observation(*(column.copy() for column in columns))).action
            moving = world[:, grid.STATUS] == grid.MOVING
            facing = np.where(moving, actions, facing)
            outcome = grid.move(process, world, facing, rewards)
            steps += 1
        assert (outcome or TIMEOUT) == result.outcome[k]
        assert steps == result.steps[k].max()


def test_save_and_load_keep_every_bit(policy, tmp_path):
    path = tmp_path / "deep" / "policy.npz"
    policy.save(path)
    again = Policy.load(path)
    assert again.config == policy.config
    assert again.episodes == 20_000
    for name in ("q", "visits", "random"):
        assert np.array_equal(getattr(again, name), getattr(policy, name))
    described = json.loads(path.with_suffix(".json").read_text())
    assert described["learning"]["eta"] == 0.01
    assert described["scenario_digest"] == SMALL.digest()
    first = path.read_bytes()
    again.save(path)
    assert path.read_bytes() == first


@pytest.fixture
def saved(tmp_path):
    _, _, path = find_or_make(PolicyConfig(SMALL, ProcessConfig(), LEARNING, Seed(0)))
    return path


def test_robots_of_another_size_and_another_schema_are_refused(saved):
    with pytest.raises(UserError, match=r"trained for robots of 2 cm, not of 5 cm"):
        load_policy(saved, find_scenario("4"))
    rewrite(saved, lambda d: d | {"schema_version": 99})
    with pytest.raises(UserError, match="schema 99"):
        Policy.load(saved)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d | {"scenario_digest": "0"},
        lambda d: d | {"process": d["process"] | {"features": ["x"]}},
        lambda d: d | {"process": d["process"] | {"step_limit": "many"}},
        lambda d: d | {"surprise": 1},
        lambda d: {k: v for k, v in d.items() if k != "seed"},
    ],
)
def test_inconsistent_configurations_are_refused(saved, change):
    rewrite(saved, change)
    with pytest.raises(UserError, match="train it again"):
        Policy.load(saved)


def rewrite(path, change):
    with np.load(path) as file:
        arrays = dict(file)
    text = json.dumps(change(json.loads(arrays["config"].tobytes())))
    arrays["config"] = np.frombuffer(text.encode(), dtype=np.uint8)
    np.savez(path, **arrays)


def test_observations_that_do_not_fit_are_refused(saved):
    policy = Policy.load(saved)
    ones = np.zeros(2, dtype=np.int64)
    with pytest.raises(ValueError, match="off the board"):
        policy.act(Observation(np.array([[0, 12], [1, 1]]), ones, ones, ones))
    with pytest.raises(ValueError, match="2 robots"):
        policy.act(Observation(np.array([[0, 1]]), ones[:1], ones[:1], ones[:1]))


SHORT = LearningConfig(episodes=5000, epsilon_episodes=10, greedy_points=5)
CONFIG = PolicyConfig(find_scenario("2"), ProcessConfig(), SHORT, Seed(0))


def test_a_second_call_finds_the_policy_and_its_curves():
    seen = []
    policy, log, path = find_or_make(CONFIG, progress=lambda *now, **_: seen.append(now))
    assert [now[1] for now in seen] == [1000, 2000, 3000, 4000, 5000]
    seen.clear()
    again, log_again, path_again = find_or_make(CONFIG, progress=lambda *now, **_: seen.append(now))
    assert not seen
    assert path == path_again
    assert np.array_equal(policy.q, again.q)
    for name in log._fields:
        assert np.array_equal(getattr(log, name), getattr(log_again, name), equal_nan=True)
    assert log.episode.tolist() == log.greedy_episode.tolist() == [1000, 2000, 3000, 4000, 5000]
    assert log.returns.shape == (5, 2)
    assert log.epsilon[[0, -1]] == pytest.approx([0.9 * 0.999**99, 0.0])
    assert log.greedy_success[-1] == evaluate_on_grid(policy.process, policy.values).rate(
        Outcome.SUCCESS
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "other",
    [
        {"seed": Seed(1)},
        {"scenario": find_scenario("3")},
        {"process": ProcessConfig(approach_coefficient=2.0)},
        {"learning": LearningConfig(episodes=5001, epsilon_episodes=10)},
        {},
    ],
)
def test_any_difference_trains_again(other):
    find_or_make(CONFIG)
    seen = []
    find_or_make(
        msgspec.structs.replace(CONFIG, **other),
        again=not other,
        progress=lambda *now, **_: seen.append(now),
    )
    assert seen


FILES = ("policy.npz", "training.npz", "run.sha256")


@pytest.mark.parametrize(
    "damage", [lambda path: path.write_bytes(b"broken"), Path.unlink], ids=["other", "removed"]
)
@pytest.mark.parametrize("broken", FILES)
def test_a_damaged_cache_is_trained_again(broken, damage):
    policy, _, path = find_or_make(CONFIG)
    whole = path.with_name(broken).read_bytes()
    damage(path.with_name(broken))
    assert np.array_equal(find_or_make(CONFIG)[0].q, policy.q)
    assert path.with_name(broken).read_bytes() == whole


@pytest.mark.parametrize("exchanged", [FILES[:1], FILES[1:2], FILES])
def test_files_of_another_seed_are_not_taken_for_those_of_this_one(exchanged, caplog):
    policy, log, path = find_or_make(CONFIG)
    *_, other = find_or_make(msgspec.structs.replace(CONFIG, seed=Seed(1)))
    for name in exchanged:
        shutil.copy(other.with_name(name), path.with_name(name))
    found, curves, _ = find_or_make(CONFIG)
    assert (found.config, found.digest()) == (CONFIG, policy.digest())
    assert np.array_equal(curves.returns, log.returns)
    assert "is not of its configuration" in caplog.text


def test_a_computed_policy_of_another_scenario_is_not_taken_for_this_ones():
    configs = [method_config("shortest", find_scenario(name)) for name in ("1a", "1b")]
    paths = [find_or_make(config)[2] for config in configs]
    for ending in ("", ".sha256"):
        shutil.copy(f"{paths[1]}{ending}", f"{paths[0]}{ending}")
    assert find_or_make(configs[0])[0].config == configs[0]


@pytest.mark.long
def test_tables_that_are_not_those_of_the_process_are_refused():
    policy, *_ = find_or_make(CONFIG)
    for q in (policy.q[:, :, :-1], policy.q[:, :1], policy.q.astype(float), policy.q[:0]):
        with pytest.raises(UserError, match="of the policy for scenario 2 do not fit"):
            replace(policy, q=q)
    with pytest.raises(UserError, match="do not fit"):
        replace(policy, q=np.full_like(policy.q, np.nan))
    with pytest.raises(UserError, match="are not those of the process"):
        evaluate_on_grid(policy.process, policy.values[:, :-1])
    for evaluated in (policy, find_or_make(method_config("planned", CONFIG.scenario))[0]):
        with pytest.raises(UserError, match="off the board of 30 x 30 cells"):
            evaluated.evaluate_on_grid(np.array([[[15, 30], [15, 0]]]))
        with pytest.raises(UserError, match=r"are not \(K, 2, 2\)"):
            evaluated.evaluate_on_grid(np.array([[[15, 29]]]))


@pytest.mark.long
def test_scenario_2_reaches_100_percent_of_all_900_starts():
    policy, log, _ = find_or_make(msgspec.structs.replace(CONFIG, learning=LearningConfig()))
    result = evaluate_on_grid(policy.process, policy.values)
    assert result.outcome.shape == (900,)
    assert result.rate(Outcome.SUCCESS) == 1.0
    # the exact optimum is 14.85 cm and 11.917 moves (agent.mdp.bound)
    assert 14.85 <= result.mean_path_cells() < 17.0
    assert 11.91 <= result.mean_steps() < 12.5
    assert log.success[-100:].min() == 1.0


def test_a_policy_is_loaded_for_its_own_scenario_if_one_is_named(near_file, near_policy):
    scenario = near_policy.config.scenario
    assert agent.load(near_file, scenario).config.scenario == scenario
    with pytest.raises(UserError, match="near"):
        agent.load(near_file, "2")
