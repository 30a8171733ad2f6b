"""Learning of two robots that share one table: the time that both together still take, on moves.

The table is that of `agent.moves.pair`, by what both have committed themselves to: the cell and the
axis in which each one's move ends. Robots choose by looking one move ahead, and every commitment
learns from the next one (TD(0) over after-states): the mean time of the moves begun then, and what
is known of what follows. With the observed time of every move, what was met would be known as too
slow or too fast, and robots would wander among what they had not met. Commitments learn while the
episode runs, so that robots leave what they find to be slow, and again backwards from its end, so
that one episode tells all its commitments how it ended. The last one learns `FAILURE_S` or, if the
episode succeeds, 0: otherwise one failure next to the targets would never be forgotten.

In every episode one robot explores, among the moves that keep apart, while its partner is greedy:
mostly the move that would be best if it was alone. Of a choice that was explored only what is
better than known is learnt, and failures.

Values begin at the times of robots that are alone, raised by `EXCESS`. Times that are too small
everywhere make robots try every detour that they have not tried yet (learning real-time A*); times
that are too large keep them on paths that they know, from which exploration finds better ones
(Shimbo and Ishida 2003, Controlling the learning process of real-time heuristic search). When
exploration ends, what no episode has met is raised to `UNSEEN_EXCESS`: robots then keep to what
they know.
"""

import math

import numpy as np

from agent.mdp.grid import (
    AXIS,
    COLUMN_COUNT,
    MOVING,
    SQRT_2,
    STARTING_AXIS,
    STATUS,
    VX,
    VY,
    X,
    Y,
    least_rotation_argmax,
    place_randomly,
)
from agent.mdp.joint import BLOCKED, IMPOSSIBLE
from agent.mdp.optimum import Bound, require_paths
from agent.mdp.readings import Process
from agent.mdp.rng import PROBABILITY_SHIFT, next_index, next_word
from agent.moves.kernels import DURATION_S, PLAN_SIZE, begin_move, stand, step, waits
from agent.moves.model import MoveModel
from agent.moves.pair import GRAIN_S, UNREACHABLE, PairTimes, pair_values
from agent.training.learning import Learning, TrainingState
from agent.training.qlearning import ACTION_BITS, book
from cosim.base.jit import inlined, kernel
from cosim.model.outcome import RUNNING, SUCCESS, TIMEOUT
from cosim.onboard.features import AXIS_COUNT, DIRECTION_COUNT

EXCESS = 0.1  # assumed: of the times that values begin at, over those of robots alone
UNSEEN_EXCESS = 0.5  # assumed: the same of commitments never met, once exploration has ended
FAILURE_S = 500.0  # assumed: time of both robots that a failure counts as
FIRST_RATE = 0.7  # assumed: least learning rate of a commitment, over the root of its visits
_RANDOM_BITS = np.uint64(3 << 3)  # of a word; 0 where a robot explores at random
_ROUNDING = 1e-9  # of times, in RL steps
_BOTH = 2  # robots that may explore


def first_delay(process: Process, times: PairTimes, excess: float = UNSEEN_EXCESS) -> np.ndarray:
    """(2, cells, AXIS_COUNT) uint16, what each robot adds to the delays of what was never met.

    Args:
        process: of two robots.
        times: see `agent.moves.pair.moves_of_pair`.
        excess: of the times over those of robots alone.

    Raises:
        UserError: a robot has no path from one of its starts to its target.
    """
    alone = times.alone[..., STARTING_AXIS]
    require_paths(process, Bound(alone, alone, relaxed=True))
    known = np.where(np.isfinite(times.alone), times.alone, 0.0)
    return np.rint(excess / GRAIN_S * known).clip(0, UNREACHABLE // 2).astype(np.uint16)


def of_both(delay: np.ndarray) -> np.ndarray:
    """Return the sums of what both robots add, in the shape of `PairTimes.delay`."""
    return delay[0][:, :, None, None] + delay[1]


def kept_delay(delay: np.ndarray) -> np.ndarray:
    """Return learnt delays as a policy keeps them: uint16."""
    return np.rint(delay).clip(0, UNREACHABLE - 1).astype(np.uint16)


@inlined
def _known_s(times: PairTimes, at: np.ndarray) -> float:
    """Time of both robots in s that is known of a commitment."""
    p, axis, q, other = at[0], at[1], at[2], at[3]
    delay = times.delay[p, axis, q, other]
    return times.alone[0, p, axis] + times.alone[1, q, other] + GRAIN_S * delay


@inlined
def _learn(
    times: PairTimes, visits: np.ndarray, at: np.ndarray, time_s: float, eta: np.float32
) -> None:
    """Move the value of a commitment towards a time of both robots in s."""
    p, axis, q, other = at[0], at[1], at[2], at[3]
    delay = np.float32((time_s - times.alone[0, p, axis] - times.alone[1, q, other]) / GRAIN_S)
    known = times.delay[p, axis, q, other]
    rate = max(np.float32(FIRST_RATE / math.sqrt(max(visits[p, axis, q, other], 1))), eta)
    times.delay[p, axis, q, other] = known + rate * (delay - known)


@inlined
def _best_alone(
    times: PairTimes, i: int, cell: int, axis: int, values: np.ndarray, otherwise: int
) -> int:
    """Return the move of robot i that keeps apart and would be best if it was alone."""
    least, best = math.inf, otherwise
    for a in range(DIRECTION_COUNT):
        after = times.after[i, cell, a]
        if after == BLOCKED or values[i, a] <= 0.5 * IMPOSSIBLE:
            continue
        time = times.seconds[a, axis] + times.alone[i, after, a % AXIS_COUNT]
        if time < least:
            least, best = time, a
    return best


@inlined
def _commit(at: np.ndarray, cells: np.ndarray, world: np.ndarray) -> None:
    """Write the cells and axes in which the robots' moves end to `at`."""
    at[0], at[1], at[2], at[3] = cells[0], world[0, AXIS], cells[1], world[1, AXIS]


@kernel
def _run_episodes(
    process: Process,
    model: MoveModel,
    learning: Learning,
    times: PairTimes,
    explorers: int,
    visits: np.ndarray,
    random: np.ndarray,
    curve: np.ndarray,
    first: int,
    last: int,
) -> int:
    """Train over episodes [first, last); delays, generator and curve are updated.

    Returns:
        The decisions made.
    """
    world = np.zeros((2, COLUMN_COUNT), dtype=np.int64)
    plans = np.empty((2, PLAN_SIZE))
    starts, cells = np.empty((2, 2), dtype=np.int64), np.empty(2, dtype=np.int64)
    goals, axes = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    values = np.empty((2, DIRECTION_COUNT), dtype=np.float32)
    rewards, returns = np.empty(2, dtype=np.float32), np.empty(2)
    rows = process.terrain.shape[2] - 2
    step_limit = process.step_limit * model.most_steps
    at = np.empty((step_limit + 1, 4), dtype=np.int64)  # commitments of the episode
    taken_s, explored = np.empty(step_limit), np.empty(step_limit, dtype=np.bool_)
    decisions = 0
    for episode in range(first, last):
        block = episode // learning.epsilon_episodes
        threshold, eta = learning.epsilon_thresholds[block], learning.eta[block]
        place_randomly(process, world, starts, random)
        stand(model, world, plans, random)
        explorer = _BOTH if explorers == _BOTH else next_index(random, 2)
        returns[:] = 0.0
        cells[:] = world[:, X] * rows + world[:, Y]
        _commit(at[0], cells, world)
        moves, diagonal, steps, outcome, now = 0, 0, 0, RUNNING, 0
        while outcome == RUNNING:
            asked = False
            for i in range(2):
                if waits(plans, i):
                    cells[i] = goals[i] = world[i, X] * rows + world[i, Y]
                    asked |= world[i, STATUS] == MOVING
            if asked:
                axes[:] = world[:, AXIS]
                pair_values(times, cells, goals, axes, values)
                explored[now], taken_s[now] = False, 0.0
                for i in range(2):
                    if world[i, STATUS] != MOVING or not waits(plans, i):
                        continue
                    a = least_rotation_argmax(values[i], axes[i])
                    if explorer in (_BOTH, i):
                        word = next_word(random)
                        tried = np.int64(word & ACTION_BITS)
                        explores = (word >> PROBABILITY_SHIFT) < threshold
                        if explores and word & _RANDOM_BITS:
                            tried = _best_alone(times, i, cells[i], axes[i], values, a)
                        if explores and tried != a and values[i, tried] > 0.5 * IMPOSSIBLE:
                            a, explored[now] = tried, True
                    moves += 1
                    diagonal += a & 1
                    outcome = max(
                        outcome, begin_move(process, model, world, plans, i, int(a), random)
                    )
                    goals[i] += world[i, VX] * rows + world[i, VY]
                    lasts = math.ceil(plans[i, DURATION_S] / model.rl_step_s - _ROUNDING)
                    taken_s[now] += times.seconds[a, axes[i]]
                    returns[i] -= lasts * model.rl_step_s
                _commit(at[now + 1], goals, world)
                visits[at[now, 0], at[now, 1], at[now, 2], at[now, 3]] += np.uint32(1)
                if not explored[now]:
                    time_s = taken_s[now] + _known_s(times, at[now + 1])
                    _learn(times, visits, at[now], time_s, eta)
                now += 1
            if outcome == RUNNING:
                outcome, passed = step(process, model, world, plans, rewards)
                steps += passed
                if outcome == RUNNING and steps >= step_limit:
                    outcome = TIMEOUT  # a cut, not an end
        if outcome != TIMEOUT:
            visits[at[now, 0], at[now, 1], at[now, 2], at[now, 3]] += np.uint32(1)
            _learn(times, visits, at[now], 0.0 if outcome == SUCCESS else FAILURE_S, eta)
        for k in range(now - 1, -1, -1):
            time_s = taken_s[k] + _known_s(times, at[k + 1])
            if not explored[k] or time_s < _known_s(times, at[k]):
                _learn(times, visits, at[k], time_s, eta)
        decisions += moves
        path_cells = moves + (SQRT_2 - 1.0) * diagonal
        book(learning, curve, episode, outcome == SUCCESS, path_cells, moves, returns)
    return decisions


def advance_pair(
    process: Process,
    model: MoveModel,
    learning: Learning,
    times: PairTimes,
    state: TrainingState,
    until: int,
    explorers: int = 1,
    unseen: np.ndarray | None = None,
) -> None:
    """Train a state up to episode `until`, in place.

    Args:
        process: of two robots.
        model: their moves.
        learning: the schedule.
        times: see `agent.moves.pair.moves_of_pair`; delays are those of the state.
        state: training state; its table `q` is the delays.
        until: episode.
        explorers: robots that explore in an episode, 1 or 2.
        unseen: in the shape of `q`, delays of commitments never met, from when exploration ends.
    """
    greedy = np.flatnonzero(learning.epsilon_thresholds == 0)[:1] * learning.epsilon_episodes
    for end in (*greedy[(state.episode <= greedy) & (greedy < until)].tolist(), until):
        state.agent_steps += _run_episodes(
            process,
            model,
            learning,
            times._replace(delay=state.q),
            explorers,
            state.visits,
            state.random,
            state.curve,
            state.episode,
            end,
        )
        state.episode = end
        if end in greedy and unseen is not None:
            np.copyto(state.q, unseen, where=state.visits == 0)
