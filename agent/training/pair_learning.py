"""Learning of two robots that share one table: the time that both together still take, on moves.

The table is that of `agent.moves.pair`, by what both have committed themselves to: the cell and the
axis in which each one's move ends. Robots choose by looking one move ahead, and every commitment
learns from the next one (TD(0) over after-states): the time of the moves begun then, and what is
known of what follows. In every episode one robot explores, among the moves that keep apart, while
its partner is greedy, and nothing is learnt from a choice that was explored but its failure.

Values begin at the times of robots that are alone, raised by `EXCESS`. Times that are too small
everywhere make robots try every detour that they have not tried yet (learning real-time A*); times
that are too large keep them on paths that they know, from which exploration finds better ones
(Shimbo and Ishida 2003, Controlling the learning process of real-time heuristic search).
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
from agent.mdp.joint import IMPOSSIBLE
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
from cosim.onboard.features import DIRECTION_COUNT

EXCESS = 0.5  # assumed: of the times that values begin at, over those of robots alone
FAILURE_S = 500.0  # assumed: time of both robots that a failure counts as
_FIRST_RATE = 0.3  # assumed: largest learning rate of a commitment, then one over its visits
_ROUNDING = 1e-9  # of times, in RL steps
_BOTH = 2  # robots that may explore


def first_delay(process: Process, times: PairTimes) -> np.ndarray:
    """(2, cells, AXIS_COUNT) uint16, what each robot adds to the delays that learning begins with.

    Raises:
        UserError: a robot has no path from one of its starts to its target.
    """
    alone = times.alone[..., STARTING_AXIS]
    require_paths(process, Bound(alone, alone, relaxed=True))
    known = np.where(np.isfinite(times.alone), times.alone, 0.0)
    return np.rint(EXCESS / GRAIN_S * known).clip(0, UNREACHABLE // 2).astype(np.uint16)


def of_both(delay: np.ndarray) -> np.ndarray:
    """Return the sums of what both robots add, in the shape of `PairTimes.delay`."""
    return delay[0][:, :, None, None] + delay[1]


def kept_delay(delay: np.ndarray) -> np.ndarray:
    """Return learnt delays as a policy keeps them: uint16."""
    return np.rint(delay).clip(0, UNREACHABLE - 1).astype(np.uint16)


@inlined
def _learn(
    times: PairTimes,
    visits: np.ndarray,
    at: tuple[int, int, int, int],
    time_s: float,
    eta: np.float32,
) -> None:
    """Move what is known of a commitment towards a time of both robots in s.

    The first visits count as much as they should in a mean, so that a rare failure changes little
    where robots have often been.
    """
    p, axis, q, other = at
    delay = np.float32((time_s - times.alone[0, p, axis] - times.alone[1, q, other]) / GRAIN_S)
    known = times.delay[p, axis, q, other]
    visits[p, axis, q, other] += np.uint32(1)
    rate = np.float32(min(_FIRST_RATE, 1.0 / visits[p, axis, q, other]))
    times.delay[p, axis, q, other] = known + max(rate, eta) * (delay - known)


@inlined
def _known_s(times: PairTimes, at: tuple[int, int, int, int]) -> float:
    p, axis, q, other = at
    known = times.delay[p, axis, q, other]
    return times.alone[0, p, axis] + times.alone[1, q, other] + GRAIN_S * known


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
    decisions = 0
    for episode in range(first, last):
        block = episode // learning.epsilon_episodes
        threshold, eta = learning.epsilon_thresholds[block], learning.eta[block]
        place_randomly(process, world, starts, random)
        stand(model, world, plans, random)
        explorer = _BOTH if explorers == _BOTH else next_index(random, 2)
        returns[:] = 0.0
        cells[:] = world[:, X] * rows + world[:, Y]
        at = (cells[0], world[0, AXIS], cells[1], world[1, AXIS])
        moves, diagonal, steps, outcome = 0, 0, 0, RUNNING
        while outcome == RUNNING:
            asked = False
            for i in range(2):
                if waits(plans, i):
                    cells[i] = goals[i] = world[i, X] * rows + world[i, Y]
                    asked |= world[i, STATUS] == MOVING
            if asked:
                axes[:] = world[:, AXIS]
                pair_values(times, cells, goals, axes, values)
                explored, taken_s = False, 0.0
                for i in range(2):
                    if world[i, STATUS] != MOVING or not waits(plans, i):
                        continue
                    a = least_rotation_argmax(values[i], axes[i])
                    if explorer in (_BOTH, i):
                        word = next_word(random)
                        tried = np.int64(word & ACTION_BITS)
                        explores = (word >> PROBABILITY_SHIFT) < threshold
                        if explores and tried != a and values[i, tried] > 0.5 * IMPOSSIBLE:
                            a, explored = tried, True
                    moves += 1
                    diagonal += a & 1
                    outcome = max(
                        outcome, begin_move(process, model, world, plans, i, int(a), random)
                    )
                    goals[i] += world[i, VX] * rows + world[i, VY]
                    lasts = math.ceil(plans[i, DURATION_S] / model.rl_step_s - _ROUNDING)
                    taken_s += lasts * model.rl_step_s
                    returns[i] -= lasts * model.rl_step_s
                after = (goals[0], world[0, AXIS], goals[1], world[1, AXIS])
                if not explored:
                    _learn(times, visits, at, taken_s + _known_s(times, after), eta)
                at = after
            if outcome == RUNNING:
                outcome, passed = step(process, model, world, plans, rewards)
                steps += passed
                if outcome == RUNNING and steps >= step_limit:
                    outcome = TIMEOUT  # a cut, not an end
        if outcome not in (SUCCESS, TIMEOUT):
            _learn(times, visits, at, FAILURE_S, eta)
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
) -> None:
    """Train a state up to episode `until`, in place.

    Args:
        process: of two robots.
        model: their moves.
        learning: the schedule.
        times: see `agent.moves.pair.moves_of_pair`; delays are those of the state.
        state: whose table `q` is the delays.
        until: episode.
        explorers: robots that explore in an episode, 1 or 2.
    """
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
        until,
    )
    state.episode = until
