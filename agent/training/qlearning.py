"""Independent Q-learning and double Q-learning of N robots: Eq. (7) as one compiled loop.

The loop advances a `TrainingState` by any number of episodes; the state holds everything, the
generator included, so that cutting a run into chunks or resuming it cannot change a bit.
Configuration and state are `agent.training.learning`. Another loop learns by a rule of the user's.
"""

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import types

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
from cosim.base.errors import UserError, failure
from cosim.base.jit import inlined, kernel
from cosim.model.outcome import RUNNING, SUCCESS, TIMEOUT
from cosim.onboard.features import DIRECTION_COUNT

ACTION_BITS = np.uint64(DIRECTION_COUNT - 1)
_ONE = np.uint64(1)


@inlined
def largest(values: np.ndarray) -> tuple[int, np.float32]:
    """Index of the largest of eight values, the lowest of equals (Eq. 6), and that value."""
    # Eq. (6) as a tournament of three rounds, not a chain of seven comparisons: it limits speed
    a, va = (1, values[1]) if values[1] > values[0] else (0, values[0])
    b, vb = (3, values[3]) if values[3] > values[2] else (2, values[2])
    c, vc = (5, values[5]) if values[5] > values[4] else (4, values[4])
    d, vd = (7, values[7]) if values[7] > values[6] else (6, values[6])
    a, va = (b, vb) if vb > va else (a, va)
    c, vc = (d, vd) if vd > vc else (c, vc)
    return (c, vc) if vc > va else (a, va)


@inlined
def best_of_sum(q: np.ndarray, i: int, s: np.uint64) -> int:
    """Return the best action by the sum of the two tables of double Q-learning."""
    action = 0
    best = q[0, i, s, 0] + q[1, i, s, 0]
    for k in range(1, DIRECTION_COUNT):
        value = q[0, i, s, k] + q[1, i, s, k]
        if value > best:
            best = value
            action = k
    return action


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


@kernel
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
    chosen = np.empty(n, dtype=np.int64)
    executed = np.empty(n, dtype=np.int64)
    state = np.empty(n, dtype=np.uint64)
    greedy = np.empty(n, dtype=np.int64)
    moved = np.empty(n, dtype=np.bool_)
    rewards = np.empty(n, dtype=np.float32)
    returns = np.empty(n, dtype=np.float64)
    gamma = learning.gamma
    penalty = -process.goal_reward
    slips = process.slip_threshold > np.uint64(0)
    agent_steps = 0
    for episode in range(first, last):
        block = episode // learning.epsilon_episodes
        threshold, eta = learning.epsilon_thresholds[block], learning.eta[block]
        explores = threshold > np.uint64(0)
        place_randomly(process, world, cells, random)
        for i in range(n):
            returns[i] = 0.0
            state[i] = state_index(process, world, i)
            if learning.double_q:
                greedy[i] = best_of_sum(q, i, state[i])
            else:
                greedy[i], _ = largest(q[0, i, state[i]])
        moves = 0
        diagonal_moves = 0
        outcome = RUNNING
        step = 0
        while outcome == RUNNING:
            step += 1
            for i in range(n):
                moved[i] = world[i, STATUS] == MOVING
                if moved[i]:
                    chosen[i] = greedy[i]
                    if explores:
                        # no branch on what cannot be predicted: it would cost more than the draw
                        word = next_word(random)
                        explored = np.int64(word & ACTION_BITS)
                        chosen[i] = (
                            explored if (word >> PROBABILITY_SHIFT) < threshold else greedy[i]
                        )
                    executed[i] = chosen[i]
                    if slips:
                        executed[i] = slipped(process, chosen[i], random)
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
                s, a = state[i], chosen[i]
                visits[i, s] += np.uint32(1)
                updated = 0
                if learning.double_q:
                    updated = np.int64(next_word(random) & _ONE)
                # begin update
                if world[i, STATUS] == MOVING:
                    s_next = state_index(process, world, i)
                    target = rewards[i]
                    if failed and process.partner_update == 2:
                        continue
                    if failed and process.partner_update == 1:
                        target = penalty
                        best = 0
                    else:
                        best, value = largest(q[updated, i, s_next])
                        if learning.double_q:
                            # the other table values the action that this one picks
                            value = q[1 - updated, i, s_next, best]
                        # Eq. (4): a reward, and what is expected from the next state on
                        target += gamma * value
                    # Eq. (7), down the gradient of Eq. (5) with a constant target
                    q[updated, i, s, a] += eta * (target - q[updated, i, s, a])
                    state[i] = s_next
                    if learning.double_q:
                        greedy[i] = best_of_sum(q, i, s_next)
                    else:
                        # the row changed after `best` was found if the features hide the move
                        greedy[i] = best if s_next != s else largest(q[0, i, s_next])[0]
                else:
                    # Eq. (7) in a terminal state
                    q[updated, i, s, a] += eta * (rewards[i] - q[updated, i, s, a])
                # end update
        agent_steps += moves
        path_cells = (moves - diagonal_moves) + SQRT_2 * diagonal_moves
        log_episode(learning, curve, episode, outcome == SUCCESS, path_cells, moves, returns)
    return agent_steps


def advance(process: Process, learning: Learning, state: TrainingState, until: int) -> None:
    """Train a state up to episode `until` on the grid, in place."""
    state.agent_steps += _run_episodes(process, learning, *state.arrays, state.episode, until)
    state.episode = until


@inlined
def _drawn(q: np.ndarray, i: int, s: np.uint64, threshold: np.uint64, random: np.ndarray) -> int:
    """Action of robot i in a state: greedy, or with the probability of exploration any."""
    word = next_word(random)
    if (word >> PROBABILITY_SHIFT) < threshold:
        return int(word & ACTION_BITS)
    action, best = 0, np.float32(-np.inf)
    for k in range(DIRECTION_COUNT):
        value = q[0, i, s, k]
        for table in range(1, len(q)):
            value += q[table, i, s, k]
        if value > best:
            action, best = k, value
    return action


def _run_by_rule(
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
    """Train over episodes [first, last) by a rule; returns the agent steps.

    Q-learning has a loop of its own, which knows the greedy action of the next state from its
    update. Here a robot draws its next action before the update, so that a rule can learn from it.
    """
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
def _compiled_loop() -> Callable[..., int]:
    return numba.njit(nogil=True, error_model="numpy")(_run_by_rule)


# Types of a rule's arguments.
_RULE = (
    *(types.Array(types.float32, 3, "A"), types.uint64, types.int64, types.float32, types.float32),
    *(types.uint64, types.int64, types.float32, types.uint64),
)


def compiled_rule(name: str, rule: Callable[..., None]) -> Any:
    """Return a user's rule for `advance_by`, compiled with checks of all indices; or UserError.

    Compiled at every call, as numba keeps the values that a function's global names had then.
    """
    try:
        compiled: Any = numba.njit(nogil=True, error_model="numpy", boundscheck=True)(rule)
        compiled.compile(_RULE)
    except Exception as error:  # whatever numba says of a user's code
        raise failure(f"compiling the rule {name}", error, _first_of(str(error))) from error
    if (returned := compiled.overloads[_RULE].signature.return_type) != types.none:
        raise UserError(f"the rule {name} returns {returned}; have it update q, and return nothing")
    return compiled


def _first_of(message: str) -> str:
    """Return the first statement of a message of numba, and the line that it is about."""
    plain = re.sub(r"\x1b\[[\d;]*m|Failed in nopython mode pipeline \(.*\)\n", "", message)
    statement = re.split(r"\n\s*(?:File |During: |There are )", plain)[0]
    line = re.search(r'File "[^"]*", (line \d+)', plain)
    return f"{statement}, {line[1]}" if line else statement


def advance_by(
    rule: Any,
    process: Process,
    learning: Learning,
    state: TrainingState,
    until: int,
) -> None:
    """Train a state up to episode `until` by a `compiled_rule`, in place."""
    state.agent_steps += _compiled_loop()(
        rule, process, learning, *state.arrays, state.episode, until
    )
    state.episode = until
