"""PettingZoo environment for pairs of robots and more; made by `agent.envs.parallel_env`."""

from collections.abc import Collection
from typing import TYPE_CHECKING, Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from agent.envs.boards import GridEpisode, counted
from agent.envs.grid_episode import ActionError, direction_error, require_seed
from agent.envs.rendering import RENDER_MODES, picture, require_render_mode
from agent.envs.state import Restorable
from agent.mdp.grid import MOVING
from cosim.base.arguments import taken
from cosim.model.outcome import BY_RANK, RUNNING, SUCCESS
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT

if TYPE_CHECKING:
    from agent.envs.cosim_episode import CoSimEpisode

EnvEpisode: TypeAlias = "GridEpisode | CoSimEpisode"


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


def episode_info(episode: EnvEpisode, robot: int, *, names: bool) -> dict[str, Any]:
    """Return what environments say about an episode in addition to the observation.

    Args:
        episode: that continues or has ended.
        robot: whose info it is.
        names: whether `outcome_name` is there, the text of the code `outcome`.
    """
    info = {
        "outcome": int(episode.outcome),
        "is_success": episode.outcome == SUCCESS,
        "path_length": float(episode.path_length_cm()[robot]),
        "active": bool(episode.active[robot]),
    }
    return info | {"outcome_name": BY_RANK[episode.outcome]} if names else info


def render_episode(episode: EnvEpisode, mode: str | None) -> Any:
    """The board as text ("ansi"), pixels ("rgb_array"), or nothing but a warning."""
    if mode is None:
        gym.logger.warn("render() does nothing without a render_mode")
        return None
    return picture(mode, episode.scenario, episode.positions_m())


class NavigationParallelEnv(Restorable, ParallelEnv[str, np.ndarray, int]):
    """Robots that learn to reach their targets without touching each other.

    Agents `robot_1`, `robot_2`, … observe their features (Section III) as MultiDiscrete and choose
    one of eight directions; rewards are Eq. (8) and (11). A robot that arrives is terminated and
    stays where it is; a failure terminates the robots that failed and truncates those still on
    their move, whose next state therefore still has a value. What is random in an environment that
    was never seeded comes from entropy.
    """

    _mutable = ("episode", "agents", "_cycles")
    metadata = {  # noqa: RUF012
        "name": "minirobots_v0",
        "render_modes": RENDER_MODES,
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        episode: EnvEpisode,
        render_mode: str | None = None,
        *,
        outcome_names: bool = False,
        max_cycles: int | None = None,
        one_hot: bool = False,
    ) -> None:
        require_render_mode(render_mode)
        self._max_cycles = counted("max_cycles", max_cycles, int | None)
        self._outcome_names, self._cycles = outcome_names, 0
        self.episode = episode
        self.render_mode = render_mode
        self.possible_agents = agent_names(episode.scenario)
        self.agents = []
        self.state_space = spaces.MultiDiscrete([*episode.sizes] * len(self.possible_agents))
        self._features = spaces.MultiDiscrete(list(episode.sizes))
        self._one_hot = taken("one_hot", one_hot, bool)
        seen = spaces.flatten_space(self._features) if self._one_hot else self._features
        self.observation_spaces: dict[str, spaces.Space] = dict.fromkeys(self.possible_agents, seen)
        self.action_spaces: dict[str, spaces.Space] = {
            agent: spaces.Discrete(DIRECTION_COUNT) for agent in self.possible_agents
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
        if (seed := require_seed(seed)) is not None:
            self.episode.seed(seed)
        known = self.episode.reset_options
        self.episode.reset(**{k: v for k, v in (options or {}).items() if k in known})
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
        self.episode.step(self._joint(actions))
        self._cycles += 1
        ended = self.episode.outcome != RUNNING or self._cycles == self._max_cycles
        moving = self.episode.status == MOVING
        robots = {agent: self.possible_agents.index(agent) for agent in self.agents}
        rewards = {agent: float(self.episode.rewards[i]) for agent, i in robots.items()}
        terminations = {agent: not moving[i] for agent, i in robots.items()}
        truncations = {agent: bool(ended and moving[i]) for agent, i in robots.items()}
        observations, infos = self._observations(), self._infos()
        self.agents = [a for a, i in robots.items() if moving[i] and not ended]
        return observations, rewards, terminations, truncations, infos

    def _joint(self, actions: dict[str, int]) -> np.ndarray:
        """(N,) int64, action of each robot; 0 for those that have ended."""
        require_actions(actions, self.agents, self.possible_agents)
        joint = np.zeros(len(self.possible_agents), dtype=np.int64)
        for agent in self.agents:
            if not self.action_spaces[agent].contains(actions[agent]):
                raise direction_error(actions[agent], f" of {agent}")
            joint[self.possible_agents.index(agent)] = actions[agent]
        return joint

    def _observations(self) -> dict[str, np.ndarray]:
        rows = dict(zip(self.possible_agents, self.episode.observation(), strict=True))
        seen = {agent: rows[agent] for agent in self.agents}
        if not self._one_hot:
            return seen
        return {k: np.asarray(spaces.flatten(self._features, row)) for k, row in seen.items()}

    def _infos(self) -> dict[str, dict[str, Any]]:
        robots = {agent: self.possible_agents.index(agent) for agent in self.agents}
        return {
            agent: episode_info(self.episode, i, names=self._outcome_names)
            | {"action_mask": self.episode.action_mask(i)}
            for agent, i in robots.items()
        }

    def state(self) -> np.ndarray:
        """Return the global state, shape (robots · features,): the observations of all robots."""
        self._require_open()
        return self.episode.observation().reshape(-1)

    def render(self) -> Any:
        """The board as text or pixels."""
        self._require_open()
        return render_episode(self.episode, self.render_mode)

    def close(self) -> None:
        """Free the simulation; `reset` opens the environment again."""
        self.episode.close()
        self.closed, self.agents = True, []
