"""Gymnasium environments for one robot, on the process of the grid."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from agent.envs.grid_episode import (
    ActionError,
    EnvEpisode,
    GridEpisode,
    direction_error,
    known_options,
)
from agent.envs.parallel import NavigationParallelEnv, episode_info, render_episode
from agent.envs.parallel_vector import ParallelVectorEnv
from agent.envs.rendering import RENDER_MODES, require_render_mode
from agent.envs.vector import found
from agent.process.config import ProcessConfig
from cosim.base.errors import UserError
from cosim.base.outcome import RUNNING, TIMEOUT
from cosim.navigation.features import DIRECTION_COUNT
from cosim.scenarios.scenario import Scenario


class NavigationEnv(gym.Env[np.ndarray, np.int64]):
    """One robot that learns to reach its target.

    Observations are the features of Section III as MultiDiscrete (a lone robot: column and row),
    actions the eight directions, rewards Eq. (8). An episode that reaches the step limit is
    truncated, every other end terminates it. `info` has `outcome` (a name of
    `cosim.base.outcome.Outcome`), `is_success` and `path_length` in cm. What is random in an
    environment that was never seeded comes from entropy, which `np_random_seed` tells.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Scenario = "1a",
        process: ProcessConfig | None = None,
        *,
        cosim: bool = False,
        render_mode: str | None = None,
    ) -> None:
        """Make an environment.

        Args:
            scenario: name of a built-in scenario, a scenario file, or a scenario, of one robot.
            process: readings of the decision process.
            cosim: simulate motors and contacts instead of moving on the grid; a step is 2 s.
            render_mode: "ansi", "rgb_array" or None.

        Raises:
            UserError: the scenario cannot be used, or has more than one robot.
        """
        require_render_mode(render_mode)
        self.episode = make_episode(scenario, process, cosim=cosim)
        if self.episode.scenario.robots != 1:
            raise UserError(
                f"scenario {self.episode.scenario.name} has {self.episode.scenario.robots} "
                "robots; use agent.envs.parallel_env"
            )
        self.observation_space = spaces.MultiDiscrete(list(self.episode.sizes))
        self.action_space = spaces.Discrete(DIRECTION_COUNT)
        self.render_mode = render_mode
        self.episode.seed(self.np_random_seed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"starts": [[x, y]]}` gives the start cell.

        Raises:
            StartsError: the start cell cannot be used.
        """
        super().reset(seed=seed)
        if seed is not None:
            self.episode.seed(seed)
        self.episode.reset(known_options(options, "starts").get("starts"))
        return self.episode.observation()[0], episode_info(self.episode, 0)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Move in a direction.

        Raises:
            ActionError: the action is no direction, or the episode has ended.
        """
        if not self.action_space.contains(action):
            raise direction_error(action)
        if self.episode.outcome != RUNNING:
            raise ActionError("no episode is running; call reset before the next step")
        self.episode.step(np.array([action]))
        ended = self.episode.outcome != RUNNING
        truncated = self.episode.outcome == TIMEOUT
        return (
            self.episode.observation()[0],
            float(self.episode.rewards[0]),
            ended and not truncated,
            truncated,
            episode_info(self.episode, 0),
        )

    def render(self) -> Any:
        """The board as text or pixels."""
        return render_episode(self.episode, self.render_mode)

    def close(self) -> None:
        """Free the simulation."""
        self.episode.close()


def cosim_env(
    scenario: str | Scenario = "1a",
    process: ProcessConfig | None = None,
    *,
    render_mode: str | None = None,
) -> NavigationEnv:
    """A `NavigationEnv` in the co-simulation; arguments as of that."""
    return NavigationEnv(scenario, process, cosim=True, render_mode=render_mode)


class FlattenState(gym.ObservationWrapper):
    """One integer for a MultiDiscrete observation: the row of a Q table, as the kernels count."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        assert isinstance(env.observation_space, spaces.MultiDiscrete)
        self._sizes = tuple(env.observation_space.nvec)
        self.observation_space = spaces.Discrete(int(np.prod(self._sizes)))

    def observation(self, observation: np.ndarray) -> np.int64:
        """Row of the table."""
        return np.int64(np.ravel_multi_index(tuple(observation), self._sizes))


def parallel_env(
    scenario: str | Scenario = "2",
    process: ProcessConfig | None = None,
    *,
    cosim: bool = False,
    render_mode: str | None = None,
) -> NavigationParallelEnv:
    """PettingZoo environment of any scenario; arguments as those of `NavigationEnv`."""
    episode = make_episode(scenario, process, cosim=cosim)
    return NavigationParallelEnv(episode, render_mode=render_mode)


def parallel_vector_env(
    scenario: str | Scenario = "2", process: ProcessConfig | None = None, *, num_envs: int = 1
) -> ParallelVectorEnv:
    """Boards of `parallel_env` on the grid, `num_envs` of them stepped together."""
    return ParallelVectorEnv(num_envs, found(scenario), process or ProcessConfig())


def make_episode(
    scenario: str | Scenario, process: ProcessConfig | None, *, cosim: bool
) -> EnvEpisode:
    """The world of an environment: on the grid, or the full co-simulation."""
    scenario = found(scenario, cosim=cosim)
    if cosim:
        from agent.envs.cosim_episode import CoSimEpisode  # noqa: PLC0415 - loads FMUs, not needed else

        return CoSimEpisode(scenario, process)
    return GridEpisode(scenario, process)
