"""PettingZoo's parallel interface over many boards: arrays over boards instead of numbers.

env = agent.envs.parallel_vector_env("2", num_envs=1024)
observations, infos = env.reset(seed=0)
observations["robot_1"]  # (1024, 4)
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from agent.envs.boards import EnvBoards, board_seeds
from agent.envs.grid_episode import ActionError, direction_error
from agent.envs.parallel import agent_names, require_actions
from agent.envs.state import Restorable
from cosim.onboard.features import DIRECTION_COUNT


class ParallelVectorEnv(Restorable):
    """`num_envs` boards of `agent.envs.parallel_env`, with the same bits, stepped together.

    Every dictionary has an array over boards for each of `possible_agents`. A board begins again,
    for all its robots, in the step after its end (next-step autoreset); where `infos[agent]` says
    not `active`, the robot has ended or its board begins again, and the agent's next action is
    ignored. `agents` are those that are active on any board, and need actions.
    """

    _mutable = ("_boards",)
    metadata = {  # noqa: RUF012
        "name": "minirobots_vector_v0",
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, boards: EnvBoards, *, outcome_names: bool = False) -> None:
        self.num_envs = num_envs = boards.shape[0]
        self._outcome_names = outcome_names
        self.possible_agents = agent_names(boards.scenario)
        self._boards = boards
        boards.seed(board_seeds(np.random.SeedSequence().entropy, num_envs))
        self._observation_space = batch_space(boards.observation_space, num_envs)
        self._action_space = batch_space(boards.action_space, num_envs)

    @property
    def agents(self) -> list[str]:
        """Agents that are active on any board."""
        active = np.flatnonzero(self._boards.arrays.active.any(axis=0))
        return [self.possible_agents[i] for i in active]

    def observation_space(self, agent: str) -> spaces.Space:
        """Of (num_envs, features) observations, the same for all agents."""
        return self._observation_space

    def action_space(self, agent: str) -> spaces.Space:
        """Of (num_envs,) actions, the same for all agents."""
        return self._action_space

    def reset(
        self, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, np.ndarray]]]:
        """Begin episodes; arguments as of `agent.envs.vector.RobotsVectorEnv`.

        Raises:
            StartsError: start cells cannot be used.
        """
        self.closed = False
        self._boards.reset(options, board_seeds(seed, self.num_envs))
        return self._by_agent(self._boards.arrays.observations), self._infos()

    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, np.ndarray],
        dict[str, np.ndarray],
        dict[str, np.ndarray],
        dict[str, dict[str, np.ndarray]],
    ]:
        """Let every agent take its (num_envs,) actions, where it is active.

        Raises:
            ActionError: an agent has no actions, or some that are no directions; or an unknown
                agent has some.
            ClosedError: the environment is closed.
        """
        self._require_open()
        self._boards.step(self._joint(actions))
        arrays = self._boards.arrays
        observations, rewards, terminations, truncations = (
            self._by_agent(array)
            for array in (arrays.observations, arrays.rewards, arrays.terminated, arrays.truncated)
        )
        return observations, rewards, terminations, truncations, self._infos()

    def _joint(self, actions: Mapping[str, ArrayLike]) -> np.ndarray:
        """(boards, robots) int64; 0 where a robot is not active."""
        active = self._boards.arrays.active
        agents = self.agents
        require_actions(actions, agents, self.possible_agents)
        joint = np.zeros(active.shape, dtype=np.int64)
        for agent in agents:
            i, chosen = self.possible_agents.index(agent), np.asarray(actions[agent])
            if chosen.shape != (self.num_envs,) or chosen.dtype.kind not in "iu":
                raise ActionError(
                    f"actions of {agent} of shape {chosen.shape} and type {chosen.dtype}; give one "
                    f"whole number to each of the {self.num_envs} boards"
                )
            joint[:, i] = np.where(active[:, i], chosen, 0)
            wrong = np.flatnonzero((joint[:, i] < 0) | (joint[:, i] >= DIRECTION_COUNT))
            if len(wrong):
                raise direction_error(int(joint[wrong[0], i]), f" of {agent} on board {wrong[0]}")
        return joint

    def _by_agent(self, array: np.ndarray) -> dict[str, np.ndarray]:
        return {agent: array[:, i].copy() for i, agent in enumerate(self.possible_agents)}

    def _infos(self) -> dict[str, dict[str, np.ndarray]]:
        infos = self._boards.infos(names=self._outcome_names)
        shown = {name: self._by_agent(values) for name, values in infos.items()}
        return {
            agent: {name: values[agent] for name, values in shown.items()}
            for agent in self.possible_agents
        }

    def close(self) -> None:
        """Free the simulation; `reset` opens the environment again."""
        self._boards.close()
        self.closed = True
