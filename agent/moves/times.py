"""Times of robots on observed moves: the least of each alone, exact, and what several plan by.

A robot alone ends every move in the cell that it was sent to, asked again at the next RL step, and
what a move takes depends on its kind only. So where it is and what it faces (of the paper's robot,
one of four axes) are all there is to know: value iteration over both, with mean times of moves, is
the optimum of every policy. Others can only delay it: the slowest robot's time bounds that of an
episode of several from below. Next to obstacles it is a bound too: diagonal moves that would graze
a corner are counted as possible.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

from agent.mdp.interpretations import Process
from agent.mdp.joint import BLOCKED, cells_after, least_alone, tables_alone
from agent.mdp.optimum import require_paths
from agent.moves.model import ObservedMoves, move_kind
from cosim.base.errors import UserError
from cosim.base.jit import inlined, kernel
from cosim.onboard.features import DIRECTION_COUNT, Observation, facing_of, starting_facing

GAP_M = 0.0083  # assumed: between robots, as moves overlap in time
_ROUNDING = 1e-9  # of times, in RL steps
_MOST_OFF = 0.5  # cells; a robot that stops further off the centre is in another cell


def mean_seconds(moves: ObservedMoves) -> np.ndarray:
    """(8, facings) float64, mean time in s from a move to the next decision.

    By its direction and what the robot faced before.
    """
    steps: list[list[int]] = [[] for _ in range(moves.kinds)]
    for move in moves.moves:
        if max(abs(move.stop_x), abs(move.stop_y)) >= _MOST_OFF:
            raise UserError("moves end in other cells than commanded; check the parameters")
        lasted = math.ceil(move.duration_s / moves.rl_step_s - _ROUNDING)
        steps[moves.kind_of(move)].append(lasted)
    if not all(steps):
        raise UserError("not every kind of move was observed; observe more moves")
    of_kind = np.array([moves.rl_step_s * np.mean(of_kind) for of_kind in steps])
    facings = range(moves.facings)
    kinds = [[move_kind(a, f, moves.facings) for f in facings] for a in range(DIRECTION_COUNT)]
    return of_kind[np.array(kinds)]


def at_start(process: Process, values: np.ndarray) -> np.ndarray:
    """Return values (cells, facings, …) of robots that have been set down in each cell."""
    cells, rows = np.arange(len(values)), process.terrain.shape[2] - 2
    return values[cells, [starting_facing(k % rows, rows, process.facings) for k in cells.tolist()]]


def least_times(process: Process, moves: ObservedMoves) -> np.ndarray:
    """(N, cells, facings) float64, least mean time in s of each robot as if it were alone.

    By cell x·rows + y and what it faces; inf where no path leads to the target. The moves
    are of one world.
    """
    return least_alone(cells_after(process), mean_seconds(moves))


def fastest_tables(process: Process, moves: ObservedMoves) -> tuple[np.ndarray, np.ndarray]:
    """Tables by which one robot, with features x, y and h, takes the least mean time.

    Returns:
        Action values (1, states, 8) float32, minus the time in s that a move leads to, and (1,
        states) bool, whether there is anything to decide and a path to the target.
    """
    value, after = least_times(process, moves)[0], cells_after(process)[0]
    require_paths(process, at_start(process, value))
    return tables_alone(after, mean_seconds(moves), value)


class Board(NamedTuple):
    """Moves, times and distances that robots plan by."""

    # (N, cells, 8) int64, see `agent.mdp.joint.cells_after`. No move leads next to another robot's
    # target cell, because robots would drift into it
    after: np.ndarray
    seconds: np.ndarray  # (8, facings) float64, see `mean_seconds`
    targets: np.ndarray  # (N,) int64, target cell of each robot
    kept: float  # squared distance in cells² that robots keep
    # (N, N) float64, the same where one of them is parked and the other one parks: as near as their
    # targets
    parked: np.ndarray
    at: np.ndarray  # (cells, 2) int64, column and row of each cell


def board_of(process: Process, moves: ObservedMoves) -> Board:
    """Return what robots plan by, on moves of one world."""
    after = cells_after(process)
    cells, rows = after.shape[1], process.terrain.shape[2] - 2
    at = np.stack(np.divmod(np.arange(cells), rows), axis=1)
    targets = (after[:, :, 0] == np.arange(cells)).argmax(axis=1)
    for own, other in itertools.permutations(range(len(after)), 2):
        away = abs(at - at[targets[other]]).max(axis=1)
        enters = (away[after[own]] <= 1) & (away[after[own]] <= away[:, None])
        after[own] = np.where(enters, BLOCKED, after[own])
    kept = (2.0 * math.sqrt(process.squared_radius) + GAP_M / process.cell_m) ** 2
    between = ((at[targets][:, None] - at[targets]) ** 2).sum(axis=2)
    return Board(after, mean_seconds(moves), targets, kept, np.minimum(kept, between), at)


@kernel
def numbered(seen: Observation, columns: int, rows: int, facings: int) -> np.ndarray:
    """Return the numbers of robots' cells and goals, and what they face: (3, N) int64.

    Arrays of the observation are int64; a goal off the board counts as the cell next to it.
    """
    goals = seen.goals if len(seen.goals) > 0 else seen.cells
    numbers = np.empty((3, len(seen.cells)), dtype=np.int64)
    for i in range(len(seen.cells)):
        numbers[0, i] = seen.cells[i, 0] * rows + seen.cells[i, 1]
        x, y = min(max(goals[i, 0], 0), columns - 1), min(max(goals[i, 1], 0), rows - 1)
        numbers[1, i], numbers[2, i] = x * rows + y, facing_of(seen.direction[i], facings)
    return numbers


@inlined
def squared_distance(p: int, q: int, at: np.ndarray) -> int:
    """Squared distance of two cells."""
    x, y = at[p, 0] - at[q, 0], at[p, 1] - at[q, 1]
    return x * x + y * y


@inlined
def direction_towards(cell: int, goal: int, at: np.ndarray) -> int:
    """Return the direction of the move that leads from a cell to another one."""
    x, y = at[goal, 0] - at[cell, 0], at[goal, 1] - at[cell, 1]
    axis = 0 if y == 0 else 2 if x == 0 else 1 if x * y > 0 else 3
    return axis if y > 0 or (y == 0 and x >= 0) else axis + DIRECTION_COUNT // 2
