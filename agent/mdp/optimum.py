"""Exact optimum of a scenario: the shortest collision-free paths that any policy could take.

Dijkstra's algorithm over the joint process of one or two robots (`agent.mdp.joint`), for path
length and for moves separately; no learning. Where the joint process is too large (three robots and
more, two on a large board), each robot's own optimum, as if it were alone, is a lower bound: marked
as relaxed.

And the tables of policies that are computed, by the optimum of one or two robots.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import label

from agent.mdp.exact import Evaluation, joint_starts
from agent.mdp.grid import SQRT_2
from agent.mdp.interpretations import FREE, GOAL, MAX_JOINT_STATES, Process
from agent.mdp.joint import (
    IMPOSSIBLE,
    cells_after,
    joint_states,
    least_alone,
    solve,
    tables_alone,
    tabulate,
)
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import cache_dir, cached, write_arrays
from cosim.model.outcome import SUCCESS
from cosim.onboard.features import DIRECTION_COUNT

VERSION = 1  # of optima and shortest paths: raise it when their bits change

_PATH_COSTS = np.array([1.0, SQRT_2] * (DIRECTION_COUNT // 2))
_STEP_COSTS = np.ones(DIRECTION_COUNT)


class Bound(NamedTuple):
    """Optimal costs from every joint state."""

    # (cells,) or (cells, cells) float64, least path length of all robots together, in cells; cell
    # (x, y) has index x·rows + y; inf where there is no path. If relaxed (robots, cells)
    path_cells: np.ndarray
    steps: np.ndarray  # the same for moves
    relaxed: bool  # whether each robot was taken alone

    def of_starts(self, starts: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Return means over robots of path in cells and of moves, (K,), from (K, N, 2) cells."""
        path_cells = _of_starts(self.path_cells, starts, rows, self.relaxed)
        return path_cells, _of_starts(self.steps, starts, rows, self.relaxed)


def _of_starts(costs: np.ndarray, starts: np.ndarray, rows: int, alone: bool) -> np.ndarray:
    """(K,) float64, mean over robots of costs that are in the layout of `Bound`."""
    index = starts[..., 0] * rows + starts[..., 1]
    robots = index.shape[1]
    if alone:
        return costs[np.arange(robots), index].mean(axis=1)
    return costs[tuple(index.T)] / robots


def _optimum(process: Process, costs: np.ndarray, relaxed: bool) -> np.ndarray:
    """Least costs, in the layout of `Bound`."""
    after = cells_after(process)
    if relaxed or len(after) == 1:
        value = least_alone(after, costs[:, None])[..., 0]
        return value if relaxed else value[0]
    free, end = joint_states(process)
    value = np.where(end, 0.0, np.inf)
    solve(process, after, costs, free, value)
    return value


def require_paths_alone(process: Process) -> None:
    """Refuse start cells from which a robot alone cannot reach its target; quick on any board."""
    for i, terrain in enumerate(process.terrain):
        joined = np.zeros(terrain.shape, dtype=np.int32)
        label(np.isin(terrain, (FREE, GOAL)), np.ones((3, 3)), output=joined)
        cells = process.start_cells[process.start_offsets[i] : process.start_offsets[i + 1]]
        without = cells[joined[tuple(cells.T + 1)] != joined[terrain == GOAL]]
        if len(without):
            raise UserError(
                f"from start cell {without[0].tolist()} of robot {i + 1} there is no path to its "
                f"target, nor from {len(without) - 1} others; move obstacles, starts or targets"
            )


def optimum(process: Process) -> Bound:
    """Exact optimum of a process without slip, computed or found in the cache."""
    robots, columns, rows = process.terrain.shape
    too_large = ((columns - 2) * (rows - 2)) ** robots > MAX_JOINT_STATES
    relaxed = robots > 2 or (robots == 2 and too_large)
    facts = (VERSION, process.thresholds.contact, process.swept, relaxed)
    path = cache_dir("bounds") / f"{digest_of(facts, process.terrain, process.corners)}.npz"

    def make() -> Bound:
        path_cells = _optimum(process, _PATH_COSTS, relaxed)
        return Bound(path_cells, _optimum(process, _STEP_COSTS, relaxed), relaxed)

    return cached(path, _load, make, lambda bound, path: write_arrays(path, bound._asdict()))


def require_paths(process: Process, costs: np.ndarray, *, alone: bool = False) -> None:
    """Refuse starts from which the targets cannot be reached.

    Args:
        costs: (cells,) or (cells, cells) float64, inf where there is no path, by the cells of all
            robots; or (robots, cells), of each robot alone.
    """
    starts = joint_starts(process)
    without = starts[~np.isfinite(_of_starts(costs, starts, process.terrain.shape[2] - 2, alone))]
    if len(without):
        raise UserError(
            f"from start cells {without[0].tolist()} there is no path to the targets, and from "
            f"{len(without) - 1} other starts; move obstacles, starts or targets"
        )


def computed_tables(process: Process) -> tuple[np.ndarray, np.ndarray]:
    """Tables of the shortest paths of one robot, or of two together, from wherever they are.

    Args:
        process: of one robot with features x and y, or of two with x, y and p.

    Returns:
        Action values (N, states, 8) float32, minus the least cost that a move leads to, and (N,
        states) bool, whether there is anything to decide and a path to the end.
    """
    bound = optimum(process)
    require_paths(process, bound.path_cells, alone=bound.relaxed)
    robots, columns, rows = process.terrain.shape
    if bound.relaxed:
        cells = (columns - 2) * (rows - 2)
        raise UserError(
            f"shortest joint paths of {robots} robots on {cells} cells are too large to "
            f"compute; the limit is one robot, or two with {MAX_JOINT_STATES:,} joint states (here "
            f"{cells**robots:,}); choose another method, or a smaller scenario"
        )
    value, costs = bound.path_cells, _PATH_COSTS
    after = cells_after(process)
    if robots == 1:
        return tables_alone(after[0], costs[:, None], value[:, None])
    free, _ = joint_states(process)
    table = np.full((2, *free.shape, DIRECTION_COUNT), IMPOSSIBLE, dtype=np.float32)
    tabulate(process, after, costs, free, value, table)
    free &= value < np.inf
    decided = np.stack([free, free.T]).reshape(2, -1)
    return table.reshape(2, -1, DIRECTION_COUNT), decided


def _load(path: Path) -> Bound:
    arrays = read_arrays(path, Kind("optimum", "remove it"), Bound._fields)
    return Bound(arrays["path_cells"], arrays["steps"], bool(arrays["relaxed"]))


def ratios(process: Process, evaluation: Evaluation) -> tuple[float, float]:
    """Return mean path and moves of a policy over the optimum's, where it succeeds; else NaN."""
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
