"""PettingZoo environment for pairs of robots and more; made by `agent.envs.parallel_env`."""

import copy
from collections.abc import Collection
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from agent.envs.boards import Count, DirectionBoards
from agent.envs.grid_episode import ActionError, direction_error, require_seed
from agent.envs.rendering import RENDER_MODES, render_first, require_render_mode
from agent.envs.state import Restorable
from cosim.base.arguments import taken
from cosim.model.scenario import Scenario


def agent_names(scenario: Scenario) -> list[str]:
    """Names of the robots, `robot_1` first."""
    return [f"robot_{k + 1}" for k in range(scenario.robots)]


def require_actions(actions: Collection[str], active: list[str], possible: list[str]) -> None:
    """Refuse actions of unknown agents, and no action of an active one.

    Raises:
        ActionError: names the agent.
    """
    for agent in actions:
        if agent not in possible:
            raise ActionError(f"{agent} is no agent; choose from {', '.join(possible)}")
    for agent in active:
        if agent not in actions:
            raise ActionError(f"{agent} has no action; give one to every agent of env.agents")


class NavigationParallelEnv(Restorable, ParallelEnv[str, np.ndarray, int]):
    """Robots that learn to reach their targets without touching each other.

    Agents `robot_1`, `robot_2`, … observe their features (Section III) as MultiDiscrete and choose
    one of eight directions; rewards are Eq. (8) and (11). A robot that arrives is terminated and
    stays where it is; a failure terminates the robots that failed and truncates those still on
    their move, whose next state therefore still has a value. What is random in an environment that
    was never seeded comes from entropy.
    """

    _mutable = ("_boards", "agents", "_cycles")
    metadata = {  # noqa: RUF012
        "name": "minirobots_v0",
        "render_modes": RENDER_MODES,
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        boards: DirectionBoards,
        render_mode: str | None = None,
        *,
        outcome_names: bool = False,
        max_cycles: int | None = None,
        one_hot: bool = False,
    ) -> None:
        require_render_mode(render_mode)
        self._max_cycles = taken("max_cycles", max_cycles, Count | None)
        self._outcome_names, self._cycles = outcome_names, 0
        self._boards = boards
        boards.seed([np.random.SeedSequence().entropy])
        self.render_mode = render_mode
        self.possible_agents = agent_names(boards.scenario)
        self.agents = []
        self._features = features = boards.observation_space
        assert isinstance(features, spaces.MultiDiscrete)
        self.state_space = spaces.MultiDiscrete([*features.nvec] * len(self.possible_agents))
        self._one_hot = taken("one_hot", one_hot, bool)
        seen = spaces.flatten_space(features) if self._one_hot else features
        self.observation_spaces: dict[str, spaces.Space] = dict.fromkeys(self.possible_agents, seen)
        self.action_spaces: dict[str, spaces.Space] = {
            agent: copy.copy(boards.action_space) for agent in self.possible_agents
        }

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
            StartsError: start cells cannot be used.
        """
        known = self._boards.reset_options
        given = {name: [value] for name, value in (options or {}).items() if name in known}
        self._boards.reset(given, [require_seed(seed)])
        self.closed, self._cycles = False, 0
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(
        self, actions: dict[str, int]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Let every agent take its action; those of agents that have ended are ignored.

        Raises:
            ActionError: an agent has no action, or one that is no direction; or an unknown agent
                has one.
            ClosedError: the environment is closed.
        """
        self._require_open()
        if not self.agents:
            gym.logger.warn("step() does nothing after the end of an episode")
            return {}, {}, {}, {}, {}
        self._boards.step(self._joint(actions)[None])
        self._cycles += 1
        arrays, late = self._boards.arrays, self._cycles == self._max_cycles
        robots = self._robots()
        rewards = {agent: float(arrays.rewards[0, i]) for agent, i in robots.items()}
        terminations = {agent: bool(arrays.terminated[0, i]) for agent, i in robots.items()}
        truncations = {
            agent: bool(arrays.truncated[0, i]) or (late and not terminations[agent])
            for agent, i in robots.items()
        }
        observations, infos = self._observations(), self._infos()
        self.agents = [a for a in robots if not (terminations[a] or truncations[a])]
        return observations, rewards, terminations, truncations, infos

    def _joint(self, actions: dict[str, int]) -> np.ndarray:
        """(N,) int64, action of each robot; 0 for those that have ended."""
        require_actions(actions, self.agents, self.possible_agents)
        joint = np.zeros(len(self.possible_agents), dtype=np.int64)
        for agent, i in self._robots().items():
            if not self.action_spaces[agent].contains(actions[agent]):
                raise direction_error(actions[agent], f" of {agent}")
            joint[i] = actions[agent]
        return joint

    def _robots(self) -> dict[str, int]:
        return {agent: self.possible_agents.index(agent) for agent in self.agents}

    def _observations(self) -> dict[str, np.ndarray]:
        rows = self._boards.arrays.observations[0].copy()
        seen = {agent: rows[i] for agent, i in self._robots().items()}
        if not self._one_hot:
            return seen
        return {k: np.asarray(spaces.flatten(self._features, row)) for k, row in seen.items()}

    def _infos(self) -> dict[str, dict[str, Any]]:
        infos = self._boards.infos(names=self._outcome_names)
        masks = self._boards.action_masks()[0]
        return {
            agent: {name: values.item(0, i) for name, values in infos.items()}
            | {"action_mask": masks[i]}
            for agent, i in self._robots().items()
        }

    def state(self) -> np.ndarray:
        """Return the global state, shape (robots · features,): the observations of all robots."""
        self._require_open()
        return self._boards.arrays.observations[0].flatten()

    def render(self) -> Any:
        """The board as text or pixels."""
        self._require_open()
        return render_first(self._boards, self.render_mode)

    def close(self) -> None:
        """Free the simulation; `reset` opens the environment again."""
        self._boards.close()
        self.closed, self.agents = True, []
