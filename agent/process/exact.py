"""Exact greedy evaluation: a policy's outcome, path length and moves from every start.

Deterministic and exhaustive, nothing is sampled: the process without slip, the greedy action with
ties broken by the least rotation. Statistics over several policies are in
`agent.evaluation.statistics`.
"""

import itertools
from typing import NamedTuple

import numpy as np

from agent.process.grid import (
    ALONE,
    COLUMN_COUNT,
    MOVING,
    SQRT_2,
    STATUS,
    VX,
    VY,
    least_rotation_argmax,
    move,
    place,
    state_index,
)
from agent.process.readings import Process
from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.base.outcome import BY_RANK, RUNNING, SUCCESS, TIMEOUT, Outcome

MAX_STARTS = 5_000_000
UP, DOWN = 2, 6  # directions


class Evaluation(NamedTuple):
    """Greedy episodes from all K combinations of start cells in which no robots touch.

    Attributes:
        starts: (K, N, 2) int64, start cells.
        outcome: (K,) int8, rank of `cosim.base.outcome.Outcome`.
        path_cells: (K, N) float64, path length of each robot in cells.
        steps: (K, N) int64, moves of each robot.
    """

    starts: np.ndarray
    outcome: np.ndarray
    path_cells: np.ndarray
    steps: np.ndarray

    def rate(self, outcome: Outcome) -> float:
        """Share of the starts with an outcome."""
        return float(np.mean(self.outcome == BY_RANK.index(outcome)))

    def mean_path_cells(self) -> float:
        """Mean over robots and successful starts, in cells; NaN without a success."""
        return _mean(self.path_cells[self.outcome == SUCCESS])

    def mean_steps(self) -> float:
        """Mean moves over robots and successful starts; NaN without a success."""
        return _mean(self.steps[self.outcome == SUCCESS])


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else float("nan")


@kernel
def _evaluate(
    process: Process,
    values: np.ndarray,
    starts: np.ndarray,
    outcomes: np.ndarray,
    path_cells: np.ndarray,
    steps: np.ndarray,
) -> None:
    """Run a greedy episode from each of the starts; see `Evaluation` for the arrays written."""
    n = values.shape[0]
    world = np.zeros((n, COLUMN_COUNT), dtype=np.int64)
    facing = np.empty(n, dtype=np.int64)
    rewards = np.empty(n, dtype=np.float32)
    rows = process.terrain.shape[2] - 2
    for row in range(starts.shape[0]):
        place(process, world, starts[row])
        for i in range(n):
            # assumed, as in the co-simulation: set down facing the middle; matters for ties only
            facing[i] = UP if 2 * starts[row, i, 1] < rows else DOWN
        path_cells[row] = 0.0
        steps[row] = 0
        outcome = RUNNING
        step = 0
        while outcome == RUNNING:
            step += 1
            for i in range(n):
                if world[i, STATUS] == MOVING:
                    greedy = values[i, state_index(process, world, i)]
                    facing[i] = least_rotation_argmax(greedy, facing[i])
            outcome = move(process, world, facing, rewards)
            for i in range(n):
                if world[i, VX] != 0 or world[i, VY] != 0:
                    steps[row, i] += 1
                    diagonal = world[i, VX] != 0 and world[i, VY] != 0
                    path_cells[row, i] += SQRT_2 if diagonal else 1.0
            if outcome == RUNNING and step == process.step_limit:
                outcome = TIMEOUT
        outcomes[row] = outcome


def all_starts(process: Process) -> np.ndarray:
    """(K, N, 2) int64, every combination of start cells in which no robots touch.

    Raises:
        UserError: there are more combinations than `MAX_STARTS`.
    """
    combinations = int(np.prod(np.diff(process.start_offsets)))
    if combinations > MAX_STARTS:
        raise UserError(
            f"{combinations:,} combinations of starts are too many to evaluate exactly; "
            "give the scenario fewer start cells"
        )
    cells = [
        process.start_cells[first:last] for first, last in itertools.pairwise(process.start_offsets)
    ]
    index = np.indices([len(c) for c in cells]).reshape(len(cells), -1)
    starts = np.stack([c[k] for c, k in zip(cells, index, strict=True)], axis=1)
    offsets = starts[:, :, None, :] - starts[:, None, :, :]
    squared = (offsets**2).sum(axis=-1)
    squared[:, np.arange(len(cells)), np.arange(len(cells))] = ALONE
    return starts[(squared > process.thresholds.contact).all(axis=(1, 2))]


def evaluate(process: Process, values: np.ndarray, starts: np.ndarray | None = None) -> Evaluation:
    """Greedy episodes from every combination of start cells, or from those given.

    Args:
        process: the decision process; its slip probability is ignored.
        values: (N, states, 8) float32, `Policy.values`.
        starts: (K, N, 2) int64, out of contact; by default `all_starts`.

    Raises:
        UserError: see `all_starts`.
    """
    if starts is None:
        starts = all_starts(process)
    outcome = np.empty(len(starts), dtype=np.int8)
    path_cells = np.empty(starts.shape[:2])
    steps = np.empty(starts.shape[:2], dtype=np.int64)
    _evaluate(process, values, starts, outcome, path_cells, steps)
    return Evaluation(starts, outcome, path_cells, steps)
