"""Commands become set points: signs, least rotation, holding the line, dither, stopping."""

import math

import numpy as np
import pytest

from cosim.model.params import STEERING
from cosim.onboard import steering
from cosim.onboard.steering import (
    COMMAND_SIZE,
    DIRECT,
    DRIVE,
    HOLD,
    MODE,
    OMEGA_D,
    OMEGA_E,
    PAST,
    RETREAT,
    SENSE,
    SPEED,
    START,
    THROUGH,
    TURN,
    YAW_RATE,
)

PERIOD_S = 1e-3
STEADY = STEERING._replace(dither_rad_s=0.0)


def command(direction=0.0, mode=START, x=1.0, y=0.0):
    row = np.zeros(COMMAND_SIZE)
    row[:5] = x, y, direction, mode, 1.0
    return row


def steer(row, x, y, heading, params=STEADY):
    set_points = np.empty(2)
    steering.steer(row, x, y, heading, PERIOD_S, params, set_points)
    return tuple(set_points.tolist())


FORWARDS, TURNING = STEERING.forward_speed_rad_s, STEERING.turn_speed_rad_s


def test_waits_without_a_command_and_hands_set_points_through():
    row = np.zeros(COMMAND_SIZE)
    assert steer(row, 0.0, 0.0, 1.0, STEERING) == (0.0, 0.0)
    row[[OMEGA_D, OMEGA_E, MODE]] = -900.0, 910.0, DIRECT
    assert steer(row, 0.0, 0.0, 1.0, STEERING) == (-900.0, 910.0)


def test_drives_on_past_the_end_if_it_is_not_to_stop():
    row = command(x=0.01)
    row[THROUGH] = 1.0
    steer(row, 0.0, 0.0, 0.0)
    assert steer(row, 0.0101, 0.0, 0.0) == (-FORWARDS, FORWARDS)
    assert row[MODE] == PAST


@pytest.mark.parametrize(
    ("heading", "speeds", "mode"),
    [
        (0.0, (-FORWARDS, FORWARDS), DRIVE),
        (math.pi, (STEERING.backward_speed_rad_s, -STEERING.backward_speed_rad_s), DRIVE),
        (-0.5, (TURNING, TURNING), TURN),
        (0.5, (-TURNING, -TURNING), TURN),
    ],
)
def test_drives_when_it_faces_the_line_and_turns_on_the_spot_towards_it(heading, speeds, mode):
    row = command()
    assert steer(row, 0.0, 0.0, heading) == pytest.approx(speeds)
    assert row[MODE] == mode


@pytest.mark.parametrize("heading", np.linspace(-math.pi, math.pi, 25))
def test_never_turns_by_more_than_a_right_angle(heading):
    row = command()
    steer(row, 0.0, 0.0, heading)
    sense = 1.0 if abs(heading) <= math.pi / 2.0 else -1.0
    assert row[SENSE] == sense


@pytest.mark.parametrize("sense", [0.0, math.pi])
def test_speed_difference_turns_the_same_way_in_both_senses(sense):
    row = command()
    steer(row, 0.0, 0.0, sense)
    d, e = steer(row, 0.0, 0.0, sense - 0.01)  # must turn counter-clockwise
    assert d + e == pytest.approx(2.0 * STEERING.heading_gain_1_s * 0.01)


@pytest.mark.parametrize("heading", [0.1, -0.1, math.pi + 0.1, math.pi - 0.1])
def test_no_motor_exceeds_its_bound_while_driving(heading):
    params = STEADY._replace(max_speed_rad_s=1050.0)
    row = command()
    d, e = steer(row, 0.0, 0.0, heading, params)
    assert row[MODE] == DRIVE
    assert max(abs(d), abs(e)) == pytest.approx(params.max_speed_rad_s)
    assert abs(d + e) == pytest.approx(2.0 * params.max_difference_rad_s)


def test_steers_back_to_a_line_it_has_left():
    row = command(mode=DRIVE)
    d, e = steer(row, 0.5, 0.001, 0.0)  # left of the line: turn right
    assert d + e < 0.0


def test_aims_at_the_goal_when_it_is_nearer_than_the_lookahead():
    distance, aside = 0.5 * (STEERING.lookahead_m + STEERING.least_lookahead_m), 0.001
    row = command(mode=DRIVE)
    aim = -math.atan(aside / distance)
    d, e = steer(row, 1.0 - distance, aside, aim)
    assert d + e == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("mode", "error", "after"),
    [
        (DRIVE, STEERING.turn_again_rad + 0.01, TURN),
        # an error that ends turning does not begin it
        (DRIVE, 0.5 * (STEERING.turned_rad + STEERING.turn_again_rad), DRIVE),
        (TURN, 0.5 * (STEERING.turned_rad + STEERING.turn_again_rad), TURN),
    ],
)
def test_a_large_error_while_driving_turns_again(mode, error, after):
    row = command(mode=mode)
    steer(row, 0.0, 0.0, error)
    assert row[MODE] == after


@pytest.mark.parametrize("facing", [0.0, math.pi])
@pytest.mark.parametrize("error", [-0.01, 0.0, 0.01])
def test_the_filter_is_given_the_motion_of_a_drive(facing, error):
    """Eq. (3) turns both motors by one difference: the yaw rate is proportional to it."""
    row = command()
    steer(row, 0.0, 0.0, facing)
    d, e = steer(row, 0.0, 0.0, facing - error)
    assert row[SPEED] == pytest.approx(math.cos(facing) * STEERING.drive_speed_m_s)
    assert row[YAW_RATE] == pytest.approx(STEERING.yaw_gain * (d + e) / 2.0)
    assert np.sign(round(row[YAW_RATE], 9)) == np.sign(error)


@pytest.mark.parametrize("heading", [-0.5, 0.5])
def test_the_filter_is_given_the_motion_of_a_turn(heading):
    row = command()
    steer(row, 0.0, 0.0, heading)
    assert row[[SPEED, YAW_RATE]].tolist() == [
        0.0,
        -math.copysign(STEERING.turn_rate_rad_s, heading),
    ]


@pytest.mark.parametrize(("mode", "through"), [(RETREAT, 1.0), (DRIVE, 0.0)])
def test_stops_at_the_end_of_the_line(mode, through):
    row = command(mode=mode)
    row[THROUGH] = through
    assert steer(row, 1.0001, 0.002, 0.0) == (0.0, 0.0)
    assert row[MODE] == HOLD


@pytest.mark.parametrize("heading", [0.0, 0.5])
def test_dither_takes_the_motor_phase_around_and_back(heading):
    """The mean set points are those without dither, the phase between them covers a turn."""
    row, plain = command(), steer(command(), 0.0, 0.0, heading)
    turn_s = 2.0 * math.pi / (2.0 * STEERING.dither_rad_s)
    calls = [
        steer(row, 0.0, 0.0, heading, STEERING) for _ in range(2 * math.ceil(turn_s / PERIOD_S))
    ]
    added = np.array(calls) - plain
    phase = np.cumsum(added[:, 1] - added[:, 0]) * PERIOD_S
    if heading == 0.0:  # driving: the sum of the speeds is the difference of their magnitudes
        phase = np.cumsum(added.sum(axis=1)) * PERIOD_S
    assert np.abs(added).max() == pytest.approx(STEERING.dither_rad_s)
    assert np.abs(added.mean(axis=0)).max() < 0.02 * STEERING.dither_rad_s
    assert np.ptp(phase) == pytest.approx(2.0 * math.pi, rel=0.02)
