"""Rewards of moves made in the co-simulation: the process of the paper seen between cells.

A move of the co-simulation takes several RL steps; it earns its reward when it ends. The
observations are those of `cosim.episode`, the numbers those of `agent.process`.
"""

import numpy as np

from agent.process import Process
from cosim.episode import Step
from cosim.features import Observation


def step_reward(process: Process, step: Step, arrived: np.ndarray) -> np.ndarray:
    """Reward of each robot whose move ended within an RL step, NaN for the others.

    Args:
        process: tables of the decision process.
        step: an RL step of the co-simulation.
        arrived: (N,) bool, robots at their targets after the step.

    Returns:
        (N,) float64, Eq. (8) and (11).
    """
    reward = np.full(len(step.action), np.nan)
    goal = float(process.goal_reward)
    for robot in np.flatnonzero(step.completed):
        moved = _move_reward(process, step.after, int(step.action[robot]), int(robot))
        # Eq. (8)
        reward[robot] = goal if arrived[robot] else moved
    if step.outcome == "collision":
        reward[step.action >= 0] = -goal
    if step.outcome == "out_of_board":
        columns, rows = (size - 2 for size in process.terrain.shape[1:])
        x, y = step.after.cells.T
        reward[(x < 0) | (x >= columns) | (y < 0) | (y >= rows)] = -goal
    return reward


def _move_reward(process: Process, after: Observation, action: int, robot: int) -> float:
    squared = ((after.cells - after.cells[robot]) ** 2).sum(axis=1)
    squared[robot] = np.iinfo(np.int64).max  # no robot is near itself
    limit = process.move_reward.shape[2] - 1
    approaching = int(after.gradient_sign[robot] < 0)
    # Eq. (11)
    return float(process.move_reward[action % 2, approaching, min(int(squared.min()), limit)])
