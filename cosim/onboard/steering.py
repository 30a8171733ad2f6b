"""From a commanded direction to the set points of the motors.

A command is a straight line: its direction and its end, the centre of the neighbouring cell. The
robot turns on the spot until it almost faces the line (forwards, backwards or sideways if it can,
whichever needs least rotation), then drives along it; a difference of the motors' speeds holds the
course. At the end of
the line it stops and waits, or drives on until the next decision, if the command says so.

The phase between the two motors is not controlled, and at a constant phase the robot yaws and
drifts sideways. A small speed difference that changes sign whenever the phase has gone once around
(the dither) makes every drive the average over all phases. Why this law and no other:
docs/steering.md.
"""

import math

import numpy as np

from cosim.base.jit import inlined
from cosim.model.params import MAX_MOTORS, SteeringParams
from cosim.physics.rotation import wrapped
from cosim.physics.trig import arctangent, sine_cosine

HOLD, START, TURN, DRIVE, DIRECT, PAST, RETREAT = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0
MODE_NAMES = ("hold", "start", "turn", "drive", "direct", "drive on", "retreat")

# Layout of one robot's command, float64: what is commanded, then what the controller remembers.
GOAL_X, GOAL_Y = 0, 1  # end of the line, m
DIRECTION = 2  # of the line, rad
# HOLD, START (a fresh command), TURN, DRIVE, DIRECT, PAST the end and driving on, or RETREAT, which
# does not drive on, and turns on the spot only where a machine cannot drive backwards
MODE = 3
SENSE = 4  # FORWARDS, BACKWARDS, LEFTWARDS or RIGHTWARDS
HEADING_ERROR = 5  # rad, for inspection
DITHER_PHASE = 6  # phase between the motors that the dither has added, rad; with its sign
DITHER_SIGN = 7
SPEED, YAW_RATE = 8, 9  # what the robot should do by that: m/s and rad/s
THROUGH = 10  # 1.0 if the robot does not stop at the end of the line
COURSE = 11  # direction of the speed, from the heading, rad
CLOCK = 12  # of the motors' pulses, s
OMEGA_D, OMEGA_E = 13, 14  # in mode DIRECT: the set points of the first two motors, rad/s
SET_POINTS = slice(OMEGA_D, OMEGA_D + MAX_MOTORS)  # and of all of them
COMMAND_SIZE = SET_POINTS.stop

FORWARDS, BACKWARDS, LEFTWARDS, RIGHTWARDS = 1.0, -1.0, 2.0, -2.0


@inlined
def waits(command: np.ndarray) -> bool:
    """Return whether a robot has ended its move and waits for a decision."""
    return command[MODE] in (HOLD, PAST)


@inlined
def steer(
    command: np.ndarray,
    x: float,
    y: float,
    heading: float,
    period_s: float,
    params: SteeringParams,
    set_points: np.ndarray,
) -> None:
    """Compute the set points of the motors for one control period.

    The machine says which shares of a speed each motor gets for a primitive. With the signs of
    Eq. (3), (ω_D, ω_E) = (−, +) drives towards +x of the body and (+, +) turns counter-clockwise;
    adding the same difference to both therefore turns a driving robot counter-clockwise, forwards
    and backwards alike. Other machines have a difference of their own for each drive.

    Args:
        command: shape (COMMAND_SIZE,), see the layout above; the controller's memory is updated.
        set_points: shape (motors,), rad/s, overwritten.
    """
    shares = params.shares
    command[SPEED] = command[YAW_RATE] = command[COURSE] = 0.0
    for k in range(len(shares)):
        set_points[k] = command[OMEGA_D + k] if command[MODE] == DIRECT else 0.0
    if command[MODE] == HOLD or command[MODE] == DIRECT:
        return
    uy, ux = sine_cosine(command[DIRECTION])
    dx, dy = command[GOAL_X] - x, command[GOAL_Y] - y
    remaining = ux * dx + uy * dy
    if remaining <= 0.0:
        on = command[THROUGH] > 0.0 and command[MODE] != RETREAT
        command[MODE] = PAST if on else HOLD
        if command[MODE] == HOLD:
            command[HEADING_ERROR] = 0.0
            return

    left_of_line = uy * dx - ux * dy
    lookahead = min(params.lookahead_m, max(params.least_lookahead_m, remaining))
    course = command[DIRECTION] - arctangent(left_of_line / lookahead)
    error = wrapped(course - heading)
    if command[MODE] == START:
        ahead = abs(error) <= math.pi / 2.0 or params.backward_speed_rad_s <= 0.0
        command[SENSE] = FORWARDS if ahead else BACKWARDS
        if params.side_speed_rad_s > 0.0 and abs(math.pi / 2.0 - abs(error)) < math.pi / 4.0:
            command[SENSE] = LEFTWARDS if error > 0.0 else RIGHTWARDS
        command[MODE] = TURN
    sense = command[SENSE]
    number = 2 * int(abs(sense)) - 2 + int(sense < 0.0)  # of the drive: forwards is 0
    if sense == BACKWARDS:
        error = wrapped(error + math.pi)
    elif sense != FORWARDS:
        error = wrapped(error - 0.25 * math.pi * sense)
    command[HEADING_ERROR] = error

    if command[MODE] == TURN and abs(error) < params.turned_rad:
        command[MODE] = DRIVE
    elif command[MODE] == DRIVE and abs(error) > params.turn_again_rad:
        command[MODE] = TURN
    dither = _dither(command, period_s, params)
    # A machine that cannot drive backwards turns before it retreats.
    around = command[MODE] == RETREAT and params.backward_speed_rad_s <= 0.0
    if command[MODE] == TURN or (around and abs(error) > params.turn_again_rad):
        command[YAW_RATE] = math.copysign(params.turn_rate_rad_s, error)
        for k in range(len(shares)):
            share = shares[k].left_turn if error > 0.0 else shares[k].right_turn
            set_points[k] = params.turn_speed_rad_s * share + dither * shares[k].turn_dither
        return
    drive = params.side_speed_rad_s
    if sense == FORWARDS:
        drive = params.forward_speed_rad_s
    elif sense == BACKWARDS:
        drive = params.backward_speed_rad_s
    own, limit = params.drives[number], params.max_difference_rad_s
    difference = min(limit, max(-limit, params.heading_gain_1_s / own.yaw_gain * error))
    # The faster motor stays below hopping; the difference is kept by slowing the other one.
    command[SPEED] = math.copysign(own.speed * params.drive_speed_m_s, sense)
    command[COURSE] = 0.0 if abs(sense) == FORWARDS else math.pi / 2.0
    command[YAW_RATE] = own.yaw_gain * params.yaw_gain * difference
    drive = min(drive, params.max_speed_rad_s - abs(difference))
    for k in range(len(shares)):
        added = difference * own.difference[k] + dither * shares[k].dither
        set_points[k] = added + drive * shares[k][number]


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


@inlined
def pulse(
    command: np.ndarray, period_s: float, params: SteeringParams, set_points: np.ndarray
) -> None:
    """Let motors with a set point run one after the other, each for a pulse."""
    running = 0
    for k in range(len(params.shares)):
        running += set_points[k] != 0.0
    if running == 0:
        command[CLOCK] = 0.0
        return
    slot_s = params.pulse_s + params.pause_s
    slot = math.floor((command[CLOCK] + 0.5 * period_s) / slot_s)
    on = command[CLOCK] + 0.5 * period_s - slot * slot_s < params.pulse_s
    turn = slot % running
    for k in range(len(params.shares)):
        if set_points[k] != 0.0:
            if turn != 0.0 or not on:
                set_points[k] = 0.0
            turn -= 1.0
    command[CLOCK] += period_s
