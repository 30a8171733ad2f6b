"""Bodies with any number of motors and feet against symmetries, conservation laws and springs."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.calibration.trial import Trial, mean_motion
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig, not_calibrated
from cosim.model.params import (
    TABLE_I,
    TABLE_II,
    TIMING,
    Foot,
    Mount,
    RobotParams,
    motors_of,
)
from cosim.model.preset import find_preset
from cosim.physics.body_state import (
    NORMALS,
    QUATERNION,
    V_X,
    V_Y,
    V_Z,
    W_X,
    W_Y,
    W_Z,
    standing_state,
)
from cosim.physics.feet import foot_positions
from cosim.physics.forces import directions, motor_mounts, motor_wrench
from cosim.physics.properties import body_params
from tests.references.prescribed import audit, coast

DT, G = TIMING.dt_s, TABLE_II.g


def feet(angles: list[float], radii: list[float]) -> tuple[Foot, ...]:
    return tuple(Foot(r * math.cos(a), r * math.sin(a)) for a, r in zip(angles, radii, strict=True))


@pytest.mark.long
@pytest.mark.parametrize("count", [4, pytest.param(16, marks=pytest.mark.slow)])
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_a_dropped_body_gains_no_energy_and_keeps_the_cone(count, data):
    shares = st.lists(st.floats(0.0, 0.6), min_size=count, max_size=count)
    angles = 2.0 * np.pi / count * (np.arange(count) + data.draw(shares))
    radii = 0.012 + 0.015 * np.array(data.draw(shares))
    robot = TABLE_I._replace(feet=feet(angles.tolist(), radii.tolist()))
    params = body_params(robot, TABLE_II, DT)
    state = standing_state(robot, 0.0, 0.0, 0.3)
    speeds = data.draw(st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3))
    turning = data.draw(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
    state[2] += 1e-4
    state[[V_X, V_Y, V_Z]], state[[W_X, W_Y, W_Z]] = speeds, turning
    gained, excess, least, _ = audit(state, params, 3000)
    weight_nm = 0.1 * G * 1e-6
    assert (gained < weight_nm, least, excess < 1e-15) == (True, 0.0, True)


@pytest.mark.parametrize("count", [4, pytest.param(8, marks=pytest.mark.long)])
def test_loads_are_those_of_springs(count):
    """A centre of mass off the middle; equal springs under a rigid body, by least squares."""
    angles = (2.0 * np.pi / count * (np.arange(count) + 0.5)).tolist()
    robot = TABLE_I._replace(feet=feet(angles, [0.02] * count), com_x_m=0.004, com_y_m=-0.002)
    params = body_params(robot, TABLE_II, DT, tolerance=1e-8)
    state = standing_state(robot, 0.0, 0.0, 0.0)
    coast(state, params, 20_000)
    places = foot_positions(robot)[:, :2] - params.centre
    rows = np.column_stack([np.ones(count), places]).T
    expected = rows.T @ np.linalg.solve(rows @ rows.T, [robot.mass_kg * G, 0.0, 0.0])
    loads = state[NORMALS : NORMALS + count] / DT
    np.testing.assert_allclose(loads, expected, rtol=0.02)


AXES = [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.48, -0.6, 0.64)]


@pytest.mark.parametrize("included", [True, False])
@pytest.mark.parametrize("axis", AXES)
def test_forces_are_those_of_a_mass_on_a_circle(axis, included):
    """The acceleration of a point mass by finite differences, and the rotor's torque balance."""
    mount = Mount((0.006, -0.01, 0.004), axis)
    # x = 0.006 keeps the shaft along y from the formula of Fig. 4b
    robot = TABLE_I._replace(motors=(mount,), masses_included=included)
    (found,) = motor_mounts(robot, motors_of(robot, TABLE_II))
    hanging, ahead = map(np.array, directions(axis))
    theta, omega, omega_dot, h = 0.7, 300.0, 4e4, 1e-6

    def place(t: float) -> np.ndarray:
        angle = theta + omega * t + 0.5 * omega_dot * t * t
        return TABLE_II.r * (math.cos(angle) * hanging + math.sin(angle) * ahead)

    acceleration = (place(h) - 2.0 * place(0.0) + place(-h)) / h**2
    weight = TABLE_II.m * np.array([0.0, 0.0, -G])
    expected = -TABLE_II.m * acceleration
    if not included:  # else the body's weight includes that of the mass
        expected += weight
    lever = np.array(mount.place_m) - (0.0, 0.0, robot.com_height_m)
    gravity_torque = np.cross(place(0.0), weight) @ axis
    reaction = -(TABLE_II.J * omega_dot - gravity_torque) * np.array(axis)
    moment = np.cross(lever, expected) + reaction
    force, twist = motor_wrench(found, theta, omega, omega_dot)
    np.testing.assert_allclose(force, expected, rtol=2e-4, atol=2e-5)
    np.testing.assert_allclose(twist, moment, rtol=2e-4, atol=1e-6)


unit = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 0.1)


@given(axes=st.lists(unit, min_size=1, max_size=8), omega=st.floats(-1200.0, 1200.0))
@settings(max_examples=50, deadline=None)
def test_over_a_turn_motors_give_no_momentum(axes, omega):
    """Constant speeds; the weight of the masses is that of the body."""
    lengths = [math.hypot(*axis) for axis in axes]
    mounts = tuple(
        Mount(
            (0.018 * x / length, 0.018 * z / length, 0.004 + 0.003 * y),
            (x / length, y / length, z / length),
        )
        for (x, y, z), length in zip(axes, lengths, strict=True)
    )
    robot = TABLE_I._replace(motors=mounts, masses_included=True)
    found = motor_mounts(robot, motors_of(robot, TABLE_II))
    angles = (2.0 * np.pi * np.arange(16) / 16).tolist()
    wrenches = np.array(
        [[motor_wrench(own, angle, omega, 0.0) for own in found] for angle in angles]
    )
    force, moment = wrenches.mean(axis=0).sum(axis=0)
    largest = len(mounts) * TABLE_II.m * TABLE_II.r * omega**2 + 1e-3
    np.testing.assert_allclose(force, 0.0, atol=1e-14 * largest)
    np.testing.assert_allclose(moment, 0.0, atol=1e-14 * largest)


def silent(config: CoSimConfig) -> CoSimConfig:
    return config.having("test", relative_amplitude=0.0)


def driven(config: CoSimConfig, set_points: list[Any], seconds: float, fmu: MotorFmu) -> Trial:
    with Trial(fmu, config, np.zeros(len(set_points)), np.random.SeedSequence(0)) as trial:
        trial.set_motors(np.array(set_points))
        before = trial.poses
        samples = trial.advance(round(seconds / config.timing.control_period_s))
        trial.motion = mean_motion(before, [samples], 1e-3)  # type: ignore[attr-defined]
    return trial


SQUARE: RobotParams = TABLE_I._replace(
    motors=(*TABLE_I.motors, Mount((0.018, 0.0, 0.003), (1.0, 0.0, 0.0))),
    feet=tuple(
        Foot(x, y) for x, y in ((0.016, 0.016), (-0.014, 0.017), (-0.014, -0.017), (0.016, -0.016))
    ),
)


@pytest.mark.slow
def test_mirror_images_move_as_mirror_images_in_every_bit(motor_fmu):
    """Motors D and E change places and sense; the one on the x axis turns the other way."""
    base = silent(CoSimConfig())
    still = {name: value for name, (value, _) in not_calibrated(3).items()}
    config = replace(base, robot=SQUARE, steering=base.steering._replace(**still))
    pair = [(-900.0, 850.0, 700.0), (-850.0, 900.0, -700.0)]
    bodies = driven(config, pair, 0.5, MotorFmu(motor_fmu)).bodies
    one, other = bodies.T
    for row in (V_X, V_Z, W_Y):
        assert one[row] == other[row]
    for row in (V_Y, W_X, W_Z):
        assert one[row] == -other[row]


@pytest.mark.long
def test_a_droplet_moves_alike_in_another_direction(motor_fmu):
    """Turned by 240°, which leaves the order in which the two motors are pulsed."""
    config = find_preset("droplet").config()
    ways = [config.top_speed_rad_s * np.roll((0.0, -1.0, 1.0), k) for k in (0, 2)]
    motion = driven(config, ways, 1.0, MotorFmu(motor_fmu)).motion  # type: ignore[attr-defined]
    one, other = (motion[:, 0] + 1j * motion[:, 1]) * np.exp(-2j * np.pi / 3.0 * np.array([0, 2]))
    assert abs(one) > 5e-4
    assert abs(other - one) < 1e-3 * abs(one)  # rounding, grown by sticking and slipping


@pytest.mark.long
def test_a_motor_without_a_mass_changes_nothing(motor_fmu):
    """It has the others' shafts described in three dimensions; with the body's reaction on them."""
    base = silent(CoSimConfig(reaction=True))
    still = Mount((0.018, 0.0, 0.003), (0.6, 0.0, 0.8), (("m", 1e-15), ("J", 3e-12)))

    def bodies(*motors: Mount) -> np.ndarray:
        robot = TABLE_I._replace(motors=(*TABLE_I.motors, *motors))
        none = {n: value for n, (value, _) in not_calibrated(len(robot.motors)).items()}
        config = replace(base, robot=robot, steering=base.steering._replace(**none))
        speeds = [(-900.0, 850.0, 0.0)[: len(robot.motors)]]
        return driven(config, speeds, 0.2, MotorFmu(motor_fmu)).bodies[: QUATERNION.stop, 0]

    np.testing.assert_allclose(bodies(still), bodies(), rtol=1e-6, atol=1e-9)


@pytest.mark.long
def test_feet_carry_the_weight_of_a_machine_that_is_weighed_with_its_motors(motor_fmu):
    """The centre of mass, too, is that of all: on two sides of it feet carry the same."""
    config = silent(find_preset("droplet").config())
    with Trial(MotorFmu(motor_fmu), config, np.zeros(1), np.random.SeedSequence(0)) as trial:
        loads = trial.advance(300).normal_mean[-1, 0]
    np.testing.assert_allclose(loads.sum(), config.robot.mass_kg * G, rtol=1e-3)


own = st.fixed_dictionaries(
    {},
    optional={
        name: st.sampled_from([usual, 1.2 * usual, 0.8 * usual])
        for name, usual in TABLE_II._asdict().items()
        if name not in ("g", "J")
    },
)


@pytest.mark.long
@given(data=st.data(), voltages=st.booleans())
@settings(max_examples=4, deadline=None)
def test_a_machine_moves_alike_with_motors_and_feet_in_another_order(motor_fmu, data, voltages):
    """Places of no symmetry, so that kernels sum in the order of the file."""
    places = (0.011, 0.012, 0.004), (-0.013, 0.006, 0.003), (0.004, -0.014, 0.005)
    axes = (0.6, 0.8, 0.0), (0.0, 0.6, 0.8), (-0.48, 0.6, 0.64)
    stated = data.draw(st.lists(own, min_size=3, max_size=3))
    mounts = [
        Mount(*where, tuple(each.items()))
        for where, each in zip(zip(places, axes, strict=True), stated, strict=True)
    ]
    stands = [
        Foot(*place, mu)
        for place, mu in zip(
            ((0.019, 0.011), (-0.015, 0.016), (-0.012, -0.018), (0.017, -0.014)),
            data.draw(st.lists(st.sampled_from([None, 0.1, 0.3]), min_size=4, max_size=4)),
            strict=True,
        )
    ]
    base = silent(CoSimConfig(open_loop=("motors",) if voltages else ()))
    still = {n: value for n, (value, _) in not_calibrated(3).items()}

    def moved(motors: list[int], standing: list[int]) -> np.ndarray:
        robot = TABLE_I._replace(
            motors=tuple(mounts[k] for k in motors), feet=tuple(stands[k] for k in standing)
        )
        config = replace(base, robot=robot, steering=base.steering._replace(**still))
        set_points = 0.9 * np.array(config.top_speeds_rad_s) * np.array([1.0, -1.0, 0.7])[motors]
        return driven(config, [set_points], 0.1, MotorFmu(motor_fmu)).bodies[: QUATERNION.stop, 0]

    usual = moved([0, 1, 2], [0, 1, 2, 3])
    order = data.draw(st.permutations(range(3))), data.draw(st.permutations(range(4)))
    np.testing.assert_allclose(moved(*order), usual, rtol=1e-6, atol=1e-9)
