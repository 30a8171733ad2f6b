"""The robot under prescribed motor speeds: directions, symmetry, tipping, lift-off, convergence."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.machine.platform import motion as platform
from cosim.machine.platform.design import least_foot_force
from cosim.model.params import (
    TABLE_I,
    TABLE_II,
    TIMING,
    RobotParams,
    cylinder_inertia,
    lift_off_speed,
)
from cosim.physics.body_state import standing_state
from tests.references.prescribed import (
    NORMAL_IMPULSE,
    STATE_SIZE,
    Drive,
    MeanMotion,
    drive_body,
    mean_motion,
    rig,
    trace_body,
)

DT = TIMING.dt_s
RIG = rig(TABLE_I, TABLE_II, DT)
QUARTER, HALF = math.pi / 2.0, math.pi

# Rows to columns of a state that y → −y negates; feet A and C change places.
MIRROR = np.ones(STATE_SIZE)
MIRROR[[1, 4, 6, 8, 10, 12, 17, 20, 23]] = -1.0
SWAP = np.arange(STATE_SIZE)
SWAP[[13, 15]] = 15, 13
SWAP[16:19], SWAP[22:25] = np.arange(22, 25), np.arange(16, 19)


def motion(
    drive: Drive, *, robot: RobotParams = TABLE_I, dt_s: float = DT, tolerance: float = 0.01
) -> MeanMotion:
    return mean_motion(
        robot, TABLE_II, drive, dt_s=dt_s, settle_s=0.1, duration_s=0.5, tolerance=tolerance
    )


def trace(drive: Drive) -> np.ndarray:
    states = np.empty((20, STATE_SIZE))
    trace_body(standing_state(TABLE_I, 0.0, 0.0, 0.0), RIG, drive, 100, states)
    return states


@pytest.mark.parametrize(
    ("omega_d", "omega_e", "forward", "turn"),
    [(-900.0, 900.0, 1, 0), (900.0, -900.0, -1, 0), (900.0, 900.0, 0, 1), (-900.0, -900.0, 0, -1)],
)
def test_motor_directions_drive_and_turn(omega_d, omega_e, forward, turn):
    """(−, +) along +x, (+, −) along −x, (+, +) counter-clockwise, (−, −) clockwise."""
    found = motion(Drive(omega_d, omega_e))
    assert 1e3 * found.forward_m_s == pytest.approx(2.5 * forward, abs=0.02)
    assert math.degrees(found.yaw_rate_rad_s) == pytest.approx(10.18 * turn, abs=0.05)
    assert abs(found.lateral_m_s) < 1e-6


@settings(max_examples=settings().max_examples // 5)
@given(
    st.floats(-1100.0, 1100.0),
    st.floats(-1100.0, 1100.0),
    st.floats(-3.0, 3.0),
    st.floats(-3.0, 3.0),
)
@example(900.0, -900.0, 0.0, 0.0)  # in phase: no lateral motion, roll or yaw
@example(-1130.0, 1130.0, 0.0, 0.0)  # with feet lifting
def test_mirrored_inputs_give_mirrored_motion_in_every_bit(omega_d, omega_e, theta_d, theta_e):
    states = trace(Drive(omega_d, omega_e, theta_d, theta_e))
    mirrored = trace(Drive(-omega_e, -omega_d, -theta_e, -theta_d))
    np.testing.assert_array_equal(mirrored, (states * MIRROR)[:, SWAP])


@pytest.mark.parametrize(
    ("mu", "omega"), [(0.1, 700.0), (0.1, 900.0), (0.15, 700.0), (0.15, 850.0), (0.3, 700.0)]
)
def test_driving_in_phase_is_the_1_dof_platform(omega, mu):
    """While all feet stay down they slide alike, and pitching moments do not matter."""
    robot = TABLE_I._replace(mu=mu)
    expected = platform.net_speed(platform.robot_platform(robot), omega)
    found = motion(Drive(-omega, omega), robot=robot)
    assert found.least_normal_n > 0.0
    assert found.forward_m_s == pytest.approx(expected, rel=0.01, abs=1e-6)


@pytest.mark.parametrize("omega", [800.0, 900.0, 1000.0])
def test_turning_in_phase_is_the_1_dof_platform(omega):
    """Seen from a foot: mass Izz/R², the same weight; motors and feet on the same circle."""
    spread = TABLE_I.foot_radius_m / TABLE_I.motors[0].place_m[1]
    robot = TABLE_I._replace(motors=TABLE_I.spread(spread).motors)
    like = platform.robot_platform(robot)
    weight = (like.mass + like.m) * like.g
    mass = cylinder_inertia(robot)[2] / robot.foot_radius_m**2
    turning = like._replace(mass=mass, g=weight / (mass + like.m))
    expected = platform.net_speed(turning, omega) / robot.foot_radius_m
    found = motion(Drive(omega, omega), robot=robot)
    assert found.yaw_rate_rad_s == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("sense", "low"), [(1.0, 899.7), (-1.0, 999.3)])
def test_a_foot_lifts_at_the_predicted_motor_speed(sense, low):
    assert least_foot_force(TABLE_I, TABLE_II, sense * low) == pytest.approx(0.0, abs=1e-4)
    below = motion(Drive(-sense * 0.99 * low, sense * 0.99 * low))
    above = motion(Drive(-sense * 1.01 * low, sense * 1.01 * low))
    assert below.least_normal_n == pytest.approx(
        least_foot_force(TABLE_I, TABLE_II, sense * 0.99 * low), abs=1e-3
    )
    assert below.least_normal_n > 0.0
    assert above.least_normal_n == 0.0


def test_robot_that_cannot_slide_tips_over_its_feet():
    """With much friction foot B lifts where √((R/2)² + h²) u ω² = R W/2, h of the motor axis."""
    robot = TABLE_I._replace(mu=10.0)
    arm = math.hypot(robot.foot_radius_m / 2.0, robot.motors[0].place_m[2])
    tipping = lift_off_speed(robot, TABLE_II) * math.sqrt(robot.foot_radius_m / 2.0 / arm)
    below, above = 0.99 * tipping, 1.01 * tipping
    assert motion(Drive(-below, below), robot=robot).least_normal_n > 0.0
    assert motion(Drive(-above, above), robot=robot).least_normal_n == 0.0


def test_whole_robot_lifts_off_at_its_lift_off_speed():
    """Turning, all three feet unload alike: each carries (W − u ω²)/3 at least."""
    top = lift_off_speed(TABLE_I, TABLE_II)
    weight = (TABLE_I.mass_kg + 2.0 * TABLE_II.m) * TABLE_II.g
    below = motion(Drive(0.99 * top, 0.99 * top))
    assert below.least_normal_n == pytest.approx(weight * (1.0 - 0.99**2) / 3.0, rel=0.02)
    assert below.airborne_share == 0.0
    assert motion(Drive(1.01 * top, 1.01 * top)).airborne_share > 0.01


def test_parts_of_a_drive_join_in_every_bit():
    whole, parts = (standing_state(TABLE_I, 0.0, 0.0, 0.0) for _ in range(2))
    means, drive = np.empty(len(MeanMotion._fields)), Drive(-900.0, 950.0, 0.3, -1.0)
    drive_body(whole, RIG, drive, 0, 3000, means)
    drive_body(parts, RIG, drive, 0, 1000, means)
    drive_body(parts, RIG, drive, 1000, 2000, means)
    assert whole.tobytes() == parts.tobytes()
    assert whole[NORMAL_IMPULSE].sum() > 0.0


@pytest.mark.parametrize(
    "drive",
    [
        Drive(-900.0, 900.0),
        Drive(900.0, 900.0),
        Drive(-900.0, 900.0, 0.0, QUARTER),
        Drive(900.0, 900.0, 0.0, HALF),
        Drive(-1050.0, 1050.0),
    ],
)
def test_halving_the_step_changes_mean_speeds_by_less_than_a_percent(drive):
    found = [motion(drive, dt_s=dt) for dt in (2e-5, 1e-5, 5e-6)]
    for coarse, fine in itertools.pairwise(found):
        size = math.hypot(fine.forward_m_s, fine.lateral_m_s)
        apart = math.hypot(
            coarse.forward_m_s - fine.forward_m_s, coarse.lateral_m_s - fine.lateral_m_s
        )
        assert apart < 0.01 * size + 1e-6
        assert coarse.yaw_rate_rad_s == pytest.approx(fine.yaw_rate_rad_s, rel=0.01, abs=2e-4)


@pytest.mark.parametrize("drive", [Drive(-900.0, 900.0), Drive(900.0, 900.0, 0.0, HALF)])
def test_loose_sweeps_change_mean_speeds_little(drive):
    """The solver's tolerance of 1 % against contacts solved out: within 0.5 % of a drive speed."""
    found, solved = motion(drive), motion(drive, tolerance=1e-6)
    assert found.forward_m_s == pytest.approx(solved.forward_m_s, rel=5e-3, abs=1.25e-5)
    assert found.yaw_rate_rad_s == pytest.approx(solved.yaw_rate_rad_s, rel=5e-3, abs=5e-4)
