"""Rewards of moves made in the co-simulation: the process of the paper seen between cells.

A move of the co-simulation takes several RL steps, and each of them earns a reward, as in
`agent.moves.kernels`. The observations are those of `cosim.simulation.episode`, the numbers those
of `agent.mdp.interpretations`.
"""

import numpy as np

from agent.mdp.config import REWARDS_PER
from agent.mdp.interpretations import Process
from cosim.coupling.rl_step import Step
from cosim.model.outcome import RUNNING
from cosim.model.params import TIMING
from cosim.onboard.features import Observation


def failed(step: Step, arrived: np.ndarray) -> np.ndarray:
    """(N,) bool, robots that failed in an RL step: they touched something or left the board.

    A robot that had arrived before does not fail when touched; arguments as `step_reward`.
    """
    return (step.events != RUNNING) & ~(arrived & (step.action < 0))


def step_reward(process: Process, step: Step, arrived: np.ndarray) -> np.ndarray:
    """(N,) float64, rewards of robots that were driving in an RL step or failed, NaN of the others.

    By Eq. (8) and (11). `arrived`, (N,) bool, are those at their targets after the step.
    """
    return reward_parts(process, step, arrived).sum(axis=1)


def reward_parts(process: Process, step: Step, arrived: np.ndarray) -> np.ndarray:
    """Return rewards by parts, (N, 3) float64: goal or failure, step, nearness of another robot."""
    parts = np.full((len(step.action), 3), np.nan)
    goal = float(process.goal_reward)
    share = {
        "step": np.ones(len(parts)),
        "time": np.full(len(parts), step.duration_s / TIMING.rl_step_s),
        "distance": step.moved_m / process.cell_m,
    }[REWARDS_PER[process.reward_per]]
    for robot in np.flatnonzero(step.action >= 0):
        # Eq. (8)
        parts[robot] = (
            (goal, 0.0, 0.0)
            if arrived[robot]
            else share[robot] * _step_reward(process, step.after, int(robot))
        )
    parts[failed(step, arrived)] = (-goal, 0.0, 0.0)
    return parts


def _step_reward(process: Process, after: Observation, robot: int) -> np.ndarray:
    squared = ((after.cells - after.cells[robot]) ** 2).sum(axis=1)
    squared[robot] = np.iinfo(np.int64).max  # no robot is near itself
    limit = process.move_reward.shape[2] - 1
    approaching = int(after.gradient_sign[robot] < 0)
    # Eq. (11)
    of_step = process.move_reward[0, approaching]
    step = float(of_step[limit])  # nearness costs nothing at the limit
    return np.array([0.0, step, float(of_step[min(int(squared.min()), limit)]) - step])
