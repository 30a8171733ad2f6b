"""Times environments of pairs on the grid: many boards in one compiled loop, and one in Python.

Both take the same random actions, in turn, by the processor time of their one thread. Steps of
agents that have ended, and those with which a board begins again, count for nothing.
"""

import time

import gymnasium as gym
import numpy as np

import agent.envs
from agent.envs.parallel import NavigationParallelEnv
from cosim.onboard.features import DIRECTION_COUNT

STEPS = 200  # of every board, in each repeat
PARALLEL_BOARDS = 20  # that PettingZoo's environment takes one after the other


def vector_steps_per_s(env: gym.vector.VectorEnv, actions: np.ndarray) -> float:
    """Agent steps per second with (steps, boards, 2) actions."""
    _, infos = env.reset(seed=0)
    flat = actions.reshape(len(actions), -1)
    agent_steps = 0
    began = time.thread_time()
    for joint in flat:
        agent_steps += np.count_nonzero(infos["active"])
        _, _, _, _, infos = env.step(joint)
    return agent_steps / (time.thread_time() - began)


def parallel_steps_per_s(env: NavigationParallelEnv, actions: np.ndarray) -> float:
    """The same, board by board."""
    agent_steps = 0
    began = time.thread_time()
    for board in range(actions.shape[1]):
        env.reset(seed=board)
        for joint in actions[:, board].tolist():
            if env.agents:
                agent_steps += len(env.agents)
                env.step(dict(zip(env.possible_agents, joint, strict=True)))
            else:
                env.reset()
    return agent_steps / (time.thread_time() - began)


def measure(scenario: str, boards: int, repeats: int) -> dict[str, float]:
    """All figures by name."""
    env = gym.make_vec("MiniRobots/Pair-v0", num_envs=boards, scenario=scenario)
    parallel = agent.envs.parallel_env(scenario)
    shape = (STEPS, boards, len(parallel.possible_agents))
    actions = np.random.default_rng(0).integers(DIRECTION_COUNT, size=shape)
    vector_steps_per_s(env, actions[:2])  # compile
    rates = np.array(
        [
            (
                vector_steps_per_s(env, actions),
                parallel_steps_per_s(parallel, actions[:, :PARALLEL_BOARDS]),
            )
            for _ in range(repeats)
        ]
    )
    best, best_parallel = rates.max(axis=0).tolist()
    return {
        "agent_steps_per_s": best,
        "parallel_agent_steps_per_s": best_parallel,
        "ratio_to_parallel_env": best / best_parallel,
    }


def show(found: dict[str, float]) -> None:
    """Print the figures."""
    for name, value in found.items():
        print(f"{name:32s} {value:16,.0f}")
