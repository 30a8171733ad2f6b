"""PettingZoo environment for pairs of robots and more; `agent.envs.parallel_env` makes it."""

from collections.abc import Iterable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from agent.envs.boards import Count
from agent.envs.rendering import Rows, View
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
    """Robots that learn to reach their targets without touching each other, for PettingZoo.

    Agents are `robot_1`, `robot_2`, …. Each value is a dict by agent. What is random in an
    environment that was never seeded comes from entropy.

    - Observation: MultiDiscrete (F,) int64, the features of `process.features` (Section III)
      counted from 0; by default column, row, distance class (0 near, 1 medium, 2 large) and change
      of distance (0 closer, 1 same, 2 farther) of the nearest other robot; without the last two for
      a lone robot. `state()` is (N · F,), those of all robots.
    - Action: Discrete(8), direction k · 45° counter-clockwise from +x, of every agent of `agents`.
      In the dynamics a step lasts until any robot waits for its next action (`decision="arrival"`),
      or an RL step of 2 s (`decision="period"`); robots on their move ignore their action.
    - Reward, float, Eq. (8) and (11): 100 on arrival, -100 on failure, else -1 per move, in the
      dynamics per RL step that passed, and more for closing in on a robot within 10 cm.
    - Termination: the robot arrived, and stays where it is; or it left the board or touched
      something, which ends the episode of all.
    - Truncation: robots still on their move when another one failed, so that their next state has a
      value; or at a limit: `max_cycles`, on the grid also `process.step_limit` (1000 moves), in the
      dynamics also `time_limit` (600 s of simulated time).
    - Infos: `outcome` of the episode, int, 0 running, 1 timeout, 2 success, 3 collision, 4 out of
      the board; `is_success`, bool; `path_length`, float, cm since the start; `active`, bool,
      whether the next action counts; `action_mask`, (8,) int8, 1 where a direction leads to a free
      cell; with `outcome_names`, `outcome_name`, str.
    - Options of `reset`: `starts`, [[column, row], …]; in the dynamics also `targets`, likewise,
      and `mu`, friction coefficient of the floor, for this episode.

    Args: `max_cycles`, limit of steps; those of `agent.envs.vector.direction_boards` but for
        `count` and `max_episode_steps`, and of `View`.

    >>> env = NavigationParallelEnv("2")
    >>> observations, infos = env.reset(seed=0, options={"starts": [[15, 19], [5, 5]]})
    >>> observations
    {'robot_1': array([15, 19,  2,  1]), 'robot_2': array([5, 5, 2, 1])}
    >>> observations, rewards, *ends, infos = env.step({"robot_1": 6, "robot_2": 0})
    >>> rewards, env.agents
    ({'robot_1': 100.0, 'robot_2': -1.0}, ['robot_2'])
    """

    metadata = View.metadata | {"name": "minirobots_v0", "is_parallelizable": True}
    _boards_of = staticmethod(direction_boards)

    def __init__(
        self,
        scenario: str | Scenario = "2",
        process: ProcessConfig | None = None,
        *,
        max_cycles: int | None = None,
        **options: Any,
    ) -> None:
        limit = validate_argument("max_cycles", max_cycles, Count | None)
        super().__init__(1, scenario, process, max_episode_steps=limit, **options)
        boards, features = self._boards, self._boards.observation_space
        boards.seed(np.random.SeedSequence().entropy)
        self.agents = []
        self.possible_agents = [f"robot_{k + 1}" for k in range(boards.shape[1])]
        self.observation_spaces: dict[str, Any] = dict.fromkeys(self.possible_agents, features)
        self.action_spaces: dict[str, Any] = {
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
        """Begin an episode with options of the class; raises ConfigError where one is unusable.

        Other options are ignored, as `pettingzoo.test.parallel_api_test` asks.
        """
        names = self._boards.reset_options
        given = {name: [value] for name, value in (options or {}).items() if name in names}
        rows = self._begin(given, seed)
        self.agents = self._remaining()
        return self._by_agent(rows.observations), self._infos(rows)

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
        rows = self._step(self._checked(actions))
        observations, *flat, _ = rows
        rewards, terminated, truncated = (self._by_agent(values.tolist()) for values in flat)
        results = self._by_agent(observations), rewards, terminated, truncated, self._infos(rows)
        self.agents = self._remaining()
        return results

    def _checked(self, actions: Mapping[str, Any]) -> np.ndarray:
        """(N,) int64; 0 where a robot is not active."""
        for agent in actions:
            if agent not in self.possible_agents:
                agents = ", ".join(self.possible_agents)
                raise ConfigError(f"{agent} is not an agent; choose from {agents}")
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
        return joint * self._boards.arrays.active[0]

    def _remaining(self) -> list[str]:
        remaining = self._boards.remaining()[0]
        return [
            agent for agent, stays in zip(self.possible_agents, remaining, strict=True) if stays
        ]

    def _by_agent(self, rows: Iterable[Any]) -> dict[str, Any]:
        """Return what each agent that has not ended has of N rows."""
        pairs = zip(self.possible_agents, rows, strict=True)
        return {agent: row for agent, row in pairs if agent in self.agents}

    def _infos(self, rows: Rows) -> dict[str, dict[str, Any]]:
        infos = {name: values.tolist() for name, values in rows.infos.items()}
        infos["action_mask"] = self._boards.action_masks()[0]
        of_agents = zip(*infos.values(), strict=True)
        return self._by_agent(dict(zip(infos, row, strict=True)) for row in of_agents)

    def state(self) -> np.ndarray:
        """Return the global state, shape (robots · features,): the observations of all robots."""
        self._require_open()
        return self._boards.arrays.observations[0].flatten()

    def set_state(self, state: dict[str, Any]) -> None:
        """See `View.set_state`."""
        super().set_state(state)
        self.agents = self._remaining()

    def close(self, **_: Any) -> None:
        """See `View.close`."""
        super().close()
        self.agents = []
