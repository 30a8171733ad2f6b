"""Every recorded signal of a short episode against poses, motors, forces of all ticks and rewards.

Each expectation comes from other signals and the equations, so that a signal that is written from
another of its kind, with another unit, or of the other robot does not pass.
"""

from itertools import pairwise

import numpy as np
import pytest

from cosim.coupling.rl_step import Decision, Step
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.model.world import Sensor, World
from cosim.onboard.features import DISTANCE_CLASSES, GRADIENT_SIGNS
from cosim.onboard.steering import MODE_NAMES
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept
from cosim.recording.reader import Episode, read_episode
from cosim.recording.series import with_bursts
from cosim.simulation.options import DecisionOptions
from tests.alone import CoSimulation

STARTS = (10, 14), (15, 16)  # 5.4 cm apart: robots of 5 cm touch after a turn and 2 mm
SCENARIO = Scenario("pair", "", ((3, 27), (27, 2)), tuple((start,) for start in STARTS))
DIRECTIONS = np.array([1, 5])  # towards each other
SENSOR = Sensor(rate_hz=50.0, position_noise_mm=0.3, heading_noise_deg=1.0)
CONFIG = with_bursts(CoSimConfig(world=World(sensor=SENSOR)), "full").merged(
    DecisionOptions(rl_step=0.5).tree()
)
TICKS, DT = 100, 1e-5  # of a control period
ROBOTS = pytest.mark.parametrize("robot", [0, 1])
LOOP = {"omega_dot", "noise", "u", "integral", "disturbance"}  # of the motors, at full detail
# Unit of every signal of a robot.
UNITS = {
    "sim": {
        "rad/s": "motors/omega motors/omega_des motors/noise yaw_rate",
        "rad": "motors/theta motors/integral heading heading_error estimate/heading",
        "rad/s2": "motors/omega_dot",
        "V": "motors/voltage motors/u",
        "A": "motors/current",
        "N.m": "motors/disturbance",
        "m": "position distance_m estimate/position",
        "m/s": "velocity",
        "m2, m rad, rad2": "estimate/covariance",
        "N": "contact/normal_mean contact/friction_mean",
        "N.s": "contact/impact",
        "1": "mode contact/slipping_share contact/lifted_share contact/touching_share",
    },
    "raw": {"rad/s": "omega", "rad": "theta", "m": "position", "N": "normal friction"},
    # Seconds are the unit of the action values of this test.
    "rl": {"cells": "cell visited distance", "1": "reward reward_parts return", "s": "q_s"},
    "world": {"m": "robot:translation", "1": "robot:quaternion"},
}
FAST = {
    "motors/omega",
    "motors/voltage",
}  # whose rows sum up 5 periods at the default level, by means
# How other rows of the default level sum up 25 periods: by the last, the largest (of impacts), or
MEANS = {"motors/current", "velocity", "yaw_rate"} | {
    f"contact/{name}"
    for name in ("normal_mean", "friction_mean", "slipping_share", "lifted_share", "touching_share")
}


def reward_parts(number: int) -> np.ndarray:
    return np.array([[100.0, 10.0, 1.0], [-300.0, 20.0, 7.0]]) * (number + 1)


def values(number: int) -> np.ndarray:
    return -np.arange(16.0).reshape(2, 8) - 100.0 * number


@pytest.fixture(scope="module")
def steps(motor_fmu) -> list[Step]:
    system = CoSimulation(SCENARIO, motor_fmu, CONFIG)
    system.reset(STARTS, np.random.SeedSequence(3))
    done = [system.step(DIRECTIONS)]
    while not done[-1].outcome:
        done.append(system.step(DIRECTIONS))
    assert done[-1].outcome == "collision"
    assert len(done) > 2
    return done


def recorded(steps: list[Step], level) -> Episode:
    kept = Kept()
    with (
        pytest.MonkeyPatch.context() as patch,
        EpisodeRecorder(kept, SCENARIO, CONFIG, "test", {}, level=level) as recorder,
    ):
        patch.setattr("cosim.recording.episode._STRETCH_S", 1.0)  # so that there are several
        for step in steps:
            decision = Decision(np.array([7, 2]), values(step.number), "s")
            recorder.write(step, decision, reward_parts(step.number))
    return read_episode(kept)


@pytest.fixture(scope="module")
def episode(steps) -> Episode:
    return recorded(steps, "full")


def of(episode: Episode, robot: int, kind: str = "sim"):
    """Values of a robot's signals by their names."""
    return lambda name: episode.signals[f"/{kind}/r{robot + 1}/{name}"].values


def burst_rows(episode: Episode) -> np.ndarray:
    """Rows of full detail that end with the blocks of `TICKS` ticks in the bursts."""
    return (
        np.round(1e3 * episode.signals["/raw/r1/omega"].time_s[TICKS - 1 :: TICKS]).astype(int) - 1
    )


def test_units_and_names(episode):
    units = {
        f"/{kind}/{robot}/{name}": unit
        for kind, of_kind in UNITS.items()
        for unit, names in of_kind.items()
        for name in names.split()
        for robot in ("r1", "r2")
    }
    assert {path: signal.unit for path, signal in episode.signals.items()} == units
    names = {path.split("/", 3)[3]: s.components for path, s in episode.signals.items()}
    for name in ("omega", "voltage", "current", "theta", "u"):
        assert names[f"motors/{name}"] == ("D", "E")
    assert names["velocity"] == names["position"][:2] == ("x", "y")
    assert names["contact/impact"] == ("A", "B", "C")
    assert names["reward_parts"] == ("goal or failure", "step", "nearness")


def test_times_are_ends_of_control_periods(episode, steps):
    count = sum(len(step.samples.omega) for step in steps)
    for path, signal in episode.signals.items():
        if path.startswith("/sim/"):
            assert signal.time_s == pytest.approx(1e-3 * np.arange(1, count + 1), abs=1e-9), path


@ROBOTS
def test_motors(episode, steps, robot):
    """Eq. (13) and (14), and which motor of which robot it is by the commands and the ticks."""
    sim, raw, motor = of(episode, robot), of(episode, robot, "raw"), CONFIG.motor
    first = len(steps[0].raw.omega)
    omega, theta, voltage = (sim(f"motors/{name}") for name in ("omega", "theta", "voltage"))
    for name in ("omega", "theta"):
        np.testing.assert_array_equal(raw(name)[:first], getattr(steps[0].raw, name)[:, robot])
        ends = raw(name)[TICKS - 1 :: TICKS]
        np.testing.assert_array_equal(sim(f"motors/{name}")[burst_rows(episode)], ends)
    turned = np.diff(raw("theta")[:first], axis=0) / DT
    np.testing.assert_allclose(turned, raw("omega")[1:first], rtol=1e-6, atol=1e-6)
    error = sim("motors/omega_des") - omega - sim("motors/noise")
    u = motor.K_p * error + motor.K_i * sim("motors/integral")
    np.testing.assert_allclose(sim("motors/u"), u, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(voltage, np.clip(u, -motor.V_s_max, motor.V_s_max), atol=1e-12)
    current = (voltage - motor.K_T * omega) / motor.R
    np.testing.assert_allclose(sim("motors/current"), current, rtol=1e-9, atol=1e-12)
    torque = motor.K_T * current - motor.b * omega - motor.c * np.sign(omega)
    torque += sim("motors/disturbance") - motor.m * motor.g * motor.r * np.sin(theta)
    turning = omega != 0.0
    found = sim("motors/omega_dot")[turning]
    np.testing.assert_allclose(found, torque[turning] / motor.J, rtol=1e-6, atol=1e-3)
    relative = sim("motors/noise") / np.where(sim("motors/omega_des") == 0.0, 1.0, omega)
    assert 0.02 < np.abs(relative[200:]).mean() < 0.04  # uniform within 5 %
    assert (sim("motors/disturbance") == 0.0).all()  # no load


@ROBOTS
def test_poses(episode, steps, robot):
    sim, world, raw = (of(episode, robot, kind) for kind in ("sim", "world", "raw"))
    position, heading = sim("position"), sim("heading")
    start = 0.01 * (np.array(STARTS[robot]) + 0.5)
    assert position[0] == pytest.approx(start, abs=1e-4)
    np.testing.assert_allclose(world("robot:translation")[:, :2], position, atol=1e-6)
    rows, at = burst_rows(episode), raw("position")[TICKS - 1 :: TICKS]
    np.testing.assert_allclose(world("robot:translation")[rows], at, atol=1e-6)
    x, y, z, w = world("robot:quaternion").T
    front = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y**2 + z**2))
    np.testing.assert_allclose(np.sin(front - heading), 0.0, atol=1e-5)
    np.testing.assert_allclose(front - heading, 0.0, atol=1e-5)
    moved = np.diff(raw("position"), axis=0)[TICKS - 2 :: TICKS, :2] / DT
    off = np.abs(sim("velocity")[rows] - moved)
    assert np.median(off) < 0.02 * np.abs(moved).max()
    turned = np.gradient(np.unwrap(heading), 1e-3)
    assert np.corrcoef(turned, sim("yaw_rate"))[0, 1] > 0.9
    assert 0.7 < np.polyfit(sim("yaw_rate"), turned, 1)[0] < 1.1
    other = of(episode, 1 - robot)("position")
    np.testing.assert_allclose(sim("distance_m"), np.hypot(*(position - other).T), rtol=1e-12)


@ROBOTS
def test_steering(episode, robot):
    sim, raw = of(episode, robot), of(episode, robot)
    mode, commands = sim("mode"), raw("motors/omega_des")
    states = episode.texts[f"/rl/r{robot + 1}/steering"]
    rows = np.searchsorted(states.time_s, 1e-3 * np.arange(len(mode)) + 1e-9) - 1
    assert [MODE_NAMES[int(m)] for m in mode] == [states.texts[row] for row in rows]
    assert {"turn", "drive"} <= {*states.texts}
    assert all(before != after for before, after in pairwise(states.texts))
    same_sense = np.sign(commands).prod(axis=1)
    turns, drives = mode == MODE_NAMES.index("turn"), mode == MODE_NAMES.index("drive")
    assert (same_sense[turns] > 0.0).all()
    assert (same_sense[drives] < 0.0).all()
    # Robots turn and drive as motors are commanded, forwards with a positive E.
    late = np.flatnonzero(drives)[-50:]
    along = np.column_stack([np.cos(sim("heading")), np.sin(sim("heading"))])
    forwards = (sim("velocity") * along).sum(axis=1)[late].mean()
    assert np.sign(forwards) == np.sign(commands[late, 1].mean())
    assert np.sign(sim("yaw_rate")[turns].mean()) == np.sign(commands[turns].mean())
    # The error of the line's direction, of which either end may be ahead; the line is near.
    course = DIRECTIONS[robot] * np.pi / 4.0 - sim("estimate/heading")
    course = (course + np.pi / 2.0) % np.pi - np.pi / 2.0
    assert np.median(np.abs(sim("heading_error") - course)) < 0.25
    assert np.corrcoef(sim("heading_error"), course)[0, 1] > 0.9
    assert np.abs(sim("heading_error")).max() > 0.5


@ROBOTS
def test_contacts(episode, robot):
    """Statistics of each control period from the forces of its ticks."""
    sim, raw = of(episode, robot), of(episode, robot, "raw")
    rows, normal = burst_rows(episode), raw("normal").reshape(-1, TICKS, 3)
    friction = raw("friction").reshape(-1, TICKS, 3, 2)
    mean = np.linalg.norm(friction.mean(axis=1), axis=-1)
    for name, expected in (
        ("normal_mean", normal.mean(axis=1)),
        ("friction_mean", mean),
        ("lifted_share", (normal == 0.0).any(axis=2).mean(axis=1)),
    ):
        found = sim(f"contact/{name}")[rows]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=name)
        assert np.ptp(expected) > 0.1
    slides = np.linalg.norm(friction, axis=3) > 0.999 * CONFIG.robot.mu * normal
    expected = (slides & (normal > 0.0)).mean(axis=1)
    assert sim("contact/slipping_share")[rows] == pytest.approx(expected, abs=0.03)
    ticks = raw("normal")
    lands = np.diff((ticks > 0.0).astype(int), axis=0, prepend=1) > 0
    impulse = DT * ticks * (lands | np.roll(lands, 1, axis=0))
    expected = impulse.reshape(-1, TICKS, 3).sum(axis=1)
    within = np.diff(rows, prepend=-2) == 1  # not the first of a burst
    found = sim("contact/impact")[rows[within]]
    np.testing.assert_allclose(found, expected[within], rtol=1e-9, atol=1e-15)
    touching, apart = sim("contact/touching_share"), sim("distance_m")
    assert touching[-1] > 0.0
    assert (touching[apart > 0.0505] == 0.0).all()


@ROBOTS
def test_estimates(episode, robot):
    sim = of(episode, robot)
    heading_off = np.sin(sim("estimate/heading") - sim("heading"))
    off = np.column_stack([sim("estimate/position") - sim("position"), heading_off])
    assert (np.abs(off).max(axis=0) < [1.5e-3, 1.5e-3, 0.1]).all()
    assert (np.abs(off).max(axis=0) > 1e-6).all()
    xx, xy, yy, xh, yh, hh = sim("estimate/covariance").T
    covariance = np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]).transpose(2, 0, 1)
    deviation = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.linalg.eigvalsh(covariance / np.einsum("ni,nj->nij", deviation, deviation)).min() > 0
    spread = np.sqrt((off**2).mean(axis=0)) / deviation.mean(axis=0)
    assert ((spread > 0.05) & (spread < 5.0)).all()


@ROBOTS
def test_decisions_and_rewards(episode, steps, robot):
    rl, name, count = of(episode, robot, "rl"), f"r{robot + 1}", len(steps)
    numbers = range(count)
    np.testing.assert_array_equal(rl("q_s"), [values(k)[robot] for k in numbers])
    parts = np.array([reward_parts(k)[robot] for k in numbers])
    np.testing.assert_array_equal(rl("reward_parts"), parts)
    np.testing.assert_allclose(rl("reward"), parts.sum(axis=1))
    np.testing.assert_allclose(rl("return"), parts.sum(axis=1).cumsum())
    ends = [sum(len(s.samples.omega) for s in steps[: k + 1]) - 1 for k in numbers]
    seen = np.array([of(episode, i)("estimate/position")[ends] for i in (0, 1)])
    cells = np.concatenate([np.array(STARTS)[:, None], np.floor(100.0 * seen)], axis=1)
    np.testing.assert_array_equal(rl("cell"), cells[robot])
    np.testing.assert_allclose(rl("distance"), np.hypot(*(cells[0] - cells[1]).T))
    visited = [len({*map(tuple, cells[robot, : k + 1])}) for k in range(count + 1)]
    assert rl("visited").tolist() == visited
    for path in ("reward", "return", "reward_parts"):
        at = episode.signals[f"/rl/{name}/{path}"].time_s
        assert at == pytest.approx(1e-3 * (np.array(ends) + 1))
    at = episode.signals[f"/rl/{name}/q_s"].time_s
    assert at == pytest.approx(0.5 * np.arange(count))
    texts = {path: list(episode.texts[f"/rl/{name}/{path}"].texts) for path in ("action", "greedy")}
    assert texts == {
        "action": [("45°", "225°")[robot]] * count,
        "greedy": [("315°", "90°")[robot]] * count,
    }
    seen = [step.before for step in steps] + [steps[-1].after]
    signs = [GRADIENT_SIGNS[int(s.gradient_sign[robot]) + 1] for s in seen]
    assert list(episode.texts[f"/rl/{name}/gradient"].texts) == signs
    classes = [DISTANCE_CLASSES[s.distance_class[robot]] for s in seen]
    assert list(episode.texts[f"/rl/{name}/distance_class"].texts) == classes
    moves = episode.texts[f"/rl/{name}/move"].texts
    assert (moves[0], moves[-1]) == (("45°", "225°")[robot], "ended")
    assert list(episode.texts["/outcome"].texts) == ["running", "collision"]


def test_rows_of_the_default_level_sum_up_periods(episode, steps):
    coarse = recorded(steps, "default").signals
    for path, signal in coarse.items():
        _, kind, _, name = path.split("/", 3)
        if kind == "sim":
            every, size = episode.signals[path].values, 5 if name in FAST else 25
            blocks = np.split(every, np.arange(size, len(every), size))
            how = (
                np.mean
                if name in {*MEANS, *FAST}
                else np.max
                if name == "contact/impact"
                else lambda b, axis: b[-1]
            )
            expected = [how(block, axis=0) for block in blocks]
            np.testing.assert_allclose(signal.values, expected, rtol=1e-9, atol=1e-15, err_msg=path)
        elif kind == "rl":
            np.testing.assert_array_equal(signal.values, episode.signals[path].values)
    loop = {path for path in episode.signals if path.rpartition("/")[2] in LOOP}
    assert {p for p in episode.signals if p not in coarse} - loop == {
        "/raw/r1/theta",
        "/raw/r2/theta",
    }
