"""From a commanded direction to the set points of two motors.

A command is a straight line: its direction and its end, the centre of the neighbouring cell. The
robot turns on the spot until it faces the line (forwards or backwards, whichever needs less
rotation), then drives along it; the speed difference of the motors holds the heading against noise
and the unknown motor phase. At the end of the line it stops and waits.
"""

import math

import numpy as np

from cosim.jit import inlined
from cosim.params import SteeringParams
from cosim.rotation import wrapped

HOLD, START, TURN, DRIVE = 0.0, 1.0, 2.0, 3.0
MODES = ("hold", "start", "turn", "drive")

# Layout of one robot's command, float64: what is commanded, then what the controller remembers.
GOAL_X, GOAL_Y = 0, 1  # end of the line, m
DIRECTION = 2  # of the line, rad
MODE = 3  # HOLD, START (a fresh command), TURN or DRIVE
SENSE = 4  # 1.0 drives forwards, −1.0 backwards
HEADING_ERROR = 5  # rad, for inspection
COMMAND_SIZE = 6


@inlined
def steer(
    command: np.ndarray, x: float, y: float, heading: float, params: SteeringParams
) -> tuple[float, float]:
    """Set points (ω_D, ω_E) in rad/s for one control period.

    With the signs of Eq. (3), (−, +) drives towards +x of the body and (+, +) turns
    counter-clockwise; adding the same difference to both therefore turns a driving robot
    counter-clockwise, forwards and backwards alike.

    Args:
        command: shape (COMMAND_SIZE,), see the layout above; the controller's memory is updated.
        x, y: position in m.
        heading: in rad.
        params: gains and speeds.
    """
    if command[MODE] == HOLD:
        return 0.0, 0.0
    ux, uy = math.cos(command[DIRECTION]), math.sin(command[DIRECTION])
    dx, dy = command[GOAL_X] - x, command[GOAL_Y] - y
    if ux * dx + uy * dy <= 0.0:
        command[MODE] = HOLD
        command[HEADING_ERROR] = 0.0
        return 0.0, 0.0

    left_of_line = uy * dx - ux * dy
    course = command[DIRECTION] - math.atan(left_of_line / params.lookahead_m)
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
    if command[MODE] == TURN:
        turn = math.copysign(params.turn_speed_rad_s, error)
        return turn, turn
    limit = params.max_difference_rad_s
    difference = min(limit, max(-limit, params.heading_gain_1_s * error))
    drive = command[SENSE] * params.drive_speed_rad_s
    return difference - drive, difference + drive
