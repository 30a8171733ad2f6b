"""Independent tabular learning of N robots on the grid, by any rule, as one compiled loop.

The loop advances a `TrainingState` by any number of episodes; the state holds everything, the
generator included, so that cutting a run into chunks or resuming it cannot change a bit.
Configuration and state are `agent.training.learning`, what a robot learns from a step
`agent.training.rules`.
"""

from collections.abc import Callable
from functools import cache

import numba
import numpy as np

from agent.mdp.grid import (
    COLUMN_COUNT,
    MOVING,
    SQRT_2,
    STATUS,
    VX,
    VY,
    move,
    place_randomly,
    slipped,
    state_index,
)
from agent.mdp.interpretations import Process
from agent.mdp.rng import PROBABILITY_SHIFT, next_word
from agent.training.learning import (
    EPISODES,
    PATH_CELLS,
    RETURNS,
    STEPS,
    SUCCESSES,
    Learning,
    TrainingState,
)
from agent.training.rules import correct, largest
from cosim.base.jit import inlined, kernel
from cosim.model.outcome import RUNNING, SUCCESS, TIMEOUT
from cosim.onboard.features import DIRECTION_COUNT

_ACTION_BITS = np.uint64(DIRECTION_COUNT - 1)


@inlined
def best_action(learning: Learning, q: np.ndarray, i: int, s: np.uint64) -> int:
    """Return the best action of robot i in a state by the sum of its tables (Eq. 6)."""
    if len(learning.tables) == 1:
        return int(largest(q[0, i, s])[0])
    action, best = 0, np.float32(-np.inf)
    for k in range(DIRECTION_COUNT):
        value = q[0, i, s, k]
        for table in range(1, len(learning.tables)):
            value += q[table, i, s, k]
        if value > best:
            action, best = k, value
    return action


@inlined
def explored(action: int, threshold: np.uint64, random: np.ndarray) -> int:
    """Return an action, or with the probability of exploration any."""
    # no branch on what cannot be predicted: it would cost more than the draw
    word = next_word(random)
    other = np.int64(word & _ACTION_BITS)
    return int(other) if (word >> PROBABILITY_SHIFT) < threshold else action


@inlined
def log_episode(
    learning: Learning,
    curve: np.ndarray,
    episode: int,
    success: bool,
    path_cells: float,
    moves: int,
    returns: np.ndarray,
) -> None:
    """Add an episode to its point of the learning curves, if it is in the point's window.

    Path and moves are those of all robots together, returns (N,) float64 those of each.
    """
    if episode % learning.log_episodes < learning.log_episodes - learning.log_window:
        return
    n = len(returns)
    row = episode // learning.log_episodes
    curve[row, EPISODES] += 1.0
    if success:
        curve[row, SUCCESSES] += 1.0
        curve[row, PATH_CELLS] += path_cells / n
        curve[row, STEPS] += moves / n
    for i in range(n):
        curve[row, RETURNS + i] += returns[i]


def _run_episodes(
    process: Process,
    learning: Learning,
    q: np.ndarray,
    visits: np.ndarray,
    random: np.ndarray,
    curve: np.ndarray,
    first: int,
    last: int,
) -> int:
    """Train over episodes [first, last); all arrays are updated. Returns the agent steps."""
    n = len(process.start_offsets) - 1
    world = np.empty((n, COLUMN_COUNT), dtype=np.int64)
    cells = np.empty((n, 2), dtype=np.int64)
    state = np.empty(n, dtype=np.uint64)
    action = np.empty(n, dtype=np.int64)
    executed = np.empty(n, dtype=np.int64)
    moved = np.empty(n, dtype=np.bool_)
    rewards = np.empty(n, dtype=np.float32)
    returns = np.empty(n, dtype=np.float64)
    slips = process.slip_threshold > np.uint64(0)
    several = len(learning.tables) > 1
    agent_steps = 0
    for episode in range(first, last):
        block = episode // learning.block
        threshold, eta = learning.epsilon_thresholds[block], learning.eta[block]
        # when a robot draws whether it explores: before it learns from a move, or before it moves
        early = threshold > np.uint64(0) and learning.ahead
        late = threshold > np.uint64(0) and not learning.ahead
        place_randomly(process, world, cells, random)
        for i in range(n):
            returns[i] = 0.0
            state[i] = state_index(process, world, i)
            action[i] = best_action(learning, q, i, state[i])
            if early:
                action[i] = explored(action[i], threshold, random)
        moves = 0
        diagonal_moves = 0
        outcome = RUNNING
        step = 0
        while outcome == RUNNING:
            step += 1
            for i in range(n):
                moved[i] = world[i, STATUS] == MOVING
                if moved[i]:
                    if late:
                        action[i] = explored(action[i], threshold, random)
                    executed[i] = action[i]
                    if slips:
                        executed[i] = slipped(process, action[i], random)
            # begin loop
            outcome = move(process, world, executed, rewards)
            failed = outcome not in (RUNNING, SUCCESS)
            if outcome == RUNNING and step == process.step_limit:
                outcome = TIMEOUT  # a cut, not an end: the update still bootstraps
            for i in range(n):
                if not moved[i]:
                    continue
                moves += 1
                diagonal_moves += world[i, VX] & world[i, VY] & 1
                returns[i] += rewards[i]
                s, a = state[i], action[i]
                visits[i, s] += np.uint32(1)
                coin = next_word(random) if several else np.uint64(0)
                reward, discount, s_next, a_next = rewards[i], np.float32(0.0), s, a  # at an end
                if world[i, STATUS] == MOVING:
                    if failed and process.partner_update == 2:
                        continue
                    s_next = state_index(process, world, i)
                    a_next = best_action(learning, q, i, s_next)
                    if early:
                        a_next = explored(a_next, threshold, random)
                    discount = learning.gamma
                    if failed and process.partner_update == 1:
                        reward, discount = -process.goal_reward, np.float32(0.0)
                correct(learning.rule, q, i, s, a, reward, discount, s_next, a_next, eta, coin)
                if s_next == s and not early:
                    # the row has changed since, if the features hide the move
                    a_next = best_action(learning, q, i, s)
                state[i], action[i] = s_next, a_next
            # end loop
        agent_steps += moves
        path_cells = (moves - diagonal_moves) + SQRT_2 * diagonal_moves
        log_episode(learning, curve, episode, outcome == SUCCESS, path_cells, moves, returns)
    return agent_steps


def loop_of(loop: Callable[..., int]) -> Callable[[Learning], Callable[..., int]]:
    """Return the compiled loops over episodes: with a rule of `RECORDS` it is kept on disk."""
    kept, own = kernel(loop), cache(lambda: numba.njit(nogil=True, error_model="numpy")(loop))
    return lambda learning: kept if isinstance(learning.rule, tuple) else own()


_loop = loop_of(_run_episodes)


def advance(process: Process, learning: Learning, state: TrainingState, until: int) -> None:
    """Train a state up to episode `until` on the grid, in place."""
    state.agent_steps += _loop(learning)(process, learning, *state.arrays, state.episode, until)
    state.episode = until
