"""Exact optimum of a scenario: the shortest collision-free paths that any policy could take.

Value iteration over the joint process of one or two robots, for path length and for moves
separately; no learning. Where the joint process is too large (three robots and more, two on a
large board), each robot's own optimum, as if it were alone, is a lower bound: marked as relaxed.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from agent.process.exact import Evaluation
from agent.process.grid import COLUMN_COUNT, SQRT_2, VX, VY, X, Y, touched_between
from agent.process.readings import FREE, GOAL, Process
from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.base.outcome import SUCCESS
from cosim.base.provenance import code_digest, digest_of, with_imports
from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import cache_dir, cached, replacing
from cosim.navigation.features import DIRECTION_COUNT, DIRECTIONS

MAX_JOINT_STATES = 4_000_000  # two robots on about 45 x 45 cells, some seconds

_BLOCKED = -1
_PATH_COSTS = np.array([1.0, SQRT_2] * (DIRECTION_COUNT // 2))
_STEP_COSTS = np.ones(DIRECTION_COUNT)


class Bound(NamedTuple):
    """Optimal costs from every joint state.

    Attributes:
        path_cells: (cells,) or (cells, cells) float64, least path length of all robots together,
            in cells; cell (x, y) has index x·rows + y; inf where there is no path. If relaxed
            (robots, cells), each robot alone.
        steps: the same for moves.
        relaxed: whether robots were taken alone.
    """

    path_cells: np.ndarray
    steps: np.ndarray
    relaxed: bool

    def of_starts(self, starts: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean over robots of path length in cells and of moves.

        Args:
            starts: (K, N, 2) int64 cells.
            rows: of the board.

        Returns:
            Two arrays (K,) float64.
        """
        index = starts[..., 0] * rows + starts[..., 1]
        robots = index.shape[1]
        if self.relaxed:
            alone = np.arange(robots)
            return (
                self.path_cells[alone, index].mean(axis=1),
                self.steps[alone, index].mean(axis=1),
            )
        joint = tuple(index.T)
        return self.path_cells[joint] / robots, self.steps[joint] / robots


@kernel
def _set_move(world: np.ndarray, i: int, cell: int, after: int, rows: int) -> None:
    world[i, X] = after // rows
    world[i, Y] = after % rows
    world[i, VX] = after // rows - cell // rows
    world[i, VY] = after % rows - cell % rows


@kernel
def _iterate(
    process: Process, after: np.ndarray, costs: np.ndarray, free: np.ndarray, value: np.ndarray
) -> None:
    """Gauss–Seidel value iteration of two robots (or one, and one parked) to the fixed point.

    Args:
        process: for contact along the moves.
        after: (2, cells, 8) int64, cell after a move or _BLOCKED; a parked robot's own cell.
        costs: (8,) float64, cost of a move; a parked robot pays nothing.
        free: (cells, cells) bool, joint states in which robots may be and go on.
        value: (cells, cells) float64, 0 at the end, inf elsewhere; updated.
    """
    cells = after.shape[1]
    rows = process.terrain.shape[2] - 2
    contact = process.thresholds.contact
    world = np.zeros((2, COLUMN_COUNT), dtype=np.int64)
    forward = False
    changed = True
    while changed:
        changed = False
        forward = not forward  # alternating orders spread values in both directions
        for k in range(cells * cells):
            state = k if forward else cells * cells - 1 - k
            p, q = state // cells, state % cells
            if not free[p, q]:
                continue
            best = value[p, q]
            for a in range(DIRECTION_COUNT):
                p_after = after[0, p, a]
                if p_after == _BLOCKED:
                    continue
                p_cost = 0.0 if p_after == p else costs[a]
                for b in range(DIRECTION_COUNT):
                    q_after = after[1, q, b]
                    if q_after == _BLOCKED:
                        continue
                    q_cost = 0.0 if q_after == q else costs[b]
                    cost = p_cost + q_cost + value[p_after, q_after]
                    if cost < best:
                        if process.swept:
                            _set_move(world, 0, p, p_after, rows)
                            _set_move(world, 1, q, q_after, rows)
                            if touched_between(world, 0, 1, contact):
                                continue
                        best = cost
                    if q_after == q:
                        break  # parked: all eight entries are the same
                if p_after == p:
                    break
            if best < value[p, q]:
                value[p, q] = best
                changed = True


@kernel
def _iterate_alone(after: np.ndarray, costs: np.ndarray, value: np.ndarray) -> None:
    """The same for one robot: `after` (cells, 8), `value` (cells,)."""
    changed = True
    while changed:
        changed = False
        for p in range(after.shape[0]):
            for a in range(DIRECTION_COUNT):
                p_after = after[p, a]
                if p_after not in (_BLOCKED, p):
                    cost = costs[a] + value[p_after]
                    if cost < value[p]:
                        value[p] = cost
                        changed = True


def moves(process: Process, robot: int) -> np.ndarray:
    """(cells, 8) int64, cell after each move; _BLOCKED where it fails, itself at the target."""
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    x, y = np.divmod(np.arange(columns * rows), rows)
    after_x, after_y = x[:, None] + DIRECTIONS[:, 0], y[:, None] + DIRECTIONS[:, 1]
    terrain = process.terrain[robot]
    possible = np.isin(terrain[after_x + 1, after_y + 1], (FREE, GOAL))
    if process.swept:  # as `agent.process.grid.grazed_a_corner`
        middle = np.maximum(x[:, None], after_x), np.maximum(y[:, None], after_y)
        possible &= ~(process.corners[middle] & (DIRECTIONS != 0).all(axis=1))
    after = np.where(possible, after_x * rows + after_y, _BLOCKED)
    after[terrain[x + 1, y + 1] == GOAL] = np.flatnonzero(terrain[x + 1, y + 1] == GOAL)[:, None]
    return after


def _optimum(process: Process, costs: np.ndarray, relaxed: bool) -> np.ndarray:
    """Least costs, in the layout of `Bound`."""
    after = np.stack([moves(process, i) for i in range(len(process.terrain))])
    robots, cells = after.shape[:2]
    parked = after[:, :, 0] == np.arange(cells)
    if relaxed or robots == 1:
        value = np.where(parked, 0.0, np.inf)
        for i in range(robots):
            _iterate_alone(after[i], costs, value[i])
        return value if relaxed else value[0]
    rows = process.terrain.shape[2] - 2
    x, y = np.divmod(np.arange(cells), rows)
    squared = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
    apart = squared > process.thresholds.contact
    value = np.where(parked[0][:, None] & parked[1] & apart, 0.0, np.inf)
    usable = np.stack([t[1:-1, 1:-1].ravel() for t in process.terrain])
    usable = np.isin(usable, (FREE, GOAL))
    free = apart & usable[0][:, None] & usable[1] & (value > 0.0)
    _iterate(process, after, costs, free, value)
    return value


def distances_alone(process: Process) -> np.ndarray:
    """(N, columns · rows) float64, each robot's least path to its target in cells, as if alone."""
    return _optimum(process, _PATH_COSTS, relaxed=True)


def optimum(process: Process) -> Bound:
    """Exact optimum of a process without slip, computed or found in the cache."""
    robots, columns, rows = process.terrain.shape
    relaxed = robots > 1 and ((columns - 2) * (rows - 2)) ** robots > MAX_JOINT_STATES
    code = code_digest(with_imports([Path(__file__)]))
    facts = (code, process.thresholds.contact, process.swept, relaxed)
    path = cache_dir("bounds") / f"{digest_of(facts, process.terrain, process.corners)}.npz"

    def make() -> Bound:
        path_cells = _optimum(process, _PATH_COSTS, relaxed)
        return Bound(path_cells, _optimum(process, _STEP_COSTS, relaxed), relaxed)

    return cached(path, _load, make, _save)


def _load(path: Path) -> Bound:
    arrays = read_arrays(path, Kind("optimum", "remove it", UserError), Bound._fields)
    return Bound(arrays["path_cells"], arrays["steps"], bool(arrays["relaxed"]))


def _save(bound: Bound, path: Path) -> None:
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **bound._asdict())


def ratios(process: Process, evaluation: Evaluation) -> tuple[float, float]:
    """Path length and moves of a policy over the optimum, on the starts where it succeeds.

    Returns:
        Two ratios of means, at least 1; NaN without a success.
    """
    succeeded = evaluation.outcome == SUCCESS
    path, steps = optimum(process).of_starts(
        evaluation.starts[succeeded], process.terrain.shape[2] - 2
    )
    if not succeeded.any():
        return float("nan"), float("nan")
    return (
        float(evaluation.path_cells[succeeded].mean() / path.mean()),
        float(evaluation.steps[succeeded].mean() / steps.mean()),
    )
