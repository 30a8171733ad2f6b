"""Exact greedy evaluation: a policy's outcome, path length and moves from every start.

Deterministic and exhaustive, nothing is sampled: the process without slip, the greedy action with
ties broken by the least rotation. Statistics over several policies are in `agent.statistics`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from agent.grid import (
    COLUMN_COUNT,
    MOVING,
    OUTCOMES,
    RUNNING,
    STATUS,
    SUCCESS,
    TIMEOUT,
    VX,
    VY,
    least_rotation_argmax,
    move,
    place,
    state_index,
)
from agent.process import Process
from cosim.errors import UserError

MAX_STARTS = 50_000_000
INITIAL_DIRECTION = 0  # assumed: robots first face +x; it matters for exact ties only

_SQRT_2 = np.sqrt(2.0)


class Evaluation(NamedTuple):
    """Greedy episodes from all K combinations of start cells in which no robots touch.

    Attributes:
        starts: (K, N, 2) int64, start cells.
        outcome: (K,) int8, index into `agent.grid.OUTCOMES`.
        path_cells: (K, N) float64, path length of each robot in cells.
        steps: (K, N) int64, moves of each robot.
    """

    starts: np.ndarray
    outcome: np.ndarray
    path_cells: np.ndarray
    steps: np.ndarray

    def rate(self, outcome: str) -> float:
        """Share of the starts with an outcome of `agent.grid.OUTCOMES`."""
        return float(np.mean(self.outcome == OUTCOMES.index(outcome)))

    def mean_path_cells(self) -> float:
        """Mean over robots and successful starts, in cells; NaN without a success."""
        return _mean(self.path_cells[self.outcome == SUCCESS])

    def mean_steps(self) -> float:
        """Mean moves over robots and successful starts; NaN without a success."""
        return _mean(self.steps[self.outcome == SUCCESS])


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else float("nan")


@njit(cache=True)
def _combination(process: Process, index: int, cells: np.ndarray) -> None:
    """Start cells of combination `index`; the last robot's start varies fastest."""
    for i in range(cells.shape[0] - 1, -1, -1):
        first = process.start_offsets[i]
        count = process.start_offsets[i + 1] - first
        k = first + index % count
        index //= count
        cells[i, 0] = process.start_cells[k, 0]
        cells[i, 1] = process.start_cells[k, 1]


@njit(cache=True, nogil=True)
def _evaluate(
    process: Process,
    values: np.ndarray,
    starts: np.ndarray,
    outcomes: np.ndarray,
    path_cells: np.ndarray,
    steps: np.ndarray,
) -> int:
    """Run all combinations of starts; returns how many were free of contact (rows written)."""
    n = values.shape[0]
    world = np.zeros((n, COLUMN_COUNT), dtype=np.int64)
    cells = np.empty((n, 2), dtype=np.int64)
    facing = np.empty(n, dtype=np.int64)
    rewards = np.empty(n, dtype=np.float32)
    row = 0
    for index in range(outcomes.shape[0]):
        _combination(process, index, cells)
        if not place(process, world, cells):
            continue
        facing[:] = INITIAL_DIRECTION
        starts[row] = cells
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
                    path_cells[row, i] += _SQRT_2 if diagonal else 1.0
            if outcome == RUNNING and step == process.step_limit:
                outcome = TIMEOUT
        outcomes[row] = outcome
        row += 1
    return row


def start_combinations(process: Process) -> int:
    """Number of combinations of start cells, touching ones included."""
    return int(np.prod(np.diff(process.start_offsets)))


def evaluate(process: Process, values: np.ndarray) -> Evaluation:
    """Greedy episodes from every combination of start cells.

    Args:
        process: the decision process; its slip probability is ignored.
        values: (N, states, 8) float32, `Policy.values`.

    Raises:
        UserError: there are more combinations than `MAX_STARTS`.
    """
    combinations = start_combinations(process)
    if combinations > MAX_STARTS:
        raise UserError(
            f"{combinations:,} combinations of starts are too many to evaluate exactly; "
            "give the scenario fewer start cells"
        )
    n = values.shape[0]
    starts = np.empty((combinations, n, 2), dtype=np.int64)
    outcome = np.empty(combinations, dtype=np.int8)
    path_cells = np.empty((combinations, n))
    steps = np.empty((combinations, n), dtype=np.int64)
    rows = _evaluate(process, values, starts, outcome, path_cells, steps)
    return Evaluation(starts[:rows], outcome[:rows], path_cells[:rows], steps[:rows])
