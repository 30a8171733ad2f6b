"""Learning by a rule of the user's, on the grid: the loop around it.

Q-learning has a loop of its own (`agent.training.qlearning`), which knows the greedy action of the
next state from its update. Here a robot draws its next action before the update, so that a rule
can learn from it. Compiled with the rule, once in every process.
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
from agent.training.learning import Learning, TrainingState
from agent.training.qlearning import ACTION_BITS, best_of_sum, largest, log_episode
from cosim.base.jit import inlined
from cosim.model.outcome import RUNNING, SUCCESS, TIMEOUT


@inlined
def _drawn(q: np.ndarray, i: int, s: np.uint64, threshold: np.uint64, random: np.ndarray) -> int:
    """Action of robot i in a state: greedy, or with the probability of exploration any."""
    word = next_word(random)
    if (word >> PROBABILITY_SHIFT) < threshold:
        return int(word & ACTION_BITS)
    return best_of_sum(q, i, s) if len(q) > 1 else largest(q[0, i, s])[0]


def _run_episodes(
    update: Callable[..., None],
    process: Process,
    learning: Learning,
    q: np.ndarray,
    visits: np.ndarray,
    random: np.ndarray,
    curve: np.ndarray,
    first: int,
    last: int,
) -> int:
    """Train over episodes [first, last), see `agent.training.qlearning`."""
    n = len(process.start_offsets) - 1
    world, cells = np.empty((n, COLUMN_COUNT), np.int64), np.empty((n, 2), np.int64)
    state, action = np.empty(n, np.uint64), np.empty(n, np.int64)
    executed, moved = np.empty(n, np.int64), np.empty(n, np.bool_)
    rewards, returns = np.empty(n, np.float32), np.empty(n)
    slips = process.slip_threshold > np.uint64(0)
    decisions = 0
    for episode in range(first, last):
        block = episode // learning.epsilon_episodes
        threshold, eta = learning.epsilon_thresholds[block], learning.eta[block]
        place_randomly(process, world, cells, random)
        for i in range(n):
            state[i], returns[i] = state_index(process, world, i), 0.0
            action[i] = _drawn(q, i, state[i], threshold, random)
        moves = diagonal = step = 0
        outcome = RUNNING
        while outcome == RUNNING:
            step += 1
            for i in range(n):
                moved[i] = world[i, STATUS] == MOVING
                executed[i] = slipped(process, action[i], random) if slips else action[i]
            outcome = move(process, world, executed, rewards)
            failed = outcome not in (RUNNING, SUCCESS)
            if outcome == RUNNING and step == process.step_limit:
                outcome = TIMEOUT  # a cut, not an end: the update still bootstraps
            for i in range(n):
                if not moved[i]:
                    continue
                s, a, reward, discount = state[i], action[i], rewards[i], np.float32(0.0)
                moves += 1
                diagonal += world[i, VX] & world[i, VY] & 1
                returns[i] += reward
                visits[i, s] += np.uint32(1)
                if world[i, STATUS] == MOVING:
                    if failed and process.partner_update == 2:
                        continue
                    state[i] = state_index(process, world, i)
                    action[i] = _drawn(q, i, state[i], threshold, random)
                    discount = learning.gamma
                    if failed and process.partner_update == 1:
                        reward, discount = -process.goal_reward, np.float32(0.0)
                coin = next_word(random)
                update(q[:, i], s, a, reward, discount, state[i], action[i], eta, coin)
        decisions += moves
        path_cells = moves + (SQRT_2 - 1.0) * diagonal
        log_episode(learning, curve, episode, outcome == SUCCESS, path_cells, moves, returns)
    return decisions


@cache
def _compiled(function: Callable) -> Callable:
    return numba.njit(nogil=True, error_model="numpy")(function)


def advance_by(
    rule: Callable[..., None],
    process: Process,
    learning: Learning,
    state: TrainingState,
    until: int,
) -> None:
    """Train a state up to episode `until` by a rule (`agent.training.methods.learner`)."""
    state.agent_steps += _compiled(_run_episodes)(
        _compiled(rule), process, learning, *state.trained, state.episode, until
    )
    state.episode = until
