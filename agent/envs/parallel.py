"""PettingZoo environments for pairs of robots and more, one board or many.

`agent.envs.parallel_env` and `agent.envs.parallel_vector_env` make them.
"""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from pettingzoo import ParallelEnv

from agent.envs.boards import ActionError, Count, DirectionBoards, board_seeds
from agent.envs.rendering import View
from agent.envs.vector import direction_boards
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import numbers, taken
from cosim.base.errors import shown
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT

# Observations, rewards, terminations, truncations and infos, by agent.
AgentResults = tuple[
    dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any], dict[str, dict[str, Any]]
]


class AgentsView(View):
    """Robots of boards as agents by name: `robot_1`, `robot_2`, ….

    Args:
        boards, render_mode, outcome_names: as of `View`.
        observation_space, action_space: of an agent; of many boards an action is (boards,).
    """

    agents: Any

    def __init__(
        self,
        boards: DirectionBoards,
        render_mode: str | None,
        outcome_names: bool,
        observation_space: spaces.Space,
        action_space: spaces.Space,
    ) -> None:
        super().__init__(boards, render_mode, outcome_names)
        self._shape = action_space.shape or ()
        boards.seed(board_seeds(np.random.SeedSequence().entropy, boards.shape[0]))
        self.possible_agents = [f"robot_{k + 1}" for k in range(boards.shape[1])]
        self.observation_spaces: dict[str, spaces.Space] = dict.fromkeys(
            self.possible_agents, observation_space
        )
        self.action_spaces: dict[str, spaces.Space] = {
            agent: copy.copy(action_space) for agent in self.possible_agents
        }

    def observation_space(self, agent: str) -> spaces.Space:
        """Return the same object on every call, as PettingZoo requires."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Return the same object on every call, as PettingZoo requires."""
        return self.action_spaces[agent]

    def step(self, actions: Mapping[str, Any]) -> AgentResults:
        """Let every agent take its action; those of agents that have ended are ignored.

        Raises:
            ActionError: an agent has no action, or one that is no direction; or an unknown agent
                has one.
            ClosedError: the environment is closed.
        """
        self._require_open()
        self._boards.step(self._joint(actions))
        arrays = self._boards.arrays
        rewards, terminations, truncations = (
            self._by_agent(array) for array in (arrays.rewards, arrays.terminated, arrays.truncated)
        )
        return self._observations(), rewards, terminations, truncations, self._infos()

    def _joint(self, actions: Mapping[str, Any]) -> np.ndarray:
        """(K, N) int64; 0 where a robot is not active."""
        for agent in actions:
            if agent not in self.possible_agents:
                known = ", ".join(self.possible_agents)
                raise ActionError(f"{agent} is not an agent; choose from {known}")
        active = self._boards.arrays.active
        joint = np.zeros(active.shape, dtype=np.int64)
        for i, agent in enumerate(self.possible_agents):
            if agent not in self.agents:
                continue
            if agent not in actions:
                raise ActionError(f"{agent} has no action; give one to every agent of env.agents")
            chosen = numbers(actions[agent], self._shape, "iu")
            if chosen is None:
                each = f" for each of the {len(active)} boards" if self._shape else ""
                raise ActionError(
                    f"action {shown(actions[agent])} of {agent} is not a direction; choose a whole "
                    f"number from 0 to {DIRECTION_COUNT - 1}{each}"
                )
            joint[:, i] = chosen
        return self._boards.joint((joint * active).ravel())

    def _by_agent(self, array: np.ndarray) -> dict[str, Any]:
        """Return what each agent has of (K, N, …): (K, …); of one board what is still there."""
        if self._shape:
            return {agent: array[:, i].copy() for i, agent in enumerate(self.possible_agents)}
        row = array[0].tolist() if array.ndim == 2 else array[0].copy()
        rows = zip(self.possible_agents, row, strict=True)
        return {agent: one for agent, one in rows if agent in self.agents}

    def _observations(self) -> dict[str, Any]:
        return self._by_agent(self._boards.arrays.observations)

    def _infos(self) -> dict[str, dict[str, Any]]:
        infos = self._boards.infos(names=self._outcome_names)
        rows = {name: self._by_agent(values) for name, values in infos.items()}
        return {agent: {name: row[agent] for name, row in rows.items()} for agent in rows["active"]}


class NavigationParallelEnv(AgentsView, ParallelEnv[str, np.ndarray, int]):
    """Robots that learn to reach their targets without touching each other.

    Agents observe their features (Section III) as MultiDiscrete and choose
    one of eight directions; rewards are Eq. (8) and (11). A robot that arrives is terminated and
    stays where it is; a failure terminates the robots that failed and truncates those still on
    their move, so that their next state still has a value. What is random in an environment that
    was never seeded comes from entropy.
    """

    _mutable = ("_boards", "agents")
    metadata = View.metadata | {"name": "minirobots_v0", "is_parallelizable": True}

    def __init__(
        self,
        scenario: str | Scenario = "2",
        process: ProcessConfig | None = None,
        *,
        render_mode: str | None = None,
        outcome_names: bool = False,
        max_cycles: int | None = None,
        one_hot: bool = False,
        **options: Any,
    ) -> None:
        """Make an environment.

        Args:
            scenario, process, options: see `agent.envs.vector.direction_boards`; of several robots
                in the dynamics a step ends when any of them waits for an action, and `active`
                marks the robots that use theirs.
            render_mode, outcome_names: as of `View`.
            max_cycles: limit of steps, after which robots still on their move are truncated.
            one_hot: observe a Box with a 0 or 1 for each value of each feature.

        Raises:
            UserError: the scenario or an option cannot be used.
        """
        limit = taken("max_cycles", max_cycles, Count | None)
        boards = direction_boards(1, scenario, process, max_episode_steps=limit, **options)
        self.agents = []
        self._features = features = boards.observation_space
        assert isinstance(features, spaces.MultiDiscrete)
        self._one_hot = taken("one_hot", one_hot, bool)
        seen = spaces.flatten_space(features) if self._one_hot else features
        super().__init__(boards, render_mode, outcome_names, seen, boards.action_space)
        self.state_space = spaces.MultiDiscrete([*features.nvec] * len(self.possible_agents))

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin an episode; `options={"starts": [[x, y], …]}` gives the start cells.

        In the dynamics `mu` and `targets` (cells) of the episode can be given too.
        Other options are ignored, as `pettingzoo.test.parallel_api_test` asks.

        Raises:
            StartsError: start cells cannot be used.
        """
        known = self._boards.reset_options
        given = {name: [value] for name, value in (options or {}).items() if name in known}
        self._boards.reset(given, seed)
        self.closed = False
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(self, actions: Mapping[str, int]) -> AgentResults:
        """See `AgentsView.step`; nothing happens after the end of an episode."""
        self._require_open()
        if not self.agents:
            gym.logger.warn("step() does nothing after the end of an episode")
            return {}, {}, {}, {}, {}
        results = super().step(actions)
        _, _, terminations, truncations, _ = results
        self.agents = [a for a in self.agents if not (terminations[a] or truncations[a])]
        return results

    def _observations(self) -> dict[str, np.ndarray]:
        seen = super()._observations()
        if not self._one_hot:
            return seen
        return {k: np.asarray(spaces.flatten(self._features, row)) for k, row in seen.items()}

    def _infos(self) -> dict[str, dict[str, Any]]:
        infos, masks = super()._infos(), self._boards.action_masks()[0]
        for agent, mask in zip(self.possible_agents, masks, strict=True):
            if agent in infos:
                infos[agent]["action_mask"] = mask
        return infos

    def state(self) -> np.ndarray:
        """Return the global state, shape (robots · features,): the observations of all robots."""
        self._require_open()
        return self._boards.arrays.observations[0].flatten()

    def close(self, **_: Any) -> None:
        """See `View.close`."""
        super().close()
        self.agents = []


class ParallelVectorEnv(AgentsView):
    """`num_envs` boards of `agent.envs.parallel_env`, with the same bits, stepped together.

        env = agent.envs.parallel_vector_env("2", num_envs=1024)
        observations, infos = env.reset(seed=0)
        observations["robot_1"]  # (1024, 4)

    Every dictionary has an array over boards for each of `possible_agents`. A board begins again,
    for all its robots, in the step after its end (next-step autoreset); where `infos[agent]` says
    not `active`, the robot has ended or its board begins again, and the agent's next action is
    ignored. `agents` are those that are active on any board, and need actions.
    """

    metadata = {"name": "minirobots_vector_v0", "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Scenario = "2",
        process: ProcessConfig | None = None,
        *,
        num_envs: int = 1,
        outcome_names: bool = False,
    ) -> None:
        """Make `num_envs` boards; arguments as of `NavigationParallelEnv`."""
        boards = direction_boards(num_envs, scenario, process)
        self.num_envs = num_envs
        seen, chosen = (
            batch_space(space, num_envs)
            for space in (boards.observation_space, boards.action_space)
        )
        super().__init__(boards, None, outcome_names, seen, chosen)

    @property
    def agents(self) -> list[str]:
        """Agents that are active on any board."""
        active = np.flatnonzero(self._boards.arrays.active.any(axis=0))
        return [self.possible_agents[i] for i in active]

    def reset(
        self, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, np.ndarray]]]:
        """Begin episodes; arguments as of `agent.envs.vector.RobotsVectorEnv`.

        Raises:
            StartsError: start cells cannot be used.
        """
        self._boards.reset(options, seed)
        self.closed = False
        return self._observations(), self._infos()
