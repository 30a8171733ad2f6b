"""The joint process of two robots, solved: least costs, and tables of the best.

Also that of one robot. Cells are counted x·rows + y; costs are those of both robots together. Which
costs, and where the results are kept, is `agent.mdp.optimum`.
"""

import numpy as np

from agent.mdp.grid import COLUMN_COUNT, VX, VY, X, Y, touched_between
from agent.mdp.interpretations import FREE, GOAL, Process
from cosim.base.jit import inlined, kernel
from cosim.onboard.features import DIRECTION_COUNT, DIRECTIONS

BLOCKED = -1
IMPOSSIBLE = -1.0e6  # value of a move that fails, or from where no path leads on
# Tables have whole multiples of this, which compress well; path lengths that differ do so by more.
GRAIN = 2.0**-10


@inlined
def _touch_on_the_way(
    process: Process, world: np.ndarray, before: tuple[int, int], after: tuple[int, int]
) -> bool:
    """Return whether robots that move between two pairs of cells touch, if contact is swept."""
    if not process.swept:
        return False
    rows = process.terrain.shape[2] - 2
    for i in range(2):
        world[i, X] = after[i] // rows
        world[i, Y] = after[i] % rows
        world[i, VX] = world[i, X] - before[i] // rows
        world[i, VY] = world[i, Y] - before[i] % rows
    return touched_between(world, 0, 1, process.thresholds.contact)


@inlined
def choices(after: np.ndarray, i: int, cell: int) -> int:
    """Return the number of moves of robot i in a cell: one, to stay, where it is parked."""
    return 1 if after[i, cell, 0] == cell else DIRECTION_COUNT


@kernel
def solve(
    process: Process, after: np.ndarray, costs: np.ndarray, free: np.ndarray, value: np.ndarray
) -> None:
    """Least costs of two robots, in rising order: Dijkstra's algorithm with buckets of width 1.

    No move costs less than 1, so that states of a bucket do not lead to one another.

    Args:
        after: (2, cells, 8) int64, see `cells_after`.
        costs: (8,) float64, cost of a move, at least 1; a parked robot pays nothing.
        free: (cells, cells) bool, joint states in which robots may be and continue.
        value: (cells, cells) float64, 0 at the end, inf elsewhere; updated.
    """
    cells = after.shape[1]
    world = np.zeros((2, COLUMN_COUNT), dtype=np.int64)
    # the cell that each move comes from, and as one more of a parked robot that it stays
    before = np.full((2, cells, DIRECTION_COUNT + 1), BLOCKED)
    paid = np.zeros(DIRECTION_COUNT + 1)
    paid[:DIRECTION_COUNT] = costs
    for i in range(2):
        for cell in range(cells):
            for a in range(DIRECTION_COUNT):
                if after[i, cell, a] == cell:
                    before[i, cell, DIRECTION_COUNT] = cell
                elif after[i, cell, a] != BLOCKED:
                    before[i, after[i, cell, a], a] = cell
    bucket, reached = 0, 0.0
    while bucket <= reached:
        for state in range(cells * cells):
            p, q = state // cells, state % cells
            known = value[p, q]
            if not bucket <= known < bucket + 1:
                continue
            for a in range(DIRECTION_COUNT + 1):
                for b in range(DIRECTION_COUNT + 1):
                    p_before, q_before = before[0, p, a], before[1, q, b]
                    if min(p_before, q_before) == BLOCKED or not free[p_before, q_before]:
                        continue
                    cost = paid[a] + paid[b] + known
                    if cost >= value[p_before, q_before]:
                        continue
                    if not _touch_on_the_way(process, world, (p_before, q_before), (p, q)):
                        value[p_before, q_before] = cost
                        reached = max(reached, cost)
        bucket += 1


@kernel
def iterate_alone(after: np.ndarray, costs: np.ndarray, value: np.ndarray) -> None:
    """Iterate the least costs of a robot as if it were alone, to the fixed point.

    Args:
        after: (cells, 8) int64, see `cells_after`; other moves may be BLOCKED as well.
        costs: (8, axes) float64 of a move, by the axis that the robot faced before; one axis where
            it does not matter.
        value: (cells, axes), 0 at the target, inf elsewhere; updated, rounded to its type.
    """
    axes, changed, cost = value.shape[1], True, np.empty(1, value.dtype)
    while changed:
        changed = False
        for p in range(after.shape[0]):
            for a in range(DIRECTION_COUNT):
                reached = after[p, a]
                if reached in (BLOCKED, p):
                    continue
                rest = value[reached, a % axes]
                for axis in range(axes):
                    cost[0] = costs[a, axis] + rest
                    if cost[0] < value[p, axis]:
                        value[p, axis] = cost[0]
                        changed = True


@kernel
def tabulate(
    process: Process,
    after: np.ndarray,
    costs: np.ndarray,
    free: np.ndarray,
    value: np.ndarray,
    table: np.ndarray,
) -> None:
    """Action values of each robot of a pair if the other one does what is best for both.

    Robots choose alone, and halves of two equally good joint moves may collide. So one joint move
    of every state is preferred, by a grain: of the best the one after which the robots are
    furthest apart, the first of several.

    Args:
        process, after, costs, free: see `solve`.
        value: (cells, cells) float64, solved.
        table: (2, cells, cells, 8) float32 by robot, own cell, the other's and move; updated.
    """
    cells = after.shape[1]
    rows = process.terrain.shape[2] - 2
    world = np.zeros((2, COLUMN_COUNT), dtype=np.int64)
    for p in range(cells):
        for q in range(cells):
            if not free[p, q] or value[p, q] == np.inf:
                continue
            first, second = table[0, p, q], table[1, q, p]
            best_a = best_b = farthest = -1
            for a in range(choices(after, 0, p)):
                for b in range(choices(after, 1, q)):
                    p_after, q_after = after[0, p, a], after[1, q, b]
                    if min(p_after, q_after) == BLOCKED or value[p_after, q_after] == np.inf:
                        continue
                    if _touch_on_the_way(process, world, (p, q), (p_after, q_after)):
                        continue
                    p_cost = 0.0 if p_after == p else costs[a]
                    q_cost = 0.0 if q_after == q else costs[b]
                    cost = p_cost + q_cost + value[p_after, q_after]
                    worth = np.float32(-GRAIN * np.rint(cost / GRAIN))
                    first[a] = max(first[a], worth)
                    second[b] = max(second[b], worth)
                    if cost > value[p, q] + GRAIN:
                        continue
                    dx, dy = p_after // rows - q_after // rows, p_after % rows - q_after % rows
                    if dx * dx + dy * dy > farthest:
                        best_a, best_b, farthest = a, b, dx * dx + dy * dy
            first[best_a] += np.float32(GRAIN)
            second[best_b] += np.float32(GRAIN)


def cells_after(process: Process) -> np.ndarray:
    """(N, cells, 8) int64, cell after each move; BLOCKED where it fails, itself at the target."""
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    x, y = np.divmod(np.arange(columns * rows), rows)
    after_x, after_y = x[:, None] + DIRECTIONS[:, 0], y[:, None] + DIRECTIONS[:, 1]
    possible = np.isin(process.terrain[:, after_x + 1, after_y + 1], (FREE, GOAL))
    if process.swept:  # as `agent.mdp.grid.grazed_a_corner`
        middle = np.maximum(x[:, None], after_x), np.maximum(y[:, None], after_y)
        possible &= ~(process.corners[middle] & (DIRECTIONS != 0).all(axis=1))
    after = np.where(possible, after_x * rows + after_y, BLOCKED)
    robots, targets = np.nonzero(process.terrain[:, x + 1, y + 1] == GOAL)
    after[robots, targets] = targets[:, None]
    return after


def least_alone(after: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """(N, cells, axes) float64, least costs of each robot as if it were alone; inf without a path.

    Args:
        after: see `cells_after`.
        costs: see `iterate_alone`.
    """
    parked = after[:, :, 0] == np.arange(after.shape[1])
    value = np.repeat(np.where(parked, 0.0, np.inf)[..., None], costs.shape[1], axis=2)
    for own_after, own in zip(after, value, strict=True):
        iterate_alone(own_after, costs, own)
    return value


def tables_alone(
    after: np.ndarray, costs: np.ndarray, value: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tables of a robot alone: action values (1, cells · axes, 8) float32, minus costs.

    And (1, cells · axes) bool, whether there is anything to decide and a path to the target.

    Args:
        after: (cells, 8) int64, see `cells_after`.
        costs, value: see `iterate_alone`, which found the latter.
    """
    rest = np.where(
        after == BLOCKED, np.inf, value[after, np.arange(DIRECTION_COUNT) % value.shape[1]]
    )
    total = costs.T + rest[:, None]
    decided = (value > 0.0) & (value < np.inf)
    table = np.where(decided[..., None] & (total < np.inf), -total, IMPOSSIBLE)
    return table.reshape(1, -1, DIRECTION_COUNT).astype(np.float32), decided.reshape(1, -1)


def joint_states(process: Process) -> tuple[np.ndarray, np.ndarray]:
    """Joint states of two robots, (cells, cells) bool: those to continue from, and the end."""
    rows = process.terrain.shape[2] - 2
    terrain = process.terrain[:, 1:-1, 1:-1].reshape(2, -1)
    x, y = np.divmod(np.arange(terrain.shape[1]), rows)
    squared = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    usable = np.isin(terrain, (FREE, GOAL))
    apart = usable[0][:, None] & usable[1] & (squared > process.thresholds.contact)
    end = apart & (terrain[0] == GOAL)[:, None] & (terrain[1] == GOAL)
    return apart & ~end, end
