"""With the shield, no move begins that comes too close to another robot's plan.

That gets robots past each other; that they never touch is the monitor's part
(`cosim.onboard.shield`).

A plan is the line from where a robot is to where it is going; a robot that stands has a point. A
move with a plan that is blocked by a moving robot waits for it; one blocked by a robot that
stands, by an obstacle or by the board's edge yields to the nearest direction that is free. Policies
know nothing of this, and it knows nothing of policies.
"""

import math
from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined, kernel
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS
from cosim.onboard.observing import cell_of
from cosim.onboard.steering import GOAL_X, GOAL_Y, HOLD, MODE
from cosim.physics.collision import away_from

WAIT = -1
# nearest direction first, and of two equally near the one to the left
NEAREST_FIRST = np.array([0, 1, -1, 2, -2, 3, -3, 4])
DETOUR_DRAWS = len(NEAREST_FIRST)  # uniform numbers that `give_way` uses at most
_ROUNDING_M = 1e-9

Point = tuple[float, float]
Line = tuple[Point, Point]  # both ends


class Board(NamedTuple):
    """Geometry of a scenario; lengths in m."""

    # columns, rows: number of cells
    columns: int
    rows: int
    cell_m: float  # edge of a cell
    diameter_m: float  # of every robot
    margin_m: float  # from the board's edge, within which no move ends
    obstacles: np.ndarray  # (M, 4) float64, rectangles left, bottom, right, top
    # (N, F, 4) float64, such rectangles that each robot's centre may not enter; infinitely far
    # where a robot has fewer
    closed: np.ndarray
    # (N, 4) float64, such rectangles that no robot's centre may enter but its owner's
    targets: np.ndarray
    owners: np.ndarray  # (N,) int64, the owners


def board_of(scenario: Scenario, margin_m: float = 0.0) -> Board:
    """The board of a scenario."""
    targets, owners = scenario.parking
    return Board(
        scenario.columns,
        scenario.rows,
        scenario.cell_m,
        scenario.diameter_m,
        margin_m,
        scenario.walls * scenario.cell_m,
        scenario.closed * scenario.cell_m,
        targets * scenario.cell_m,
        owners,
    )


@inlined
def point_to_line(point: Point, line: Line) -> float:
    """Distance of a point from a line, in their unit."""
    (x, y), (end_x, end_y) = line
    along_x, along_y = end_x - x, end_y - y
    length = along_x * along_x + along_y * along_y
    if length > 0.0:
        share = ((point[0] - x) * along_x + (point[1] - y) * along_y) / length
        share = min(max(share, 0.0), 1.0)
        x += share * along_x
        y += share * along_y
    return math.sqrt((point[0] - x) ** 2 + (point[1] - y) ** 2)


@kernel
def line_to_line(a: Line, b: Line) -> float:
    """Distance of two lines in their unit. Zero if they cross."""
    if _cross(a, b) and _cross(b, a):
        return 0.0
    return min(
        point_to_line(a[0], b),
        point_to_line(a[1], b),
        point_to_line(b[0], a),
        point_to_line(b[1], a),
    )


@inlined
def _cross(a: Line, b: Line) -> bool:
    """Return whether the ends of b lie on both sides of the line through a."""
    (x, y), (end_x, end_y) = a
    first = (end_x - x) * (b[0][1] - y) - (end_y - y) * (b[0][0] - x)
    second = (end_x - x) * (b[1][1] - y) - (end_y - y) * (b[1][0] - x)
    return first * second < 0.0


@kernel
def give_way(
    board: Board,
    positions: np.ndarray,
    commands: np.ndarray,
    robot: int,
    direction: int,
    margin_m: float,
    draws: np.ndarray,
) -> tuple[int, int]:
    """The permitted direction of a robot, given its desired one; half of the detours are random.

    Robots that only ever yield to the nearest side may do so to each other endlessly.

    Args:
        positions, robot, direction, margin_m: see `permitted`.
        commands: (N, COMMAND_SIZE) of `cosim.onboard.steering`.
        draws: (DETOUR_DRAWS,) or more, uniform numbers in [0, 1).

    Returns:
        The direction, WAIT to stand; and how many of `draws` have been used, from the first.
    """
    goals, turns = np.empty_like(positions), NEAREST_FIRST.copy()
    for i in range(len(goals)):
        stands = i == robot or commands[i, MODE] == HOLD
        goals[i, 0] = math.nan if stands else commands[i, GOAL_X]
        goals[i, 1] = math.nan if stands else commands[i, GOAL_Y]
    allowed = permitted(board, positions, goals, robot, direction, margin_m, turns)
    if allowed in (direction, WAIT):
        return allowed, 0
    if draws[0] >= 0.5:
        return allowed, 1
    for k in range(1, len(turns)):
        rank = 1
        for i in range(1, len(turns)):
            rank += (draws[i], i) < (draws[k], k)
        turns[rank] = NEAREST_FIRST[k]
    return permitted(board, positions, goals, robot, direction, margin_m, turns), len(turns)


@kernel
def permitted(
    board: Board,
    positions: np.ndarray,
    goals: np.ndarray,
    robot: int,
    direction: int,
    margin_m: float,
    turns: np.ndarray,
) -> int:
    """The permitted direction of a robot, given its desired one.

    Args:
        positions: (N, 2) centres of the robots in m.
        goals: (N, 2) end of each robot's move in m, NaN for a robot that stands.
        margin_m: least gap to the other robots' plans, to obstacles and to forbidden cells.
        turns: (8,) int64, from the wanted direction to those that are tried, 0 the first.

    Returns:
        The direction itself if it is free, WAIT if a moving robot blocks it or nothing is free,
        else the first free direction.
    """
    here = (positions[robot, 0], positions[robot, 1])
    for turn in turns:
        candidate = (direction + turn) % DIRECTION_COUNT
        column = cell_of(here[0], board.cell_m) + DIRECTIONS[candidate, 0]
        row = cell_of(here[1], board.cell_m) + DIRECTIONS[candidate, 1]
        if not (0 <= column < board.columns and 0 <= row < board.rows):
            continue
        end = ((column + 0.5) * board.cell_m, (row + 0.5) * board.cell_m)
        plan = (here, end)
        if board.margin_m > 0.0 and _from_edge(board, end) < board.margin_m + margin_m:
            continue
        if _meets(board.obstacles, plan, 0.5 * board.diameter_m + margin_m, board.owners, -1):
            continue
        if _meets(board.closed[robot], plan, margin_m, board.owners, -1):
            continue
        if _meets(board.targets, plan, margin_m, board.owners, robot):
            continue
        free, by_moving = True, False
        least_m = board.diameter_m + margin_m
        for other in range(len(positions)):
            stands = np.isnan(goals[other, 0])
            goal = positions[other] if stands else goals[other]
            others = ((positions[other, 0], positions[other, 1]), (goal[0], goal[1]))
            apart = _length((here, others[0])) - _length(plan) - _length(others)
            if other == robot or apart > least_m:  # too far for any part of both
                continue
            if _too_close(plan, others, least_m):
                free = False
                by_moving |= not stands
        if free:
            return candidate
        if turn == 0 and by_moving:
            return WAIT
    return WAIT


@inlined
def _from_edge(board: Board, point: Point) -> float:
    """Return the distance in m of a point on the board from its edge."""
    x, y = point
    width, height = board.columns * board.cell_m, board.rows * board.cell_m
    return min(x, y, width - x, height - y)


@inlined
def _meets(
    rectangles: np.ndarray, plan: Line, least_m: float, owners: np.ndarray, robot: int
) -> bool:
    """Return whether a plan that begins outside of rectangles comes too close to a side.

    Args:
        rectangles: (M, 4) left, bottom, right, top in m.
        owners: (M,) robots for which a rectangle counts for nothing.
        robot: robot of the plan; −1 where all rectangles count.
    """
    reach_m = _length(plan) + least_m
    for k in range(len(rectangles)):
        left, bottom, right, top = rectangles[k]
        dx, dy = away_from(rectangles[k], plan[0][0], plan[0][1])
        if dx * dx + dy * dy > reach_m * reach_m or (robot >= 0 and owners[k] == robot):
            continue
        corners = ((left, bottom), (right, bottom), (right, top), (left, top))
        for side in range(4):
            ends = (corners[side], corners[(side + 1) % 4])
            if _too_close(plan, ends, least_m):
                return True
    return False


@inlined
def _length(line: Line) -> float:
    return math.sqrt((line[1][0] - line[0][0]) ** 2 + (line[1][1] - line[0][1]) ** 2)


@kernel
def _too_close(plan: Line, other: Line, least_m: float) -> bool:
    # a robot that is too close already may move away
    allowed = min(least_m, point_to_line(plan[0], other))
    return line_to_line(plan, other) < allowed - _ROUNDING_M
