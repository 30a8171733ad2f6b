"""The shield: a monitor that keeps robots apart, for any policy (docs/shield.md: the premises).

Every control period, before the steering, it looks at where robots are estimated to be. The room
of a robot is its distance to another one, an obstacle or the board's edge, and the distance of its
centre to another one's target, less what stopping and the errors of the estimates can cost. A robot
with little room stops. In each zone one robot at a time retreats instead, straight along its own
axis, until that costs room; a robot that cannot drive backwards turns first. A robot without room
does not move.
"""

import math

import numpy as np

from cosim.base.jit import inlined
from cosim.model.params import ShieldParams, SteeringParams
from cosim.onboard.estimation import COVARIANCE, POSE
from cosim.onboard.state import FAILURES, PARKED, REFERENCE, STOPS, Floor, Onboard
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
from cosim.physics.neighbours import FOUND, HEAD, NEXT, Grid, find_near, list_by_cells
from cosim.physics.trig import arctangent, sine_cosine

# Least side of the zones of a board, in each of which one robot retreats at a time: pairs far apart
# do not wait for each other. The paper's board is one zone.
ZONE_M = 0.45


@inlined
def guard(
    onboard: Onboard,
    floor: Floor,
    episode: int,
    robots: int,
    diameter_m: float,
    steering: SteeringParams,
    params: ShieldParams,
) -> None:
    """Stop the robots of an episode that lack room, and let one of them in each zone retreat."""
    reverses = steering.backward_speed_rad_s > 0.0
    # What is beyond the gap leaves more room than any robot is stopped for, see `stopping_gap`.
    first, variance, estimates = episode * robots, 0.0, onboard.estimates
    for i in range(first, first + robots):
        variance = max(variance, variance_of(estimates[i]))
    gap, board = stopping_gap(math.sqrt(2.0 * variance), params), floor.boards[episode]
    xs, ys, reach = estimates[:, POSE], estimates[:, POSE + 1], diameter_m + gap
    others = list_by_cells(onboard.near_robots, xs, ys, first, robots, board, reach)
    zones = list_by_cells(onboard.near_zone, xs, ys, first, robots, board, ZONE_M)
    cell_m, xs, ys = floor.cells_m[episode], floor.targets[:, 0], floor.targets[:, 1]
    reach = 2.0 * cell_m + gap
    targets = list_by_cells(onboard.near_targets, xs, ys, first, robots, board, reach)
    for zone in range(first, first + zones.columns * zones.rows):
        retreating, chosen, best, along, across = False, -1, -math.inf, 0.0, 0.0
        following = onboard.near_zone[HEAD, zone]
        while following >= 0:
            i, following = following, onboard.near_zone[NEXT, following]
            command, shield = onboard.commands[i], onboard.shields[i]
            room, deviation, away_x, away_y = _room(
                onboard, floor, episode, i, others, targets, diameter_m, params
            )
            jitter = params.jitter * deviation
            # What a retreat is judged by: not less room because a robot that drives is less sure.
            clear = room + params.deviations * deviation
            if room >= params.room_m + jitter:
                shield[FAILURES] = 0.0
                retreating |= command[MODE] == RETREAT
                continue
            if command[MODE] == RETREAT:
                if not reverses and abs(command[HEADING_ERROR]) > steering.turn_again_rad:
                    # It turns, which `room_m` has room for.
                    shield[REFERENCE] = min(shield[REFERENCE], clear)
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
            s, c = sine_cosine(estimates[i, POSE + 2])
            cosine = c * away_x + s * away_y
            # Fewest failures first, then the one that faces most along the line (away, if it cannot
            # drive backwards), then the last.
            merit = (abs(cosine) if reverses else cosine) - 2.0 * shield[FAILURES]
            if merit >= best:
                chosen, best, along, across = i, merit, cosine, c * away_y - s * away_x
                shield[REFERENCE] = clear
        if chosen >= 0 and not retreating:
            sense = 1.0 if along >= 0.0 or not reverses else -1.0
            turned = 0.0 if reverses else _angle_of(along, across)
            if reverses and onboard.shields[chosen, FAILURES] % 2.0 == 1.0:
                sense = -sense
            _retreat(onboard.commands[chosen], estimates[chosen], turned, sense, params.retreat_m)


@inlined
def _retreat(
    command: np.ndarray, estimate: np.ndarray, turned: float, sense: float, length_m: float
) -> None:
    """Command a straight line forwards (1.0) or backwards (−1.0) along an axis.

    `turned` is its angle in rad from the robot's axis.
    """
    heading = estimate[POSE + 2] + turned
    command[MODE], command[SENSE] = RETREAT, sense
    command[DIRECTION] = heading if sense > 0.0 else heading + math.pi
    s, c = sine_cosine(heading)
    command[GOAL_X] = estimate[POSE] + sense * length_m * c
    command[GOAL_Y] = estimate[POSE + 1] + sense * length_m * s


@inlined
def _angle_of(x: float, y: float) -> float:
    """Return the angle in rad of a direction from the x axis."""
    if abs(x) < abs(y):
        return math.copysign(0.5 * math.pi, y) - arctangent(x / y)
    return arctangent(y / x) + (math.pi if x < 0.0 else 0.0)


@inlined
def plan_margin(estimates: np.ndarray, params: ShieldParams) -> float:
    """Gap in m between plans at which the shield ends no drives, unless robots stray."""
    largest = second = 0.0
    for i in range(len(estimates)):
        variance = variance_of(estimates[i])
        largest, second = max(largest, variance), max(second, min(largest, variance))
    return stopping_gap(math.sqrt(largest + second), params) + params.stray_m


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
    onboard: Onboard,
    floor: Floor,
    episode: int,
    i: int,
    others: Grid,
    targets: Grid,
    diameter_m: float,
    params: ShieldParams,
) -> tuple[float, float, float, float]:
    """Return the least room of a robot and the standard deviation of it, in m, and the way out."""
    estimates, board = onboard.estimates, floor.boards[episode]
    x, y, variance = estimates[i, POSE], estimates[i, POSE + 1], variance_of(estimates[i])
    deviation = math.sqrt(variance)
    alone = params.stopping_m + params.deviations * deviation
    inside = alone + floor.margins_m[episode]
    least, away_x, away_y = x - inside, 1.0, 0.0
    for room, toward_x, toward_y in (
        (board[0] - x - inside, -1.0, 0.0),
        (y - inside, 0.0, 1.0),
        (board[1] - y - inside, 0.0, -1.0),
    ):
        if room < least:
            least, away_x, away_y = room, toward_x, toward_y
    obstacles, forbidden = floor.obstacles[episode], floor.forbidden[i]
    for rectangles, reach in ((obstacles, 0.5 * diameter_m), (forbidden, 0.0)):
        for k in range(len(rectangles)):
            room, dx, dy = _room_of(rectangles[k], x, y, reach, alone)
            if room < least:
                least, away_x, away_y = room, dx, dy
    for k in range(targets.first, targets.first + find_near(onboard.near_targets, targets, x, y)):
        target = onboard.near_targets[FOUND, k]
        if floor.owners[target] != i:
            room, dx, dy = _room_of(floor.targets[target], x, y, 0.0, alone)
            if room < least:
                least, away_x, away_y = room, dx, dy
    for k in range(others.first, others.first + find_near(onboard.near_robots, others, x, y)):
        j = onboard.near_robots[FOUND, k]
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


@inlined
def _room_of(
    rectangle: np.ndarray, x: float, y: float, reach: float, alone: float
) -> tuple[float, float, float]:
    """Return the room that a rectangle leaves a robot at (x, y), in m, and the way out."""
    dx, dy = away_from(rectangle, x, y)
    distance = math.sqrt(dx * dx + dy * dy)
    if distance == 0.0:  # within: no direction leads away
        dx = 1.0
    return distance - reach - alone, dx, dy
