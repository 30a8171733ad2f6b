"""Plans of a group of robots in space and time, on mean times of observed moves.

Robots plan one after the other (prioritised planning): each takes the path of least time that keeps
clear of the moves of those before it, found by A* over cell, facing and time. Robots that need
least time plan first, because others have to go round where they park; one without a path goes
first, and all plan again. Nothing is kept between two decisions: robots under way end the move that
they have begun, and all others plan again, so that what moves really took is known. Moves last
longer or shorter than their mean, so that robots stay clear of a move for some seconds before and
after it.
Robots cannot wait: one that has to drives back and forth.
"""

import heapq
import math
from typing import NamedTuple

import numpy as np

from agent.mdp.interpretations import Process
from agent.mdp.joint import BLOCKED, iterate_alone
from agent.moves.model import ObservedMoves
from agent.moves.times import Board, board_of, direction_towards, squared_distance
from cosim.base.jit import inlined, kernel
from cosim.onboard.features import DIRECTION_COUNT, facing_of

VERSION = 2  # of plans: raise it when their bits change

# Of times round parked robots, kept for every set of them, and of the board.
MOST_TIMES, MOST_CELLS = 2_000_000, 10_000
_EARLIER_S = 2.0  # assumed: moves begin and end by that much earlier or later than planned
_LEFT = 0.75  # assumed: share of its time that is left of a move under way
_NEARER = 0.8  # of the squared distances kept, where there is no plan otherwise
_ROUNDS = 12  # of planning, before robots come nearer
_PLANS = 3  # of which the one with the least sum of times counts
_DETOUR_S = 10.0  # assumed: what passing a target costs at most, before its robot has parked
_WEIGHT = 1.1  # of the time that is left, against the time until then
_SLICE, _SLICES = 0.5, 200  # of the shortest move: times in a slice count as the same
_MOST_NODES = 20_000  # of a search
_MOST_MOVES = 200  # of a plan
_ROUNDING = 1e-9

BEGIN, END, FROM, TO = range(4)  # columns of a planned move: times in s, and cells


class Group(NamedTuple):
    """Board and times that a group plans by."""

    board: Board
    # (N, 2^N, cells, facings) float32, least time in s of each robot among others that have
    # parked, by a bit for each of those, by its cell and what it faces
    around: np.ndarray
    slice_s: float  # length of a slice of time, in which a cell is reached with a facing but once


@inlined
def _to_line(p: int, q: int, q_after: int, at: np.ndarray) -> float:
    """Squared distance in cells² of a cell from the line between two others."""
    x, y = float(at[p, 0] - at[q, 0]), float(at[p, 1] - at[q, 1])
    along_x, along_y = float(at[q_after, 0] - at[q, 0]), float(at[q_after, 1] - at[q, 1])
    length = max(along_x * along_x + along_y * along_y, 1.0)
    share = min(max((x * along_x + y * along_y) / length, 0.0), 1.0)
    x, y = x - share * along_x, y - share * along_y
    return x * x + y * y


@kernel
def _apart(p: int, p_after: int, q: int, q_after: int, at: np.ndarray) -> float:
    """Squared distance in cells² of the lines of two moves, which do not cross."""
    return min(
        _to_line(p, q, q_after, at),
        _to_line(p_after, q, q_after, at),
        _to_line(q, p, p_after, at),
        _to_line(q_after, p, p_after, at),
    )


@inlined
def _index(
    plans: np.ndarray, counts: np.ndarray, since: np.ndarray, j: int, slice_s: float
) -> None:
    """Update the index of the first move of robot j that others still avoid in a slice of time."""
    m = 0
    for piece in range(_SLICES):
        while m < counts[j] and plans[j, m, END] + _EARLIER_S <= piece * slice_s:
            m += 1
        since[j, piece] = m


@kernel
def _is_clear(
    group: Group,
    plans: np.ndarray,
    counts: np.ndarray,
    since: np.ndarray,
    k: int,
    own: np.ndarray,
    share: float,
) -> bool:
    """Return whether a move of robot k keeps clear of all planned moves of the others.

    The first move of robots that are nearer than they should be has to lead apart.

    Args:
        plans: (N, _MOST_MOVES, 4) float64, moves that robots have begun or planned.
        counts: (N,) int64, their number.
        since: (N, _SLICES) int64, see `_index`.
        own: (4,) float64, its move; one that begins at −inf is its first.
        share: of the squared distances to keep.
    """
    p, p_after, first = int(own[FROM]), int(own[TO]), own[BEGIN] == -math.inf
    begin = 0.0 if first else own[BEGIN]
    for j in range(len(counts)):
        far = (math.sqrt(share * group.board.kept) + 2.0 * math.sqrt(2.0)) ** 2
        for m in range(since[j, int(begin / group.slice_s)], counts[j] if j != k else 0):
            if plans[j, m, BEGIN] - _EARLIER_S >= own[END]:
                break
            if plans[j, m, END] + _EARLIER_S <= begin:
                continue
            q, q_after = int(plans[j, m, FROM]), int(plans[j, m, TO])
            before = float(squared_distance(p, q, group.board.at))
            if before >= far:
                continue
            parks = p_after == group.board.targets[k] and plans[j, m, END] == math.inf
            need = share * (group.board.parked[k, j] if parks else group.board.kept)
            if first and before < need:
                if squared_distance(p_after, q_after, group.board.at) <= before:
                    return False
                if _apart(p, p_after, q, q_after, group.board.at) < before - _ROUNDING:
                    return False
            elif _apart(p, p_after, q, q_after, group.board.at) < need - _ROUNDING:
                return False
    return True


@inlined
def _parks_from(group: Group, plans: np.ndarray, counts: np.ndarray, k: int, share: float) -> float:
    """Time in s from which robot k may be at its target; inf if never."""
    target, soonest = group.board.targets[k], 0.0
    for j in range(len(counts)):
        for m in range(counts[j] if j != k else 0):
            near = _to_line(target, int(plans[j, m, FROM]), int(plans[j, m, TO]), group.board.at)
            need = group.board.parked[k, j] if plans[j, m, END] == math.inf else group.board.kept
            if near < share * need - _ROUNDING:
                soonest = max(soonest, plans[j, m, END] + _EARLIER_S)
    return soonest


@kernel
def _search(
    group: Group,
    plans: np.ndarray,
    counts: np.ndarray,
    since: np.ndarray,
    k: int,
    axis: int,
    begin: float,
    parked: int,
    share: float,
    reached: np.ndarray,
    stamp: int,
    nodes: np.ndarray,
    clock: np.ndarray,
) -> float:
    """Add a path to the plans of robot k, from where its last move ends.

    Args:
        plans, counts, since: see `_is_clear`; updated.
        axis, begin: what robot k faces from `begin` on, which is in s.
        parked: bits of the robots with targets that it drives around.
        reached: (cells, facings, _SLICES) int16, working memory: the last search that has
            reached a cell with a facing in a slice of time.
        stamp: of this search.
        nodes: (_MOST_NODES, 3) int32, working memory: cell, facing, and node before.
        clock: (_MOST_NODES,) float64, working memory: time of each node in s.

    Returns:
        When it ends, in s; inf if none is found.
    """
    target, around, alone = group.board.targets[k], group.around[k, parked], group.around[k, 0]
    parks_from = _parks_from(group, plans, counts, k, share)
    own, count = np.empty(4), 1
    nodes[0, 0], nodes[0, 1], nodes[0, 2] = int(plans[k, counts[k] - 1, TO]), axis, -1
    clock[0] = begin
    queue = [(0.0, 0.0, 0)]
    while len(queue) > 0 and parks_from < math.inf:
        _, _, node = heapq.heappop(queue)
        p, facing, now = nodes[node, 0], nodes[node, 1], clock[node]
        if p == target:
            end = _keep_path(plans, counts, k, node, nodes, clock)
            _index(plans, counts, since, k, group.slice_s)
            return end
        for a in range(DIRECTION_COUNT):
            q, next_axis = group.board.after[k, p, a], facing_of(a, around.shape[1])
            then = now + group.board.seconds[a, facing]
            piece = int(then / group.slice_s)
            if q == BLOCKED or piece >= _SLICES or reached[q, next_axis, piece] == stamp:
                continue
            own[BEGIN], own[END], own[FROM], own[TO] = now, then, p, q
            if node == 0 and begin == 0.0:
                own[BEGIN] = -math.inf
            if (q == target and then < parks_from) or not _is_clear(
                group, plans, counts, since, k, own, share
            ):
                continue
            left = min(around[q, next_axis], alone[q, next_axis] + np.float32(_DETOUR_S))
            if count == len(nodes) or left == np.inf:
                continue
            reached[q, next_axis, piece] = stamp
            nodes[count, 0], nodes[count, 1], nodes[count, 2] = q, next_axis, node
            clock[count] = then
            heapq.heappush(queue, (max(parks_from, then + _WEIGHT * left), np.float64(left), count))
            count += 1
    return math.inf


@inlined
def _keep_path(
    plans: np.ndarray, counts: np.ndarray, k: int, node: int, nodes: np.ndarray, clock: np.ndarray
) -> float:
    """Add the path to a node to the plans of robot k, which parks there; return its time in s."""
    length, last, end = 0, node, clock[node]
    while nodes[last, 2] >= 0:
        last, length = nodes[last, 2], length + 1
    row = counts[k] + length
    if row >= _MOST_MOVES:
        return math.inf
    counts[k] = row + 1
    plans[k, row, BEGIN], plans[k, row, END] = end, math.inf
    plans[k, row, FROM] = plans[k, row, TO] = nodes[node, 0]
    while nodes[node, 2] >= 0:
        row, before = row - 1, nodes[node, 2]
        plans[k, row, BEGIN], plans[k, row, END] = clock[before], clock[node]
        plans[k, row, FROM], plans[k, row, TO] = nodes[before, 0], nodes[node, 0]
        node = before
    return end


@kernel
def plan(
    group: Group,
    cells: np.ndarray,
    goals: np.ndarray,
    axes: np.ndarray,
    actions: np.ndarray,
    ends: np.ndarray,
) -> None:
    """Plan for all robots.

    Args:
        cells: (N,) int64, cell of each robot.
        goals: (N,) int64, cell that each robot drives to; its own if it waits.
        axes: (N,) int64, what each robot faces.
        actions: (N,) int64, first direction of each robot that waits, −1 of the others; updated.
        ends: (N,) float64, time in s until each robot is at its target by its plan, inf where there
            is none; updated.
    """
    n, facings = len(cells), group.board.seconds.shape[1]
    plans, counts = np.empty((n, _MOST_MOVES, 4)), np.ones(n, dtype=np.int64)
    since = np.empty((n, _SLICES), dtype=np.int64)
    begins, facing, left = np.zeros(n), axes.copy(), np.zeros(n)
    at_targets = 0
    for i in range(n):
        plans[i, 0, BEGIN], plans[i, 0, END] = -math.inf, _EARLIER_S
        plans[i, 0, FROM], plans[i, 0, TO] = cells[i], goals[i]
        if goals[i] != cells[i]:
            direction = direction_towards(cells[i], goals[i], group.board.at)
            facing[i] = facing_of(direction, facings)
            begins[i] = _LEFT * group.board.seconds[direction, axes[i]]
            plans[i, 0, END] = begins[i]
        if goals[i] == group.board.targets[i]:
            plans[i, 0, END] = math.inf
            at_targets |= 1 << i
        left[i] = begins[i] + group.around[i, 0, goals[i], facing[i]]
    order = np.argsort(left)
    reached = np.zeros((len(group.board.at), facings, _SLICES), dtype=np.int16)
    nodes, clock = np.empty((_MOST_NODES, 3), dtype=np.int32), np.empty(_MOST_NODES)
    stamp, plans_made, best, own_ends = 0, 0, math.inf, np.empty(n)
    for turn in range(_ROUNDS + 1):
        last = turn == _ROUNDS
        counts[:] = 1
        for i in range(n):
            _index(plans, counts, since, i, group.slice_s)
        failed, parked = -1, at_targets
        for rank in range(n):
            k = int(order[rank])
            own_ends[k] = begins[k]
            if (at_targets >> k) & 1:
                continue
            stamp += 1
            own_ends[k] = _search(
                group, plans, counts, since, k, facing[k], begins[k], parked,
                _NEARER if last else 1.0, reached, stamp, nodes, clock,
            )  # fmt: skip
            parked |= 1 << k
            if own_ends[k] == math.inf and not last:
                failed = rank
                break
        if failed < 0:
            if own_ends.sum() < best or (last and best == math.inf):
                best = own_ends.sum()
                ends[:] = own_ends
                for i in range(n):
                    actions[i] = -1
                    if goals[i] == cells[i] and not (at_targets >> i) & 1:
                        actions[i] = _first_move(group, plans, counts, i, cells[i])
            plans_made += 1
            if plans_made == _PLANS or last:
                break
            failed = (own_ends - left)[order].argmax()  # delayed most
        k = order[failed]
        order[1 : failed + 1] = order[:failed].copy()
        order[0] = k
        if plans_made > 0 and turn == _ROUNDS - 1:
            break


@inlined
def _first_move(group: Group, plans: np.ndarray, counts: np.ndarray, i: int, cell: int) -> int:
    """Direction of robot i's first planned move; without a plan the one that keeps furthest."""
    best, farthest = 0, -math.inf
    for a in range(DIRECTION_COUNT):
        q, near = group.board.after[i, cell, a], math.inf
        if q == BLOCKED:
            continue
        if counts[i] > 1:
            if q == int(plans[i, 1, TO]):
                return a
            continue
        for j in range(len(counts)):
            for m in range(min(counts[j], 2) if j != i else 0):
                others = int(plans[j, m, FROM]), int(plans[j, m, TO])
                near = min(near, _apart(cell, q, others[0], others[1], group.board.at))
        if near > farthest:
            best, farthest = a, near
    return best


@kernel
def _open_moves(board: Board, k: int, parked: int, after: np.ndarray) -> None:
    """Write where robot k may move, (cells, 8), among others that have parked."""
    for p in range(len(board.at)):
        for a in range(DIRECTION_COUNT):
            q = after[p, a] = board.after[k, p, a]
            for j in range(len(board.targets)):
                if q not in (BLOCKED, p) and (parked >> j) & 1:
                    near = _to_line(board.targets[j], p, q, board.at)
                    need = board.parked[k, j] if q == board.targets[k] else board.kept
                    if near < need - _ROUNDING:
                        after[p, a] = BLOCKED


def group_of(process: Process, moves: ObservedMoves) -> Group:
    """Return what the robots of a process plan by; less than a second for six robots.

    It has at most `MOST_CELLS` cells and the robots that `MOST_TIMES` permits, the moves one world.
    """
    board = board_of(process, moves)
    n, cells = board.after.shape[:2]
    around = np.full((n, 1 << n, cells, moves.facings), np.inf, dtype=np.float32)
    after = np.empty((cells, DIRECTION_COUNT), dtype=np.int64)
    for k in range(n):
        for parked in range(1 << n):
            if not (parked >> k) & 1:
                around[k, parked, board.targets[k]] = 0.0
                _open_moves(board, k, parked, after)
                iterate_alone(after, board.seconds, around[k, parked])
    return Group(board, around, _SLICE * float(board.seconds.min()))
