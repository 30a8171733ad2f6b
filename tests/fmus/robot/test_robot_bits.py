"""The robot FMU gives the bits of the co-simulation's kernels, however it is stepped."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TABLE_II, TIMING
from cosim.model.world import World
from cosim.physics.body_state import QUATERNION

from .conftest import BODY, INPUTS, REACTIONS, Kernels, push

OK = 0
DT_S = TIMING.dt_s
START = {"x_start": 0.12, "y_start": 0.03, "heading_start": 2.3}


def motion(count: int, step_s: float, seed: int = 0) -> np.ndarray:
    """Signals (count, 6) of two motors that start, hop the robot, stop, rest and reverse."""
    speeds = np.array([0.0, 950.0, 1400.0, 0.0, 0.0, -1000.0, -300.0])
    at = np.linspace(0.0, 1.0, len(speeds))
    generator = np.random.default_rng(seed)
    rows = np.empty((count, 6))
    for motor in range(2):
        omega = np.interp(np.arange(count + 1) / count, at, speeds * generator.uniform(0.9, 1.0))
        rows[:, motor] = step_s * np.cumsum(omega[1:]) + generator.uniform(-3.0, 3.0)
        rows[:, 2 + motor] = omega[1:]
        rows[:, 4 + motor] = np.diff(omega) / step_s
    return rows


def drive(robot, rows: np.ndarray, step_s: float, begin: int = 0) -> np.ndarray:
    found = []
    for k, row in enumerate(rows, start=begin):
        assert robot.set(**dict(zip(INPUTS, row.tolist(), strict=True))) == OK
        assert robot.do_step(k * step_s, step_s) == OK, robot.messages
        found.append(robot.get(*BODY, *REACTIONS))
    return np.array(found)


def kernels_at(robot, config: CoSimConfig) -> Kernels:
    """Where a robot starts. The sines of its heading may differ from those of Python in a bit."""
    x_m, y_m, *quaternion = robot.get("x", "y", "q_w", "q_x", "q_y", "q_z")
    assert 2.0 * math.atan2(quaternion[3], quaternion[0]) == pytest.approx(START["heading_start"])
    kernels = Kernels(config, x_m, y_m)
    kernels.state.bodies[QUATERNION, 0] = quaternion
    return kernels


def config_of(ticks: int, extrapolate: bool, **changes) -> CoSimConfig:
    timing = TIMING._replace(communication_step_s=ticks * DT_S)
    order = "jacobi" if extrapolate else "gauss-seidel"
    return replace(CoSimConfig(timing=timing, order=order, reaction=True), **changes)


@pytest.mark.parametrize("ticks", [1, 5, 100])
@pytest.mark.parametrize("extrapolate", [False, True])
def test_a_drive_has_the_bits_of_the_kernels(robot, fmi, ticks, extrapolate):
    rows = motion(3000 if ticks < 100 else 300, ticks * DT_S)
    made = robot(fmi).start(**START, extrapolate=extrapolate)
    expected = kernels_at(made, config_of(ticks, extrapolate)).run(rows)
    found = drive(made, rows, ticks * DT_S)
    assert found.tobytes() == expected.tobytes()
    normal = expected[:, 13:16]
    assert (normal == 0.0).any() and (normal > 0.0).all(axis=1).any()  # it hops, and lands
    friction = np.linalg.norm(expected[:, 16:25].reshape(-1, 3, 3), axis=2)
    assert ((normal > 0.0) & (friction < 0.999 * TABLE_I.mu * normal)).any()  # and sticks


@pytest.mark.parametrize(
    ("parameters", "changes"),
    [
        ({"mass": 0.083, "mu": 0.3, "m": 0.00018, "r": 0.0015, "J": 3e-9, "g": 9.7},
         {"robot": TABLE_I._replace(mass_kg=0.083, mu=0.3),
          "motor": TABLE_II._replace(m=0.00018, r=0.0015, J=3e-9, g=9.7)}),
        ({"diameter": 0.07, "height": 0.03, "com_height": 0.011, "foot_radius": 0.03,
          "motor_radius": 0.028, "motor_axis_height": 0.005},
         {"robot": TABLE_I._replace(diameter_m=0.07, height_m=0.03, com_height_m=0.011,
                                    foot_radius_m=0.03, motor_radius_m=0.028,
                                    motor_axis_height_m=0.005)}),
        ({"com_x": 0.002, "com_y": -0.0015},
         {"robot": TABLE_I._replace(com_x_m=0.002, com_y_m=-0.0015)}),
        ({"restitution": 0.4}, {"world": World(restitution=0.4)}),
    ],
)  # fmt: skip
def test_parameters_mean_the_same(robot, parameters, changes):
    rows = motion(1500, 10 * DT_S, seed=1)
    made = robot().start(**START, **parameters)
    expected = kernels_at(made, config_of(10, True, **changes)).run(rows)
    assert drive(made, rows, 10 * DT_S).tobytes() == expected.tobytes()


def test_a_robot_that_falls_lands_as_the_kernels_say(robot):
    kernels = Kernels(config_of(1, True), 0.0, 0.0)
    kernels.state.bodies[2, 0] = TABLE_I.com_height_m + 1e-3
    rows = np.zeros((3000, 6))
    expected = kernels.run(rows)
    found = drive(robot().start(lift_start=1e-3), rows, DT_S)
    assert found.tobytes() == expected.tobytes()
    assert found[0, 13] == 0.0
    assert found[-1, 13:16].sum() == pytest.approx(
        (TABLE_I.mass_kg + 2 * TABLE_II.m) * TABLE_II.g, rel=1e-3
    )


def test_forces_from_outside_act_on_the_axis(robot):
    force, torque = (0.3, -0.2), 2e-3
    made = robot().start(**START, com_x=0.002)
    config = config_of(1, True, robot=TABLE_I._replace(com_x_m=0.002))
    kernels = kernels_at(made, config)
    assert made.set(F_x=force[0], F_y=force[1], M_z=torque) == OK
    for k in range(200):
        assert made.do_step(k * DT_S, DT_S) == OK
        push(kernels.plant, kernels.state, force, torque)
    found = np.array(made.get(*BODY[:13]))
    assert found.tobytes() == kernels.state.bodies[:13, 0].tobytes()
    along = found[7:9] @ force / np.linalg.norm(force)
    weight = (TABLE_I.mass_kg + 2 * TABLE_II.m) * TABLE_II.g
    pushing = np.linalg.norm(force) - TABLE_I.mu * weight
    assert 0.0 < along < 1.2 * pushing * 200 * DT_S / TABLE_I.mass_kg
    assert found[12] > 0.0


def test_saved_states_go_on_with_the_same_bits(robot, fmi):
    rows = motion(1200, 10 * DT_S)
    whole = drive(robot(fmi).start(**START, extrapolate=False), rows, 10 * DT_S)
    first = robot(fmi).start(**START, extrapolate=False)
    drive(first, rows[:700], 10 * DT_S)
    saved = first.save()
    again = drive(first, rows[700:], 10 * DT_S, begin=700)
    assert again.tobytes() == whole[700:].tobytes()
    assert first.load(saved) == OK
    other = robot(fmi).start(mass=0.2)
    assert other.load(saved) == OK
    for each in (first, other):
        assert drive(each, rows[700:], 10 * DT_S, begin=700).tobytes() == again.tobytes()
        assert each.save() == first.save()
