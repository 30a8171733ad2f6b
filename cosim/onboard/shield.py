"""The shield: a monitor that keeps robots apart, for any policy (docs/shield.md: the premises).

Every control period, before the steering, it looks at where robots are estimated to be. The room
of a robot is its distance to another one, an obstacle or the board's edge, and the distance of its
centre to another one's target, less what stopping and the errors of the estimates can cost. A robot
with little room stops, but for one at a time, which retreats straight along its own axis and is
stopped when that costs room. A robot without room does not move.
"""

import math

import numpy as np

from cosim.base.jit import inlined
from cosim.model.params import ShieldParams
from cosim.onboard.estimation import COVARIANCE, POSE
from cosim.onboard.steering import (
    DIRECTION,
    GOAL_X,
    GOAL_Y,
    HEADING_ERROR,
    HOLD,
    MODE,
    RETREAT,
    SENSE,
)
from cosim.physics.collision import away_from

# Layout of what the shield knows of one robot, float64.
PARKED = 0  # 1.0: it has arrived, and does not retreat
REFERENCE = 1  # room when its retreat began, without the error of estimates, m
FAILURES = 2  # retreats given up since it had room
STOPS = 3  # moves and retreats that the shield has ended
SHIELD_SIZE = 4


@inlined
def guard(
    commands: np.ndarray,
    estimates: np.ndarray,
    shields: np.ndarray,
    first: int,
    robots: int,
    board: np.ndarray,
    obstacles: np.ndarray,
    forbidden: np.ndarray,
    diameter_m: float,
    params: ShieldParams,
) -> None:
    """Stop the robots of an episode that lack room, and let one of them retreat.

    Args:
        commands: (B, COMMAND_SIZE), see `cosim.onboard.steering`; changed.
        estimates: (B, ESTIMATE_SIZE), see `cosim.onboard.estimation`.
        shields: (B, SHIELD_SIZE), see the layout; changed.
        first: column of the episode's first robot; the others follow.
        robots: their number.
        board: (2,) extent of the board in m.
        obstacles: (M, 4) rectangles left, bottom, right, top in m.
        forbidden: (B, F, 4) such rectangles that each robot's centre may not enter.
        diameter_m: of every robot.
        params: what to keep.
    """
    retreating, chosen, best, along = False, -1, -math.inf, 0.0
    for i in range(first, first + robots):
        command, shield = commands[i], shields[i]
        room, deviation, away_x, away_y = _room(
            estimates, i, first, robots, board, obstacles, forbidden[i], diameter_m, params
        )
        jitter = params.jitter * deviation
        # What a retreat is judged by: not less room because a robot that drives is less sure.
        clear = room + params.deviations * deviation
        if room >= params.room_m + jitter:
            shield[FAILURES] = 0.0
            retreating |= command[MODE] == RETREAT
            continue
        if command[MODE] == RETREAT:
            lost = clear < shield[REFERENCE] - params.loss_m - jitter
            if room >= 0.0 and not lost:
                retreating = True
                continue
            if lost:
                shield[FAILURES] += 1.0
        if command[MODE] != HOLD:
            command[MODE], command[HEADING_ERROR] = HOLD, 0.0
            shield[STOPS] += 1.0
        if room < 0.0 or shield[PARKED] > 0.0:
            continue
        heading = estimates[i, POSE + 2]
        cosine = math.cos(heading) * away_x + math.sin(heading) * away_y
        # Fewest failures first, then the robot that faces most along the line, then the last one.
        merit = abs(cosine) - 2.0 * shield[FAILURES]
        if merit >= best:
            chosen, best, along = i, merit, cosine
            shield[REFERENCE] = clear
    if chosen >= 0 and not retreating:
        sense = 1.0 if along >= 0.0 else -1.0
        if shields[chosen, FAILURES] % 2.0 == 1.0:
            sense = -sense
        _retreat(commands[chosen], estimates[chosen], sense, params.retreat_m)


@inlined
def _retreat(command: np.ndarray, estimate: np.ndarray, sense: float, length_m: float) -> None:
    """Command a straight line along the robot's axis, forwards (1.0) or backwards (−1.0)."""
    heading = estimate[POSE + 2]
    command[MODE], command[SENSE] = RETREAT, sense
    command[DIRECTION] = heading if sense > 0.0 else heading + math.pi
    command[GOAL_X] = estimate[POSE] + sense * length_m * math.cos(heading)
    command[GOAL_Y] = estimate[POSE + 1] + sense * length_m * math.sin(heading)


@inlined
def plan_margin(estimates: np.ndarray, params: ShieldParams) -> float:
    """Gap in m between plans of robots whose drives the shield will not end, unless they stray."""
    variance = 0.0
    for i in range(len(estimates)):
        variance = max(variance, variance_of(estimates[i]))
        for j in range(i):
            variance = max(variance, variance_of(estimates[i]) + variance_of(estimates[j]))
    return stopping_gap(math.sqrt(variance), params) + params.stray_m


@inlined
def stopping_gap(deviation_m: float, params: ShieldParams) -> float:
    """Return the gap in m at which robots stop, for the standard deviation of their difference."""
    error = (params.deviations + params.jitter) * deviation_m
    return 2.0 * params.stopping_m + error + params.room_m


@inlined
def variance_of(estimate: np.ndarray) -> float:
    """Return the variance in m² of a position in its worst direction; 0 without a camera."""
    xx, xy, yy = estimate[COVARIANCE], estimate[COVARIANCE + 1], estimate[COVARIANCE + 4]
    return 0.5 * (xx + yy) + math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)


@inlined
def _room(
    estimates: np.ndarray,
    i: int,
    first: int,
    robots: int,
    board: np.ndarray,
    obstacles: np.ndarray,
    forbidden: np.ndarray,
    diameter_m: float,
    params: ShieldParams,
) -> tuple[float, float, float, float]:
    """Return the least room of a robot and the standard deviation of it, in m, and the way out."""
    x, y, variance = estimates[i, POSE], estimates[i, POSE + 1], variance_of(estimates[i])
    deviation = math.sqrt(variance)
    alone = params.stopping_m + params.deviations * deviation
    least, away_x, away_y = x - alone, 1.0, 0.0
    for room, toward_x, toward_y in (
        (board[0] - x - alone, -1.0, 0.0),
        (y - alone, 0.0, 1.0),
        (board[1] - y - alone, 0.0, -1.0),
    ):
        if room < least:
            least, away_x, away_y = room, toward_x, toward_y
    for rectangles, reach in ((obstacles, 0.5 * diameter_m), (forbidden, 0.0)):
        for k in range(len(rectangles)):
            dx, dy = away_from(rectangles[k], x, y)
            distance = math.sqrt(dx * dx + dy * dy)
            if distance - reach - alone < least:
                least, away_x, away_y = distance - reach - alone, dx, dy
                if distance == 0.0:  # within: no direction leads away
                    away_x = 1.0
    for j in range(first, first + robots):
        if j == i:
            continue
        dx, dy = x - estimates[j, POSE], y - estimates[j, POSE + 1]
        # Errors of two robots are independent.
        of_both = math.sqrt(variance + variance_of(estimates[j]))
        kept = diameter_m + 2.0 * params.stopping_m + params.deviations * of_both
        room = math.sqrt(dx * dx + dy * dy) - kept
        if room < least:
            least, deviation, away_x, away_y = room, of_both, dx, dy
    length = math.sqrt(away_x * away_x + away_y * away_y)
    return least, deviation, away_x / length, away_y / length
