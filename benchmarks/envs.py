"""Times environments: pairs on the grid, many boards and one, and robots in the dynamics.

All take random actions, on the grid the same ones in turn, by the processor time of their one
thread. Steps of agents that have ended, and those with which a board begins again, are not counted.
"""

# pyright: reportMissingImports=false

import time
from dataclasses import dataclass
from functools import partial

import gymnasium as gym
import numpy as np

import agent.envs
from agent.envs.navigation import NavigationParallelEnv
from cosim.base.command import Checked, Count
from cosim.model.outcome import RUNNING
from cosim.onboard.features import DIRECTION_COUNT

STEPS = 200  # of every board, in each repeat
PARALLEL_BOARDS = 20  # that PettingZoo's environment takes one after the other
DYNAMICS_S = 10.0  # simulated time of each robot in the dynamics
# Environment, boards and simulated time of a step in s.
DYNAMICS = {
    **{f"drive_{n}": ("MiniRobots/Drive-v0", n, 0.1) for n in (1, 16, 64)},
    **{f"cosim_{n}": ("MiniRobots/CoSim-v0", n, 2.0) for n in (1, 16, 64)},
    "cosim_8_pairs": ("MiniRobots/CoSimPair-v0", 8, 2.0),
}


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    scenario: str = "2"
    """Scenario, of any number of robots."""
    boards: Count = 4096
    """Boards that are stepped together."""
    repeats: Count = 10
    """Rounds of both, in turn; the best of each counts."""
    vmas: bool = False
    """Also time navigation of VMAS with two agents (`uv run --with vmas`), which moves discs
    by forces with drag, in steps of 0.1 s."""


def vector_steps_per_s(env: gym.vector.VectorEnv, actions: np.ndarray) -> float:
    """Agent steps per second with (steps, boards, 2) actions."""
    _, infos = env.reset(seed=0)
    flat = actions.reshape(len(actions), -1)
    agent_steps = 0
    began = time.thread_time()
    for joint in flat:
        agent_steps += np.count_nonzero(infos["active"])
        _, _, _, _, infos = env.step(joint)
    return float(agent_steps / (time.thread_time() - began))


def parallel_steps_per_s(env: NavigationParallelEnv, actions: np.ndarray) -> float:
    """Return the steps per second, board by board."""
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


def robot_seconds_per_s(name: str, boards: int, step_s: float) -> float:
    """Return simulated seconds of all robots per second of an environment in the dynamics."""
    env = gym.make_vec(name, num_envs=boards)
    env.action_space.seed(0)
    env.reset(seed=0)
    env.step(env.action_space.sample())  # compile
    _, infos = env.reset(seed=0)
    robot_s, began = 0.0, time.thread_time()
    for _ in range(round(DYNAMICS_S / step_s)):
        robot_s += step_s * np.count_nonzero(infos["outcome"] == RUNNING)
        _, _, _, _, infos = env.step(env.action_space.sample())
    rate = float(robot_s / (time.thread_time() - began))
    env.close()
    return rate


def vmas_robot_seconds_per_s(boards: int) -> float:
    """Return the same of navigation in VMAS, on one thread of torch."""
    import torch  # noqa: PLC0415 - of --vmas
    import vmas  # noqa: PLC0415

    torch.set_num_threads(1)
    env = vmas.make_env("navigation", boards, "cpu", n_agents=2, seed=0)
    steps = round(DYNAMICS_S / env.world.dt)
    began = time.thread_time()
    for _ in range(steps):
        env.step([env.get_random_action(agent) for agent in env.agents])
    return boards * 2 * steps * env.world.dt / (time.thread_time() - began)


def measure(options: Options) -> dict[str, float]:
    scenario, boards = options.scenario, options.boards
    env = gym.make_vec("MiniRobots/Pair-v0", num_envs=boards, scenario=scenario)
    parallel = agent.envs.parallel_env(scenario)
    shape = (STEPS, boards, len(parallel.possible_agents))
    actions = np.random.default_rng(0).integers(DIRECTION_COUNT, size=shape)
    vector_steps_per_s(env, actions[:2])  # compile
    rates = [
        (
            vector_steps_per_s(env, actions),
            parallel_steps_per_s(parallel, actions[:, :PARALLEL_BOARDS]),
        )
        for _ in range(options.repeats)
    ]
    best, best_parallel = map(max, zip(*rates, strict=True))
    found = {
        "agent_steps_per_s": best,
        "parallel_agent_steps_per_s": best_parallel,
        "ratio_to_parallel_env": best / best_parallel,
    }
    others = {label: partial(robot_seconds_per_s, *what) for label, what in DYNAMICS.items()}
    if options.vmas:
        others |= {f"vmas_{n}": partial(vmas_robot_seconds_per_s, n) for n in (1, 16, 64)}
    repeats = range(min(options.repeats, 3))
    return found | {
        f"{label}_robot_s_per_s": max(rate() for _ in repeats) for label, rate in others.items()
    }
