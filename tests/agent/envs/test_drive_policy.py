"""Policies that command motors, in the co-simulation's own episodes, studies and recordings."""

import math
from typing import Any

import numpy as np
import pytest

import minirobots as mr
from agent.envs.drive import DriveEnv, DrivePolicy, observed
from agent.study.policies import ObjectPolicy
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.calibration import measuring
from cosim.calibration.primitives import DIRECTIONS, Primitive
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world, find_scenario
from cosim.simulation.driving import DriveObservation, drives, velocities


def towards(observations):
    """Turn to the target with either end, then drive: a controller of `Drive-v0`."""
    ahead, left = observations[:, 11], observations[:, 12]
    turn = np.clip(3.0 * np.sign(ahead) * left, -1.0, 1.0)
    return np.column_stack([np.sign(ahead) * (np.abs(left) < 0.3), turn])


class Circling:
    """Commands motors on its own, with what a function of the motion returns."""

    interval_s = 0.5

    def __init__(self, command=lambda motion: np.full((len(motion.poses), 2), 900.0)) -> None:
        self._command = command

    def drive(self, motion: DriveObservation):
        motion.memory["asked"] = motion.memory.get("asked", 0) + 1
        assert motion.memory["asked"] <= 8
        return self._command(motion)


@pytest.fixture(scope="module")
def driver():
    return DrivePolicy(towards, control_interval=0.5)


@pytest.mark.long
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


def test_its_observations_and_set_points_are_those_of_the_environment():
    """The environment returns in the same state what the policy gets in an episode."""
    rows: list[np.ndarray] = []

    def predict(observations):
        rows.extend(observations)
        return towards(observations)

    policy = DrivePolicy(predict, control_interval=0.5)
    mr.simulate("1a", policy, time_limit=5, noise=0.0, progress=None)
    x, y = 0.3 * rows[0][4:6]
    (target,) = find_scenario("1a").targets
    place = {"starts": [[x, y, math.atan2(*rows[0][2:4])]]}
    place["targets"] = [[0.01 * (cell + 0.5) for cell in target]]
    env = DriveEnv(control_interval=0.5, noise=0.0)
    observation, _ = env.reset(options=place)
    for row in rows[:8]:
        assert observation == pytest.approx(row, abs=1e-4)
        observation, *_ = env.step(towards(row[None])[0])
    env.close()


@pytest.mark.long
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
    ("policy", "options", "words"),
    [
        (Circling(), {"shield": True}, "shield has no effect"),
        (Circling(), {"through": True}, "through has no effect"),
        (Circling(), {"rl_step": 0.1}, "rl_step has no effect"),
        (Circling(), {"speed": 2.0}, "speed has no effect"),
        (Circling(), {"open_loop": ["heading"]}, "open_loop = heading has no effect"),
        (both, {}, "act.* and drive"),
        (Circling, {}, "no act"),
        ("P.npz", {}, "no act"),
    ],
)
def test_what_has_no_effect_is_refused(policy, options, words):
    with pytest.raises(ConfigError, match=words):
        mr.simulate("2", policy, progress=None, **options)


ONE_MOTOR = """
[[motor]]
place_m = [0.0, 0.0, 0.003]
axis = [0.0, 1.0, 0.0]
""" + "".join(f"[[foot]]\nplace_m = [{x}, {y}]\n" for x in (0.016, -0.016) for y in (0.016, -0.016))


class Full:
    """Runs all motors at most of their speed."""

    interval_s = 0.5

    def drive(self, motion: DriveObservation):
        most = 0.9 * motion.config.steering.max_speed_rad_s
        return np.full(motion.speeds.shape, most)


class AtFull(Full):
    """Takes no arguments, as a command needs it."""


WEAK = "[motor]\nV_s_max = 0.6\n"
HOPPING = "[body]\nmass_kg = 0.05\n[world]\nrestitution = 0.9\n"


@pytest.mark.parametrize(
    ("machine", "motors"),
    [
        pytest.param("kilobot", 2, marks=pytest.mark.slow),
        (WEAK, 2),
        (HOPPING, 2),
        pytest.param(ONE_MOTOR, 1, marks=pytest.mark.slow),
    ],
)
def test_motors_are_commanded_without_a_calibration(
    tmp_path, monkeypatch, command, machine, motors
):
    """Not of a machine with its own layout, nor of one that is too weak to drive, or that hops."""
    preset = machine
    if "\n" in machine:
        preset = str(tmp_path / "own.toml")
        (tmp_path / "own.toml").write_text(machine)
    for name in ("find_primitives", "find_calibration"):
        monkeypatch.setattr(measuring, name, None)
    options: Any = {"preset": preset, "time_limit": 2, "progress": None}
    episode = mr.simulate("1a", Full(), **options)
    assert episode.outcome == "timeout"
    assert np.abs(episode.signals["/sim/r1/motors/omega"].values).max() > 100.0
    row = mr.evaluate(Full(), "1a", starts=1, **options)
    assert [result.outcome for result in row.results.values()] == ["timeout"]
    assert row.drive_speed_m_s is None
    given = ("--scenario", "1a", "--preset", preset, "--time-limit", 2, "--starts", 1)
    policy = f"{AtFull.__module__}:AtFull"
    done = command("evaluate", "--policy", policy, *given, "--jobs", 1, "--recordings", 0)
    assert done.returncode == 0, done.stderr
    env = DriveEnv(preset=preset, action="motors")
    observation, _ = env.reset(seed=0)
    observation, *_ = env.step(np.full(motors, 0.9, dtype=np.float32))
    assert np.isfinite(observation).all()
    env.close()


def test_velocities_need_a_machine_that_can_be_steered(monkeypatch):
    """It circles."""
    circling = Primitive((700.0,) * 2, (2e-3, 0.0, 0.3), (0.0, 0.0, 0.0), 0.0, (0.0,) * 2, 1e30)
    monkeypatch.setattr(
        measuring, "find_primitives", lambda *_: dict.fromkeys(DIRECTIONS, circling)
    )
    words = r"kilobot cannot steer: .* drive\(motion\) .* action = motors"
    with pytest.raises(UserError, match=words):
        DriveEnv(preset="kilobot")
    with pytest.raises(UserError, match=words):
        mr.simulate("1a", DrivePolicy(towards), preset="kilobot", progress=None)


@pytest.mark.parametrize(
    "returned", [None, [900.0, 900.0], [[900.0, np.nan]] * 2, "fast", [[1, 2, 3]]]
)
def test_what_are_no_set_points_is_refused(returned):
    with pytest.raises(UserError, match=r"policy returned .* 2 x 2 finite numbers"):
        mr.simulate("2", Circling(lambda motion: returned), progress=None)


def test_failures_of_a_driver_name_it():
    with pytest.raises(UserError, match=r"drive of policy Circling failed .*ZeroDivisionError"):
        mr.evaluate(Circling(lambda motion: 1 / 0), "2", starts=1, progress=None)
    assert drives(ObjectPolicy(Circling(), find_in_world("2")[0]))
    with pytest.raises(ConfigError, match="2 finite numbers"):
        mr.simulate("1a", DrivePolicy(lambda observations: [[1.0]]), progress=None)
    with pytest.raises(ConfigError, match="control_interval"):
        DrivePolicy(towards, control_interval=0.0)


def test_a_place_is_observed_as_a_share_of_each_side():
    board = Scenario("wide", "", ((35, 5),), (((3, 5),),), 40, 20, zone=(18, 8, 21, 11))
    pose, zeros = np.array([[0.3, 0.05, 0.4]]), np.zeros((1, 3))
    target = np.array([[0.355, 0.055]])
    motion = DriveObservation(pose, zeros, np.zeros((1, 2)), target, board, CoSimConfig(), {})
    assert observed(motion, 1, None)[0, 4:6] == pytest.approx((0.75, 0.25))


def test_velocities_are_those_ahead_and_beyond_half_a_turn():
    before = np.array([[0.0, 0.0, 3.1], [0.1, 0.2, 1.4]])
    after = np.array([[0.02, 0.0, -3.1], [0.1, 0.23, np.pi / 2.0]])
    found = velocities(before, after, 0.1)
    ahead, left = -0.2 * np.cos(0.0416), 0.2 * np.sin(0.0416)
    assert found[0] == pytest.approx((ahead, left, (2.0 * np.pi - 6.2) / 0.1), abs=1e-5)
    assert found[1] == pytest.approx((0.3, 0.0, (np.pi / 2.0 - 1.4) / 0.1), abs=1e-9)
