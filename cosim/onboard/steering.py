"""From a commanded direction to the set points of two motors.

A command is a straight line: its direction and its end, the centre of the neighbouring cell. The
robot turns on the spot until it almost faces the line (forwards or backwards, whichever needs less
rotation), then drives along it; the speed difference of the motors holds the course. At the end of
the line it stops and waits, or drives on until the next decision, if the command says so.

The phase between the two motors is not controlled, and at a constant phase the robot yaws and
drifts sideways. A small speed difference that changes sign whenever the phase has gone once around
(the dither) makes every drive the average over all phases. Why this law and no other:
docs/steering.md.
"""

import math

import numpy as np

from cosim.base.jit import inlined
from cosim.model.params import SteeringParams
from cosim.physics.rotation import wrapped
from cosim.physics.trig import arctangent, sine_and_cosine

HOLD, START, TURN, DRIVE, DIRECT, PAST, RETREAT = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0
MODE_NAMES = ("hold", "start", "turn", "drive", "direct", "drive on", "retreat")

# Layout of one robot's command, float64: what is commanded, then what the controller remembers.
GOAL_X, GOAL_Y = 0, 1  # end of the line, m
OMEGA_D, OMEGA_E = 0, 1  # in mode DIRECT: the set points themselves, rad/s
DIRECTION = 2  # of the line, rad
# HOLD, START (a fresh command), TURN, DRIVE, DIRECT, PAST the end and driving on, or RETREAT, which
# drives and neither turns on the spot nor drives on
MODE = 3
SENSE = 4  # 1.0 drives forwards, −1.0 backwards
HEADING_ERROR = 5  # rad, for inspection
DITHER_PHASE = 6  # phase between the motors that the dither has added, rad; with its sign
DITHER_SIGN = 7
SPEED, YAW_RATE = 8, 9  # what the robot should do by that: along its heading in m/s, and rad/s
THROUGH = 10  # 1.0 if the robot does not stop at the end of the line
COMMAND_SIZE = 11


@inlined
def steer(
    command: np.ndarray,
    x: float,
    y: float,
    heading: float,
    period_s: float,
    params: SteeringParams,
    portable: bool = False,
) -> tuple[float, float]:
    """Set points (ω_D, ω_E) in rad/s for one control period.

    With the signs of Eq. (3), (−, +) drives towards +x of the body and (+, +) turns
    counter-clockwise; adding the same difference to both therefore turns a driving robot
    counter-clockwise, forwards and backwards alike.

    Args:
        command: shape (COMMAND_SIZE,), see the layout above; the controller's memory is updated.
    """
    command[SPEED] = command[YAW_RATE] = 0.0
    if command[MODE] == HOLD:
        return 0.0, 0.0
    if command[MODE] == DIRECT:
        return command[OMEGA_D], command[OMEGA_E]
    uy, ux = sine_and_cosine(command[DIRECTION], portable)
    dx, dy = command[GOAL_X] - x, command[GOAL_Y] - y
    remaining = ux * dx + uy * dy
    if remaining <= 0.0:
        on = command[THROUGH] > 0.0 and command[MODE] != RETREAT
        command[MODE] = PAST if on else HOLD
        if command[MODE] == HOLD:
            command[HEADING_ERROR] = 0.0
            return 0.0, 0.0

    left_of_line = uy * dx - ux * dy
    lookahead = min(params.lookahead_m, max(params.least_lookahead_m, remaining))
    course = command[DIRECTION] - arctangent(left_of_line / lookahead, portable)
    error = wrapped(course - heading)
    if command[MODE] == START:
        command[SENSE] = 1.0 if abs(error) <= math.pi / 2.0 else -1.0
        command[MODE] = TURN
    if command[SENSE] < 0.0:
        error = wrapped(error + math.pi)
    command[HEADING_ERROR] = error

    if command[MODE] == TURN and abs(error) < params.turned_rad:
        command[MODE] = DRIVE
    elif command[MODE] == DRIVE and abs(error) > params.turn_again_rad:
        command[MODE] = TURN
    dither = _dither(command, period_s, params)
    if command[MODE] == TURN:
        turn = math.copysign(params.turn_speed_rad_s, error)
        command[YAW_RATE] = math.copysign(params.turn_rate_rad_s, error)
        return turn - dither, turn + dither
    drive = params.forward_speed_rad_s if command[SENSE] > 0.0 else params.backward_speed_rad_s
    limit = params.max_difference_rad_s
    difference = min(limit, max(-limit, params.heading_gain_1_s * error))
    # The faster motor stays below hopping; the difference is kept by slowing the other one.
    command[SPEED] = command[SENSE] * params.drive_speed_m_s
    command[YAW_RATE] = params.yaw_gain * difference
    drive = command[SENSE] * min(drive, params.max_speed_rad_s - abs(difference))
    difference += dither
    return difference - drive, difference + drive


@inlined
def _dither(command: np.ndarray, period_s: float, params: SteeringParams) -> float:
    """Speed added to one motor and taken from the other, in rad/s; its sign changes every turn."""
    if command[DITHER_PHASE] <= 0.0:
        command[DITHER_SIGN] = 1.0
    elif command[DITHER_PHASE] >= 2.0 * math.pi:
        command[DITHER_SIGN] = -1.0
    dither = command[DITHER_SIGN] * params.dither_rad_s
    command[DITHER_PHASE] += 2.0 * dither * period_s
    return dither
