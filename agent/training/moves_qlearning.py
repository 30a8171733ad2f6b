"""Tabular learning where moves last, by any rule: Eq. (7) over moves.

A robot that decides again k RL steps later has earned the rewards of those steps, discounted, and
bootstraps with γ^k (a semi-Markov decision process). Tables, schedule and learning curves are those
of `agent.training.qlearning`; this loop replaces its loop when training has moves. One loop for
both would decide robot by robot and keep sums of rewards where on the grid all decide and learn at
once: other draws in another order, hence other bits, and a slower grid.
"""

import numpy as np

from agent.mdp.config import REWARDS_PER
from agent.mdp.grid import (
    ARRIVED,
    COLUMN_COUNT,
    MOVING,
    SQRT_2,
    STATUS,
    place_randomly,
    state_index,
)
from agent.mdp.interpretations import Process
from agent.mdp.rng import next_word
from agent.moves.kernels import PLAN_SIZE, begin_move, reset_plans, step, waits
from agent.moves.model import MoveModel
from agent.training.learning import Learning, TrainingState
from agent.training.qlearning import best_action, explored, log_episode, loop_of
from agent.training.rules import correct
from cosim.model.outcome import RUNNING, SUCCESS, TIMEOUT
from cosim.model.params import TIMING


def _run_episodes(
    process: Process,
    model: MoveModel,
    learning: Learning,
    q: np.ndarray,
    visits: np.ndarray,
    random: np.ndarray,
    curve: np.ndarray,
    first: int,
    last: int,
    discounts: np.ndarray,
) -> int:
    """Train over episodes [first, last), and return the decisions made; `discounts` stay."""
    n = len(process.start_offsets) - 1
    world = np.empty((n, COLUMN_COUNT), dtype=np.int64)
    plans = np.empty((n, PLAN_SIZE))
    cells = np.empty((n, 2), dtype=np.int64)
    state = np.empty(n, dtype=np.uint64)
    action = np.empty(n, dtype=np.int64)
    rewards = np.empty(n, dtype=np.float32)
    earned = np.empty(n, dtype=np.float32)  # since the decision, discounted to it
    discount = np.empty(n, dtype=np.float32)  # γ^k after k steps
    returns = np.empty(n, dtype=np.float64)
    penalty = -process.goal_reward
    step_limit = process.step_limit * model.most_steps
    several, ahead = len(learning.tables) > 1, learning.ahead
    decisions = 0
    for episode in range(first, last):
        block = episode // learning.block
        threshold, eta = learning.epsilon_thresholds[block], learning.eta[block]
        place_randomly(process, world, cells, random)
        reset_plans(model, world, plans, random)
        returns[:] = 0.0
        moves = diagonal = steps = 0
        outcome = RUNNING
        while outcome == RUNNING:
            for i in range(n):
                if world[i, STATUS] != MOVING or not waits(plans, i):
                    continue
                s = state_index(process, world, i)
                if steps == 0 or not ahead:
                    action[i] = explored(best_action(learning, q, i, s), threshold, random)
                state[i], a = s, action[i]
                earned[i], discount[i] = np.float32(0.0), np.float32(1.0)
                visits[i, s] += np.uint32(1)
                decisions += 1
                moves += 1
                diagonal += a & 1
                blocked = begin_move(process, model, world, plans, i, int(a), random)
                if blocked != RUNNING:
                    outcome = max(outcome, blocked)  # out of board outranks a collision
                    returns[i] += penalty
                    coin = next_word(random) if several else np.uint64(0)
                    correct(learning.rule, q, i, s, a, penalty, np.float32(0.0), s, a, eta, coin)
            if outcome != RUNNING:
                break
            outcome, passed = step(process, model, world, plans, rewards)
            steps += passed
            if outcome == RUNNING and steps >= step_limit:
                outcome = TIMEOUT  # a cut, not an end: moves under way are not learnt from
            for i in range(n):
                if rewards[i] == np.float32(0.0) and world[i, STATUS] == ARRIVED:
                    continue  # before this step
                returns[i] += rewards[i]
                earned[i] += discount[i] * rewards[i]
                discount[i] *= discounts[passed]
                s, a = state[i], action[i]
                moving = world[i, STATUS] == MOVING
                if moving and not waits(plans, i):
                    continue
                coin = next_word(random) if several else np.uint64(0)
                s_next, share = s, np.float32(0.0)  # if nothing comes after
                if moving:
                    s_next, share = state_index(process, world, i), discount[i]
                    action[i] = best_action(learning, q, i, s_next)
                    if ahead:
                        action[i] = explored(action[i], threshold, random)
                # Eq. (7) over the steps of the move
                correct(learning.rule, q, i, s, a, earned[i], share, s_next, action[i], eta, coin)
        path_cells = moves + (SQRT_2 - 1.0) * diagonal
        log_episode(learning, curve, episode, outcome == SUCCESS, path_cells, moves, returns)
    return decisions


def _discounts(process: Process, model: MoveModel, gamma: np.float32) -> np.ndarray:
    """(S + 1,) float32, γ to the power of what 0 to S RL steps count, S the most at once."""
    steps = np.arange(model.most_steps + 1)
    of_paper = model.rl_step_s / TIMING.rl_step_s
    share = 1.0 if REWARDS_PER[process.reward_per] == "step" else of_paper
    return (float(gamma) ** (steps * share)).astype(np.float32)


_loop = loop_of(_run_episodes)


def advance_moves(
    process: Process, model: MoveModel, learning: Learning, state: TrainingState, until: int
) -> None:
    """Train a state up to episode `until` over moves that last, in place."""
    discounts = _discounts(process, model, learning.gamma)
    state.agent_steps += _loop(learning)(
        process, model, learning, *state.arrays, state.episode, until, discounts
    )
    state.episode = until
