"""Commands become motions: signs, least rotation, holding the line, stopping."""

import math

import numpy as np
import pytest

from cosim.params import STEERING
from cosim.steering import COMMAND_SIZE, DRIVE, HOLD, MODE, SENSE, START, TURN, steer


def command(direction=0.0, mode=START, x=1.0, y=0.0):
    row = np.zeros(COMMAND_SIZE)
    row[:5] = x, y, direction, mode, 1.0
    return row


def test_waits_without_a_command():
    assert steer(np.zeros(COMMAND_SIZE), 0.0, 0.0, 1.0, STEERING) == (0.0, 0.0)


def test_drives_straight_when_it_faces_the_line():
    row = command()
    d, e = steer(row, 0.0, 0.0, 0.0, STEERING)
    assert (d, e) == (-STEERING.drive_speed_rad_s, STEERING.drive_speed_rad_s)
    assert row[MODE] == DRIVE


@pytest.mark.parametrize(("heading", "turn"), [(-0.5, 1.0), (0.5, -1.0)])
def test_turns_on_the_spot_towards_the_line(heading, turn):
    d, e = steer(command(), 0.0, 0.0, heading, STEERING)
    assert d == e == turn * STEERING.turn_speed_rad_s


@pytest.mark.parametrize("heading", np.linspace(-math.pi, math.pi, 25))
def test_never_turns_by_more_than_a_right_angle(heading):
    row = command()
    steer(row, 0.0, 0.0, heading, STEERING)
    sense = 1.0 if abs(heading) <= math.pi / 2.0 else -1.0
    assert row[SENSE] == sense


def test_backwards_reverses_both_motors():
    row = command()
    d, e = steer(row, 0.0, 0.0, math.pi, STEERING)
    assert (d, e) == pytest.approx((STEERING.drive_speed_rad_s, -STEERING.drive_speed_rad_s))


@pytest.mark.parametrize("sense", [0.0, math.pi])
def test_speed_difference_turns_the_same_way_in_both_senses(sense):
    row = command()
    steer(row, 0.0, 0.0, sense, STEERING)
    d, e = steer(row, 0.0, 0.0, sense - 0.1, STEERING)  # must turn counter-clockwise
    assert d + e == pytest.approx(2.0 * STEERING.heading_gain_1_s * 0.1)


def test_steers_back_to_a_line_it_has_left():
    row = command(mode=DRIVE)
    d, e = steer(row, 0.5, 0.001, 0.0, STEERING)  # left of the line: turn right
    assert d + e < 0.0


def test_large_error_while_driving_turns_again():
    row = command(mode=DRIVE)
    steer(row, 0.0, 0.0, STEERING.turn_again_rad + 0.01, STEERING)
    assert row[MODE] == TURN


def test_stops_at_the_end_of_the_line():
    row = command(mode=DRIVE)
    assert steer(row, 1.0, 0.002, 0.0, STEERING) == (0.0, 0.0)
    assert row[MODE] == HOLD
