"""Exact greedy evaluation: a policy's outcome, path length and moves from every start.

Deterministic: the process without slip, the greedy action with ties broken by the least rotation.
Exhaustive up to `MAX_STARTS` combinations of start cells, a sample of them beyond. And what a table
says of each cell, for pictures. Statistics over several policies are in
`agent.evaluation.statistics`.
"""

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agent.mdp.grid import (
    AXIS,
    COLUMN_COUNT,
    MOVING,
    SQRT_2,
    STATUS,
    VX,
    VY,
    X,
    Y,
    least_rotation_argmax,
    move,
    place,
    place_randomly,
    state_index,
)
from agent.mdp.interpretations import Process
from agent.mdp.rng import seeded_state
from cosim.base.errors import UserError
from cosim.base.jit import inlined, kernel
from cosim.model.outcome import BY_RANK, RUNNING, SUCCESS, TIMEOUT, Outcome
from cosim.onboard.features import DIRECTION_COUNT, starting_facing
from cosim.recording.series import PolicyMap

MAX_STARTS = 10_000


class Evaluation(NamedTuple):
    """Greedy episodes from K combinations of start cells in which no robots touch."""

    starts: np.ndarray  # (K, N, 2) int64, start cells
    outcome: np.ndarray  # (K,) int8, rank of `cosim.model.outcome.Outcome`
    path_cells: np.ndarray  # (K, N) float64, path length of each robot in cells
    steps: np.ndarray  # (K, N) int64, moves of each robot

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


@inlined
def count_moves(world: np.ndarray, path_cells: np.ndarray, steps: np.ndarray) -> None:
    """Add the last moves of all robots to their paths (N,) in cells and their steps (N,)."""
    for i in range(len(world)):
        if world[i, VX] != 0 or world[i, VY] != 0:
            steps[i] += 1
            path_cells[i] += SQRT_2 if world[i, VX] != 0 and world[i, VY] != 0 else 1.0


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
            # matters for ties only
            facing[i] = starting_facing(starts[row, i, 1], rows, DIRECTION_COUNT)
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
            count_moves(world, path_cells[row], steps[row])
            if outcome == RUNNING and step == process.step_limit:
                outcome = TIMEOUT
        outcomes[row] = outcome


@kernel
def _draw_starts(process: Process, starts: np.ndarray, random: np.ndarray) -> None:
    """Fill (K, N, 2) `starts` with cells drawn as in training; `random` is advanced."""
    world = np.zeros((starts.shape[1], COLUMN_COUNT), dtype=np.int64)
    for k in range(len(starts)):
        place_randomly(process, world, starts[k], random)


def enumerable(process: Process) -> bool:
    """Return whether a process has few enough combinations of start cells to evaluate all."""
    return math.prod(np.diff(process.start_offsets).tolist()) <= MAX_STARTS


def joint_starts(process: Process) -> np.ndarray:
    """(K, N, 2) int64, combinations of start cells, free of contact, that evaluations begin from.

    All of them, or if the process is not `enumerable` `MAX_STARTS` independent draws, always the
    same ones.
    """
    counts = np.diff(process.start_offsets)
    if not enumerable(process):
        drawn = np.empty((MAX_STARTS, len(counts), 2), dtype=np.int64)
        _draw_starts(process, drawn, seeded_state(0))
        return drawn
    index = np.indices(tuple(counts.tolist())).reshape(len(counts), -1).T
    starts = process.start_cells[index + process.start_offsets[:-1]]
    apart = np.full(len(starts), fill_value=True)
    for i, j in itertools.combinations(range(len(counts)), 2):
        squared = ((starts[:, i] - starts[:, j]) ** 2).sum(axis=1)
        apart &= squared > process.thresholds.contact
    return starts[apart]


def some_starts(process: Process, most: int) -> np.ndarray:
    """(K, N, 2) int64, evenly spaced `joint_starts`, at most the given number."""
    starts = joint_starts(process)
    return starts[:: -(-len(starts) // most)]


def evaluate_on_grid(
    process: Process, values: np.ndarray, starts: np.ndarray | None = None
) -> Evaluation:
    """Greedy episodes from the `joint_starts` of a process, or from those given.

    Args:
        process: its slip probability is ignored.
        values: (N, states, 8) float32, `Policy.values`.
        starts: (K, N, 2) int64, on the board and out of contact; by default `joint_starts`.
    """
    if starts is None:
        starts = joint_starts(process)
    shape = (len(process.terrain), process.state_count, DIRECTION_COUNT)
    if values.shape != shape:
        raise UserError(f"values of shape {values.shape} are not those of the process, {shape}")
    _require_on_board(process, starts)
    found = new_evaluation(starts)
    _evaluate(process, values, *found)
    return found


def evaluate_on_grid_by(
    process: Process, starts: np.ndarray, decide: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Evaluation:
    """Episodes of robots that decide together.

    Args:
        starts: (K, N, 2) int64, out of contact.
        decide: returns (N,) int64 directions, of the robots' cells x·rows + y and what
            they face (N,) int64.
    """
    _require_on_board(process, starts)
    found, rows = new_evaluation(starts), process.terrain.shape[2] - 2
    world = np.zeros((starts.shape[1], COLUMN_COUNT), dtype=np.int64)
    rewards = np.empty(len(world), dtype=np.float32)
    for k, cells in enumerate(starts):
        place(process, world, cells)
        found.outcome[k] = TIMEOUT
        for _ in range(process.step_limit):
            actions = decide(world[:, X] * rows + world[:, Y], world[:, AXIS].copy())
            outcome = move(process, world, actions, rewards)
            count_moves(world, found.path_cells[k], found.steps[k])
            if outcome != RUNNING:
                found.outcome[k] = outcome
                break
    return found


def _require_on_board(process: Process, starts: np.ndarray) -> None:
    """Refuse starts that are not (K, N, 2) cells of the board."""
    robots, columns, rows = process.terrain.shape
    shape, size = np.shape(starts), (columns - 2, rows - 2)
    if len(shape) != 3 or shape[1:] != (robots, 2):
        raise UserError(f"starts of shape {shape} are not (K, {robots}, 2): a cell for each robot")
    if ((starts < 0) | (starts >= np.array(size))).any():
        raise UserError(f"starts are off the board of {size[0]} x {size[1]} cells")


def new_evaluation(starts: np.ndarray) -> Evaluation:
    """Return room for the results of episodes from starts (K, N, 2)."""
    outcome, steps = np.empty(len(starts), np.int8), np.zeros(starts.shape[:2], np.int64)
    return Evaluation(starts, outcome, np.zeros(starts.shape[:2]), steps)


def cell_map(process: Process, values: np.ndarray, visits: np.ndarray) -> PolicyMap:
    """A robot's table over cells, over the other features weighted by visits.

    It has (states, 8) action values, and the (states,) decisions made in each state.
    """
    columns, rows = (size - 2 for size in process.terrain.shape[1:])
    strides, cells = process.strides, columns * rows
    x, y = np.divmod(np.arange(cells), rows)
    base = x * strides[0] + y * strides[1]
    # The other features have the smallest strides: a cell's states follow one another.
    told_apart = (columns if strides[0] else 1) * (rows if strides[1] else 1)
    states = base[:, None] + np.arange(process.state_count // told_apart)
    weights = visits[states].astype(np.float64)
    total = weights.sum(axis=1)
    value = (values.max(axis=1)[states] * weights).sum(axis=1) / np.maximum(total, 1.0)
    usual = states[np.arange(cells), weights.argmax(axis=1)]
    action = values[usual].argmax(axis=1)
    shape = (columns, rows)
    return PolicyMap(value.reshape(shape), action.reshape(shape), total.reshape(shape))
