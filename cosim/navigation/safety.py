"""Optional safety layer: a robot begins no move that comes too close to another robot's plan.

A plan is the line from where a robot is to where it is going; a robot that stands has a point. A
move whose plan is blocked by a robot that is moving waits for it; one blocked by a robot that
stands or by an obstacle yields to the nearest direction that is free. Policies know nothing of the
layer, and it knows nothing of policies.
"""

import math

import numpy as np

from cosim.base.scenario import Scenario
from cosim.navigation.features import DIRECTION_COUNT, DIRECTIONS
from cosim.navigation.observing import cells_of

WAIT = -1
# nearest direction first, and of two equally near the one to the left
_TURNS = (0, 1, -1, 2, -2, 3, -3, 4)
_ROUNDING_M = 1e-9


def point_to_line(point: np.ndarray, line: np.ndarray) -> float:
    """Distance of a point (2,) from a line (2, 2) of two ends, in their unit."""
    along = line[1] - line[0]
    length = float(along @ along)
    share = 0.0 if length == 0.0 else float(np.clip((point - line[0]) @ along / length, 0.0, 1.0))
    return math.dist(point, line[0] + share * along)


def line_to_line(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two lines, each (2, 2): two ends. Zero if they cross."""
    if _cross(a, b) and _cross(b, a):
        return 0.0
    return min(*(point_to_line(end, b) for end in a), *(point_to_line(end, a) for end in b))


def _cross(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the ends of b lie on both sides of the line through a."""
    u, v, w = a[1] - a[0], b[0] - a[0], b[1] - a[0]
    return (u[0] * v[1] - u[1] * v[0]) * (u[0] * w[1] - u[1] * w[0]) < 0.0


def permitted(
    scenario: Scenario,
    bodies: np.ndarray,
    goals: np.ndarray,
    robot: int,
    direction: int,
    margin_m: float,
) -> int:
    """The direction that a robot may take when it wants another.

    Args:
        scenario: board, obstacles and diameter of the robots.
        bodies: (N, STATE_SIZE) states, layout in `cosim.physics.body`.
        goals: (N, 2) end of each robot's move in m, NaN for a robot that stands.
        robot: that decides; it stands.
        direction: index of the direction that it wants.
        margin_m: least gap to the other robots' plans and to obstacles.

    Returns:
        The direction itself if it is free, WAIT if a moving robot blocks it or nothing is free,
        else the nearest free direction.
    """
    positions = bodies[:, :2]
    moving = np.isfinite(goals[:, 0])
    ends = np.where(moving[:, None], goals, positions)
    cell = cells_of(bodies, scenario)[robot]
    radius_m = scenario.robot_diameter_m / 2.0
    sides = _sides(scenario.walls * scenario.cell_m)
    others = [k for k in range(len(bodies)) if k != robot]
    for turn in _TURNS:
        candidate = (direction + turn) % DIRECTION_COUNT
        column, row = cell + DIRECTIONS[candidate]
        on_board = 0 <= column < scenario.columns and 0 <= row < scenario.rows
        if turn != 0 and not on_board:
            continue
        plan = np.array([positions[robot], scenario.centre_m((column, row))])
        if any(_too_close(plan, side, radius_m + margin_m) for side in sides):
            continue
        blocking = [
            k
            for k in others
            if _too_close(plan, np.array([positions[k], ends[k]]), 2.0 * radius_m + margin_m)
        ]
        if not blocking:
            return candidate
        if turn == 0 and np.any(moving[blocking]):
            return WAIT
    return WAIT


def _sides(rectangles: np.ndarray) -> np.ndarray:
    """(4 M, 2, 2) both ends of every side of rectangles (M, 4) left, bottom, right, top.

    A plan that begins outside of a rectangle comes as close to it as to the nearest of its sides.
    """
    corners = rectangles[:, [[0, 1], [2, 1], [2, 3], [0, 3]]]
    return np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)


def _too_close(plan: np.ndarray, other: np.ndarray, least_m: float) -> bool:
    # a robot that is too close already may move away
    allowed = min(least_m, point_to_line(plan[0], other))
    return line_to_line(plan, other) < allowed - _ROUNDING_M
