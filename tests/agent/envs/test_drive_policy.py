"""Policies that command motors, in the co-simulation's own episodes, studies and recordings."""

from typing import Any

import numpy as np
import pytest

import minirobots as mr
from agent.envs.drive import DrivePolicy, DriveVectorEnv
from agent.study.policies import ObjectPolicy
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.model.scenario_file import find_in_world
from cosim.simulation.driving import DriveObservation, drives


def towards(seen):
    """Turn to the target with either end, then drive: a controller of `Drive-v0`."""
    ahead, left = seen[:, 11], seen[:, 12]
    turn = np.clip(3.0 * np.sign(ahead) * left, -1.0, 1.0)
    return np.column_stack([np.sign(ahead) * (np.abs(left) < 0.3), turn])


class Circling:
    """Commands motors on its own."""

    interval_s = 0.5

    def drive(self, motion: DriveObservation):
        motion.memory["asked"] = motion.memory.get("asked", 0) + 1
        assert motion.memory["asked"] <= 8
        return np.full((len(motion.poses), 2), 900.0)


@pytest.fixture(scope="module")
def driver():
    return DrivePolicy(towards, control_interval=0.5)


def test_a_driver_reaches_its_target_and_all_is_recorded(driver, tmp_path):
    episode = mr.simulate("1a", driver, progress=None, world={"sensor": {"rate_hz": 30.0}})
    assert episode.outcome == "success"
    assert episode.parameters["rl_step_s"].value == 0.5
    episode.save(tmp_path / "driven.rrd")
    assert set(mr.open(tmp_path / "driven.rrd").texts["/rl/r1/action"].texts) == {"motors"}
    omega = episode.signals["/sim/r1/motors/omega"].values
    commanded = episode.signals["/sim/r1/motors/omega_des"].values
    assert np.abs(commanded).max() > 900.0
    assert np.abs(omega).max() == pytest.approx(np.abs(commanded).max(), rel=0.1)


def test_its_decisions_are_those_in_the_environment(driver):
    """The observation of the environment, and its set points, from the same poses."""
    with_memory = {"starts": [[[0.1, 0.1, 0.0]]], "targets": [[[0.2, 0.15]]]}
    env = DriveVectorEnv(1, control_interval=0.5)
    seen, _ = env.reset(seed=3, options=with_memory)
    for _ in range(4):
        boards: Any = env._boards
        rows, state = boards._rows, boards._batch.state
        parts = rows.poses, rows.velocities, state.outputs[2:4, :1].T, rows.targets_m
        memory = {"dither": rows.dither.copy()}
        wanted = driver.drive(DriveObservation(*parts, boards.scenario, boards._config, memory))
        seen, *_ = env.step(towards(seen))
        assert np.array_equal(state.commands[:1, :2], wanted)
    env.close()


def test_studies_and_single_episodes_have_the_same_bits(driver):
    options: Any = {"starts": 3, "time_limit": 30, "progress": None}
    rows = mr.evaluate(driver, "1a", **options), mr.evaluate(driver, "1a", jobs=1, **options)
    lengths, again = ([r.path_length_cm for r in row.results.values()] for row in rows)
    assert lengths == again
    assert len(set(lengths)) == 3


def test_memory_is_an_episode_s_own_and_a_pair_is_driven():
    row = mr.evaluate(Circling(), "2", starts=3, time_limit=4, progress=None)
    assert [result.outcome for result in row.results.values()] == ["timeout"] * 3
    episode = mr.simulate("2", Circling(), time_limit=4, progress=None)
    turned = episode.signals["/sim/r2/yaw_rate"].values
    assert np.mean(turned) > 0.1


both: Any = Circling()
both.act = lambda observation: [0]


@pytest.mark.parametrize(
    ("policy", "options", "said"),
    [
        (Circling(), {"shield": True}, "shield has no effect"),
        (Circling(), {"through": True}, "through has no effect"),
        (Circling(), {"rl_step": 0.1}, "rl_step has no effect"),
        (Circling(), {"open_loop": ["heading"]}, "open_loop = heading has no effect"),
        (both, {}, "act.* and drive"),
        (Circling, {}, "no act"),
        ("P.npz", {}, "no act"),
    ],
)
def test_what_has_no_effect_is_refused(policy, options, said):
    with pytest.raises(ConfigError, match=said):
        mr.simulate("2", policy, progress=None, **options)


@pytest.mark.parametrize(
    "returned", [None, [900.0, 900.0], [[900.0, np.nan]] * 2, "fast", [[1, 2, 3]]]
)
def test_what_are_no_set_points_is_refused(returned, monkeypatch):
    policy = Circling()
    monkeypatch.setattr(policy, "drive", lambda motion: returned)
    with pytest.raises(UserError, match=r"the policy returned .*expected 2 x 2 finite numbers"):
        mr.simulate("2", policy, progress=None)


def test_failures_of_a_driver_name_it(monkeypatch):
    policy = Circling()
    monkeypatch.setattr(policy, "drive", lambda motion: 1 / 0)
    with pytest.raises(UserError, match=r"drive of policy Circling failed .*ZeroDivisionError"):
        mr.evaluate(policy, "2", starts=1, progress=None)
    assert drives(ObjectPolicy(Circling(), find_in_world("2")[0]))
    with pytest.raises(ConfigError, match="two finite numbers"):
        mr.simulate("1a", DrivePolicy(lambda seen: [[1.0]]), progress=None)
    with pytest.raises(ConfigError, match="control_interval"):
        DrivePolicy(towards, control_interval=0.0)
