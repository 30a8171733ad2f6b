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


def failed(step: Step, arrived: np.ndarray) -> np.ndarray:
    """(N,) bool, robots that failed in an RL step: they touched something or left the board.

    A robot that had arrived before does not fail when touched; arguments as `reward_parts`.
    """
    return (step.events != RUNNING) & ~(arrived & (step.action < 0))


def reward_parts(process: Process, step: Step, arrived: np.ndarray) -> np.ndarray:
    """Return rewards by parts, (N, 3) float64: goal or failure, step, nearness of another robot.

    Eq. (8) and (11) of each robot that was driving in an RL step or failed in it, NaN of the
    others; `arrived`, (N,) bool, has the robots at their targets after it.
    """
    after, goal = step.after, float(process.goal_reward)
    share = {
        "step": np.ones(len(step.action)),
        "time": np.full(len(step.action), step.duration_s / TIMING.rl_step_s),
        "distance": step.moved_m / process.cell_m,
    }[REWARDS_PER[process.reward_per]]
    squared = ((after.cells[:, None] - after.cells) ** 2).sum(axis=2)
    np.fill_diagonal(squared, np.iinfo(np.int64).max)  # no robot is near itself
    # Eq. (11) of each robot by squared distance; nearness costs nothing at the last one
    rewards = process.move_reward[0, (after.gradient_sign < 0).astype(int)].astype(float)
    nearest = squared.min(axis=1).clip(max=rewards.shape[1] - 1)
    near = rewards[np.arange(len(rewards)), nearest] - rewards[:, -1]
    parts = share[:, None] * np.column_stack([np.zeros(len(near)), rewards[:, -1], near])
    # Eq. (8)
    parts[step.action < 0] = np.nan
    parts[arrived & (step.action >= 0)] = (goal, 0.0, 0.0)
    parts[failed(step, arrived)] = (-goal, 0.0, 0.0)
    return parts
