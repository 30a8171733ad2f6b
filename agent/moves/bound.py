"""The least time in which robots reach their targets if each were alone: exact, on observed moves.

A robot alone ends every move in the cell that it was sent to, asked again at the next RL step, and
what a move takes depends on its kind only. So where it is and which axis it faces are all there is
to know: value iteration over both, with mean times of moves, is the optimum of every policy. Others
can only delay it: the slowest robot's time bounds that of an episode of several from below. Next to
obstacles it is a bound too: diagonal moves that would graze a corner are counted as possible.
"""

import math

import numpy as np

from agent.mdp.grid import STARTING_AXIS
from agent.mdp.joint import BLOCKED, IMPOSSIBLE, cells_after
from agent.mdp.optimum import require_paths
from agent.mdp.readings import Process
from agent.moves.model import KINDS, ObservedMoves, move_kind
from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.onboard.features import AXIS_COUNT, DIRECTION_COUNT

_ROUNDING = 1e-9  # of times, in RL steps
_MOST_OFF = 0.5  # cells; a robot that stops further off the centre is in another cell


@kernel
def _iterate(after: np.ndarray, seconds: np.ndarray, value: np.ndarray) -> None:
    """Value iteration of one robot to the fixed point.

    Args:
        after: (cells, 8) int64, see `agent.mdp.joint.cells_after`.
        seconds: (KINDS,) float64, mean time of moves.
        value: (cells, AXIS_COUNT) float64, 0 at the target, inf elsewhere; updated.
    """
    changed = True
    while changed:
        changed = False
        for p in range(after.shape[0]):
            for a in range(DIRECTION_COUNT):
                reached = after[p, a]
                if reached in (BLOCKED, p):
                    continue
                rest = value[reached, a % AXIS_COUNT]
                for axis in range(AXIS_COUNT):
                    time = seconds[move_kind(a, axis)] + rest
                    if time < value[p, axis]:
                        value[p, axis] = time
                        changed = True


def mean_seconds(moves: ObservedMoves) -> np.ndarray:
    """(KINDS,) float64, mean time in s from a move of each kind to the next decision.

    Raises:
        UserError: a kind of move was never observed, or a robot stopped in another cell than the
            one it was sent to.
    """
    steps: list[list[int]] = [[] for _ in range(KINDS)]
    for move in moves.moves:
        if max(abs(move.stop_x), abs(move.stop_y)) >= _MOST_OFF:
            raise UserError("moves end in other cells than commanded; check the parameters")
        lasted = math.ceil(move.duration_s / moves.rl_step_s - _ROUNDING)
        steps[move_kind(move.direction, move.heading)].append(lasted)
    if not all(steps):
        raise UserError("not every kind of move was observed; observe more moves")
    return np.array([moves.rl_step_s * np.mean(of_kind) for of_kind in steps])


def least_times(process: Process, moves: ObservedMoves) -> np.ndarray:
    """(N, cells, AXIS_COUNT) float64, least mean time in s of each robot as if it were alone.

    By cell x·rows + y and the axis that it faces; inf where no path leads to the target.

    Args:
        process: the board.
        moves: of one world.

    Raises:
        UserError: see `mean_seconds`.
    """
    seconds = mean_seconds(moves)
    after = np.stack([cells_after(process, i) for i in range(len(process.terrain))])
    robots, cells = after.shape[:2]
    parked = after[:, :, 0] == np.arange(cells)
    value = np.repeat(np.where(parked, 0.0, np.inf)[..., None], AXIS_COUNT, axis=2)
    for i in range(robots):
        _iterate(after[i], seconds, value[i])
    return value


def fastest_tables(process: Process, moves: ObservedMoves) -> tuple[np.ndarray, np.ndarray]:
    """Tables by which a robot alone takes the least mean time.

    Args:
        process: of one robot with features x, y and h.
        moves: of one world.

    Returns:
        Action values (1, states, 8) float32, minus the time in s that a move leads to, and (1,
        states) bool, whether there is anything to decide and a path to the target.

    Raises:
        UserError: see `mean_seconds`.
        UserError: there is a start without a path to the target.
    """
    value, after = least_times(process, moves)[0], cells_after(process, 0)
    require_paths(process, value[:, STARTING_AXIS])
    directions = np.arange(DIRECTION_COUNT)
    kinds = [[move_kind(a, axis) for a in directions.tolist()] for axis in range(AXIS_COUNT)]
    rest = np.where(after == BLOCKED, np.inf, value[after, directions % AXIS_COUNT])
    time_s = mean_seconds(moves)[np.array(kinds)] + rest[:, None]
    decided = (value > 0.0) & (value < np.inf)
    table = np.where(decided[..., None] & (time_s < np.inf), -time_s, IMPOSSIBLE)
    return table.reshape(1, -1, DIRECTION_COUNT).astype(np.float32), decided.reshape(1, -1)
