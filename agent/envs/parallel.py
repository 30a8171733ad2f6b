"""PettingZoo environment for pairs of robots and more; `agent.envs.parallel_env` makes it."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from agent.envs.boards import Count, board_seeds
from agent.envs.rendering import View
from agent.envs.vector import direction_boards
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import ConfigError, numbers, validate_argument
from cosim.base.errors import shorten
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT

# Observations, rewards, terminations, truncations and infos, by agent.
AgentResults = tuple[
    dict[str, np.ndarray],
    dict[str, float],
    dict[str, bool],
    dict[str, bool],
    dict[str, dict[str, Any]],
]


class NavigationParallelEnv(View, ParallelEnv[str, np.ndarray, int]):
    """Robots that learn to reach their targets without touching each other.

    Agents are `robot_1`, `robot_2`, …. They observe their features (Section III) as MultiDiscrete
    and choose one of eight directions; rewards are Eq. (8) and (11). A robot that arrives is
    terminated and stays where it is; a failure terminates the robots that failed and truncates
    those still on their move, so that their next state still has a value. What is random in an
    environment that was never seeded comes from entropy.
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
        **options: Any,
    ) -> None:
        """Make an environment.

        Args:
            scenario, process, options: see `agent.envs.vector.direction_boards`; of several robots
                in the dynamics a step ends when any of them waits for an action, and `active`
                marks the robots that use theirs.
            render_mode, outcome_names: as of `View`.
            max_cycles: limit of steps, after which robots still on their move are truncated.

        Raises:
            UserError: the scenario or an option cannot be used.
        """
        limit = validate_argument("max_cycles", max_cycles, Count | None)
        boards = direction_boards(1, scenario, process, max_episode_steps=limit, **options)
        super().__init__(boards, render_mode, outcome_names)
        boards.seed(board_seeds(np.random.SeedSequence().entropy, 1))
        self.agents = []
        self.possible_agents = [f"robot_{k + 1}" for k in range(boards.shape[1])]
        features = boards.observation_space
        assert isinstance(features, spaces.MultiDiscrete)
        self.observation_spaces: dict[str, spaces.Space] = dict.fromkeys(
            self.possible_agents, features
        )
        self.action_spaces: dict[str, spaces.Space] = {
            agent: spaces.Discrete(DIRECTION_COUNT) for agent in self.possible_agents
        }
        self.state_space = spaces.MultiDiscrete([*features.nvec] * len(self.possible_agents))

    def observation_space(self, agent: str) -> spaces.Space:
        """Return the same object on every call, as PettingZoo requires."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Return the same object on every call, as PettingZoo requires."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin an episode; `options={"starts": [[x, y], …]}` gives the start cells.

        In the dynamics `mu` and `targets` (cells) of the episode can be given too.
        Other options are ignored, as `pettingzoo.test.parallel_api_test` asks.

        Raises:
            ConfigError: start cells cannot be used.
        """
        known = self._boards.reset_options
        given = {name: [value] for name, value in (options or {}).items() if name in known}
        self._boards.reset(given, seed)
        self.closed = False
        self.agents = list(self.possible_agents)
        return self._by_agent(self._boards.arrays.observations[0].copy()), self._infos()

    def step(self, actions: Mapping[str, int]) -> AgentResults:
        """Let every agent take its action; nothing happens after the end of an episode.

        Raises:
            ConfigError: an agent has no action, or one that is no direction; or an unknown agent
                has one.
            ConfigError: the environment is closed.
        """
        self._require_open()
        if not self.agents:
            gym.logger.warn("step() does nothing after the end of an episode")
            return {}, {}, {}, {}, {}
        self._boards.step(self._joint(actions))
        arrays = self._boards.arrays
        seen = self._by_agent(arrays.observations[0].copy())
        rewards, terminations, truncations = (
            self._by_agent(rows[0].tolist())
            for rows in (arrays.rewards, arrays.terminated, arrays.truncated)
        )
        results = seen, rewards, terminations, truncations, self._infos()
        self.agents = [a for a in self.agents if not (terminations[a] or truncations[a])]
        return results

    def _joint(self, actions: Mapping[str, Any]) -> np.ndarray:
        """(1, N) int64; 0 where a robot is not active."""
        for agent in actions:
            if agent not in self.possible_agents:
                known = ", ".join(self.possible_agents)
                raise ConfigError(f"{agent} is not an agent; choose from {known}")
        joint = np.zeros(len(self.possible_agents), dtype=np.int64)
        for agent in self.agents:
            if agent not in actions:
                raise ConfigError(f"{agent} has no action; give one to every agent of env.agents")
            chosen = numbers(actions[agent], (), "iu")
            if chosen is None:
                raise ConfigError(
                    f"action {shorten(actions[agent])} of {agent} is not a direction; choose a "
                    f"whole number from 0 to {DIRECTION_COUNT - 1}"
                )
            joint[self.possible_agents.index(agent)] = chosen
        return self._boards.joint(joint * self._boards.arrays.active[0])

    def _by_agent(self, rows: Any) -> dict[str, Any]:
        """Return what each agent that is still there has of N rows."""
        found = zip(self.possible_agents, rows, strict=True)
        return {agent: row for agent, row in found if agent in self.agents}

    def _infos(self) -> dict[str, dict[str, Any]]:
        infos = self._boards.infos(names=self._outcome_names)
        rows = {name: values[0].tolist() for name, values in infos.items()}
        rows["action_mask"] = self._boards.action_masks()[0]
        of_agents = zip(*rows.values(), strict=True)
        return self._by_agent(dict(zip(rows, row, strict=True)) for row in of_agents)

    def state(self) -> np.ndarray:
        """Return the global state, shape (robots · features,): the observations of all robots."""
        self._require_open()
        return self._boards.arrays.observations[0].flatten()

    def close(self, **_: Any) -> None:
        """See `View.close`."""
        super().close()
        self.agents = []
