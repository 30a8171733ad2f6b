"""The least time of two robots together on observed moves: computed, and the moves that take it.

The state is each robot's cell and what it faces. What a joint move costs is the mean times of both
robots' moves; value iteration over all states gives the least sum of both robots' times.
Robots end their moves at different moments, which the states leave out: joint moves keep a gap
(`agent.moves.times.GAP_M`), from one pair of cells to the next and on the way, to leave room for
it. If targets are nearer to each other, robots park one after the other. Values are kept as a delay
over the times of robots that are alone, which compresses well.
"""

import math
from typing import NamedTuple

import numpy as np

from agent.mdp.interpretations import Process
from agent.mdp.joint import BLOCKED, IMPOSSIBLE, choices, joint_states
from agent.moves.model import ObservedMoves
from agent.moves.times import Board, board_of, direction_towards, least_times, squared_distance
from cosim.base.jit import inlined, kernel
from cosim.onboard.features import facing_of

VERSION = 2  # of fastest paths, of one robot too: raise it when their bits change

GRAIN_S = 2.0**-4  # of delays
UNREACHABLE = np.iinfo(np.uint16).max  # delay of a state without a way to the targets
_SETTLED_S = 1e-3  # change of a value that ends the iteration


class PairTimes(NamedTuple):
    """Times by which two robots choose their moves."""

    board: Board
    alone: np.ndarray  # (2, cells, facings) float64, least time in s of each robot as if alone
    # (cells, facings, cells, facings) uint16, by cell and facing of the first robot and of the
    # second: least time of both together over the sum of `alone`, in `GRAIN_S`, or `UNREACHABLE`
    delay: np.ndarray


@inlined
def _nearest(p: int, q: int, p_after: int, q_after: int, at: np.ndarray) -> float:
    """Least squared distance in cells² of robots that move from cells p and q at once."""
    x, y = at[p, 0] - at[q, 0], at[p, 1] - at[q, 1]
    along_x, along_y = at[p_after, 0] - at[q_after, 0] - x, at[p_after, 1] - at[q_after, 1] - y
    length = along_x * along_x + along_y * along_y
    share = min(max(-(x * along_x + y * along_y) / max(length, 1), 0.0), 1.0)
    x_nearest, y_nearest = x + share * along_x, y + share * along_y
    return x_nearest * x_nearest + y_nearest * y_nearest


@inlined
def _keeps_apart(board: Board, p: int, q: int, p_after: int, q_after: int) -> bool:
    """Return whether two robots may move from cells p and q at once.

    They keep the board's distances, or where they are nearer already move apart.
    """
    at, targets, kept = board.at, board.targets, board.kept
    before, ended = squared_distance(p, q, at), squared_distance(p_after, q_after, at)
    if min(before, ended) >= (math.sqrt(kept) + 2.0 * math.sqrt(2.0)) ** 2:  # moves of up to √2
        return True
    one_is_parked = p == targets[0] or q == targets[1]
    if one_is_parked and p_after == targets[0] and q_after == targets[1]:
        kept = board.parked[0, 1]
    if ended < kept and ended <= before:
        return False
    return _nearest(p, q, p_after, q_after, at) >= min(kept, float(before)) - 1e-9


@kernel
def _sweep(
    board: Board,
    order: np.ndarray,
    free: np.ndarray,
    value: np.ndarray,
    facings: tuple[int, ...],
) -> float:
    """Update all states once, in place; return the largest change in s.

    Args:
        order: (2, cells) int64, cells of each robot by its time alone, the nearest first.
        free: (cells, cells) bool, cells in which robots may be and continue.
        value: (cells, facings, cells, facings) float32 in s; updated.
        facings: all of them; a tuple, so that their number is a constant for the compiler.
    """
    after, seconds = board.after, board.seconds
    cells, count, changed = after.shape[1], len(facings), 0.0
    best, new = np.empty(count), np.empty((count, count))
    for state in range(cells * cells):
        p, q = order[0, state // cells], order[1, state % cells]
        if not free[p, q]:
            continue
        new[:] = np.inf
        p_choices, q_choices = choices(after, 0, p), choices(after, 1, q)
        for a in range(p_choices):
            p_after = after[0, p, a]
            if p_after == BLOCKED:
                continue
            best[:] = np.inf
            for b in range(q_choices):
                q_after = after[1, q, b]
                if q_after == BLOCKED or not _keeps_apart(board, p, q, p_after, q_after):
                    continue
                rest = value[p_after, facing_of(a, count), q_after, facing_of(b, count)]
                if rest == np.inf:
                    continue
                for axis in range(count):
                    time = rest + (0.0 if q_choices == 1 else seconds[b, axis])
                    best[axis] = min(best[axis], time)
            for axis in range(count):
                own = 0.0 if p_choices == 1 else seconds[a, axis]
                for other in range(count):
                    new[axis, other] = min(new[axis, other], own + best[other])
        for axis in range(count):
            for other in range(count):
                was = value[p, axis, q, other]
                now = np.float32(new[axis, other])
                if now != was:
                    value[p, axis, q, other] = now
                    changed = max(changed, abs(was - now))
    return changed


def solve_pair(process: Process, moves: ObservedMoves) -> PairTimes:
    """Return the least times of two robots together on moves of one world, from all cells."""
    board, alone = board_of(process, moves), least_times(process, moves)
    free, end = joint_states(process)
    value = np.full((len(board.at), moves.facings) * 2, np.inf, dtype=np.float32)
    value[np.argwhere(end)[:, 0], :, np.argwhere(end)[:, 1]] = 0.0
    order = alone.min(axis=2).argsort(axis=1, kind="stable")
    facings = tuple(range(moves.facings))
    while _sweep(board, order, free, value, facings) > _SETTLED_S:
        pass
    value -= np.where(np.isfinite(alone[0]), alone[0], 0.0).astype(np.float32)[:, :, None, None]
    value -= np.where(np.isfinite(alone[1]), alone[1], 0.0).astype(np.float32)
    value /= np.float32(GRAIN_S)
    np.rint(value, out=value)
    value[~(value < UNREACHABLE)] = UNREACHABLE
    return PairTimes(board, alone, value.clip(0, UNREACHABLE).astype(np.uint16))


@kernel
def pair_values(
    times: PairTimes, cells: np.ndarray, goals: np.ndarray, axes: np.ndarray, values: np.ndarray
) -> None:
    """Action values of two robots if the other one does what is best for both.

    A robot under way ends its move. One that waits may neither meet it on the way nor at its end.
    Of joint moves that are equally good one is preferred by a grain, so that robots that choose
    alone choose the same one: that after which they are furthest apart. Where no move keeps apart,
    the value is the larger the further robots stay apart.

    Args:
        cells: (2,) int64, cell of each robot.
        goals: (2,) int64, cell that each robot drives to; its own if it waits.
        axes: (2,) int64, what each robot faces.
        values: (2, 8) float32, minus the time in s of both robots; updated.
    """
    board = times.board
    at, after, seconds = board.at, board.after, board.seconds
    p, q, facings = cells[0], cells[1], seconds.shape[1]
    values[:] = IMPOSSIBLE
    p_driven, q_driven = goals[0] != p, goals[1] != q
    p_choices = 1 if p_driven else choices(after, 0, p)
    q_choices = 1 if q_driven else choices(after, 1, q)
    p_stays, q_stays = p_driven or p_choices == 1, q_driven or q_choices == 1
    least, best_a, best_b, farthest = math.inf, -1, -1, -1
    for a in range(p_choices):
        p_after = goals[0] if p_driven else after[0, p, a]
        if p_after == BLOCKED:
            continue
        p_axis = facing_of(direction_towards(p, p_after, at) if p_driven else a, facings)
        for b in range(q_choices):
            q_after = goals[1] if q_driven else after[1, q, b]
            if q_after == BLOCKED:
                continue
            apart = (
                _keeps_apart(board, p, q, p_after, q_after)
                and (not q_driven or _keeps_apart(board, p, q_after, p_after, q_after))
                and (not p_driven or _keeps_apart(board, p_after, q, p_after, q_after))
            )
            if not apart:
                near = np.float32(IMPOSSIBLE + _nearest(p, q, p_after, q_after, at))
                values[0, a] = max(values[0, a], near)
                values[1, b] = max(values[1, b], near)
                continue
            q_axis = facing_of(direction_towards(q, q_after, at) if q_driven else b, facings)
            delay = times.delay[p_after, p_axis, q_after, q_axis]
            if delay == UNREACHABLE:
                continue
            alone = times.alone[0, p_after, p_axis] + times.alone[1, q_after, q_axis]
            p_time = 0.0 if p_stays else seconds[a, axes[0]]
            q_time = 0.0 if q_stays else seconds[b, axes[1]]
            time = p_time + q_time + (alone + GRAIN_S * delay)
            values[0, a] = max(values[0, a], np.float32(-time))
            values[1, b] = max(values[1, b], np.float32(-time))
            squared = squared_distance(p_after, q_after, at)
            if time < least - GRAIN_S or (time <= least + GRAIN_S and squared > farthest):
                least, best_a, best_b, farthest = min(time, least), a, b, squared
    for i, best in enumerate((best_a, best_b)):
        if best >= 0:
            largest = values[i, best]
            for value in values[i]:
                largest = max(largest, value)
            values[i, best] = largest + np.float32(GRAIN_S)
        if goals[i] != cells[i]:
            values[i] = values[i, 0]
