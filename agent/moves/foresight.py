"""Estimate greedy episodes on observed moves: how near robots come, and how long they take.

A cheap picture of an episode in the dynamics: thousands of them cost less than one there. It knows
no noise but that of the moves, and no shield.
"""

import math

import numpy as np

from agent.mdp.grid import (
    AXIS,
    COLUMN_COUNT,
    MOVING,
    STATUS,
    least_rotation_argmax,
    place,
    state_index,
)
from agent.mdp.readings import Process
from agent.moves.kernels import AT_X, AT_Y, PLAN_SIZE, begin_move, stand, step, waits
from agent.moves.model import MoveModel
from cosim.base.jit import inlined, kernel
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING, TIMEOUT


@inlined
def _nearest(before: np.ndarray, plans: np.ndarray) -> float:
    """Least distance in cells of two robots that went straight to where they are."""
    least = math.inf
    for i in range(len(before)):
        for j in range(i):
            x, y = before[i, 0] - before[j, 0], before[i, 1] - before[j, 1]
            along_x = plans[i, AT_X] - plans[j, AT_X] - x
            along_y = plans[i, AT_Y] - plans[j, AT_Y] - y
            length = along_x * along_x + along_y * along_y
            share = -(x * along_x + y * along_y) / length if length > 0.0 else 0.0
            share = min(max(share, 0.0), 1.0)
            least = min(least, math.hypot(x + share * along_x, y + share * along_y))
    return least


@kernel
def foresee(
    process: Process,
    model: MoveModel,
    values: np.ndarray,
    starts: np.ndarray,
    repeats: int,
    random: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate greedy episodes from some starts, on moves that are drawn again every time.

    Args:
        process: the decision process of the policy.
        model: of the moves, with the distance of contact.
        values: (N, states, 8) float32, action values; ties go to the least rotation of the axis.
        starts: (K, N, 2) int64 cells, out of contact.
        repeats: episodes from each.
        random: generator state, see `agent.mdp.rng`; advanced.

    Returns:
        (K,) float64, mean over the episodes of the smallest gap between two robots in cells, 0
        where one collides or leaves the board and inf for a robot alone; (K,) float64, mean time
        in s.
    """
    n = len(values)
    gaps, seconds = np.zeros(len(starts)), np.zeros(len(starts))
    world = np.zeros((n, COLUMN_COUNT), dtype=np.int64)
    plans = np.zeros((n, PLAN_SIZE))
    before = np.empty((n, 2))
    rewards = np.empty(n, dtype=np.float32)
    step_limit = process.step_limit * model.most_steps
    contact = math.sqrt(model.contact_cells)
    for k in range(len(starts)):
        for _ in range(repeats):
            place(process, world, starts[k])
            stand(model, world, plans, random)
            least, outcome, steps = math.inf, RUNNING, 0
            while outcome == RUNNING:
                for i in range(n):
                    before[i, 0], before[i, 1] = plans[i, AT_X], plans[i, AT_Y]
                    if world[i, STATUS] == MOVING and waits(plans, i):
                        asked = values[i, state_index(process, world, i)]
                        action = least_rotation_argmax(asked, world[i, AXIS])
                        begun = begin_move(process, model, world, plans, i, action, random)
                        outcome = max(outcome, begun)
                if outcome != RUNNING:
                    break
                outcome, passed = step(process, model, world, plans, rewards)
                least = min(least, _nearest(before, plans))
                steps += passed
                if outcome == RUNNING and steps >= step_limit:
                    outcome = TIMEOUT
            failed = outcome in (COLLISION, OUT_OF_BOARD)
            gaps[k] += 0.0 if failed else max(least - contact, 0.0) / repeats
            seconds[k] += steps * model.rl_step_s / repeats
    return gaps, seconds
