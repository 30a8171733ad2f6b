"""Gymnasium environments for one robot, and makers of environments for several."""

from collections.abc import Mapping
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from agent.envs.boards import GridEpisode
from agent.envs.grid_episode import ActionError, direction_error, known_options
from agent.envs.parallel import EnvEpisode, NavigationParallelEnv, episode_info, render_episode
from agent.envs.parallel_vector import ParallelVectorEnv
from agent.envs.rendering import RENDER_MODES, require_render_mode
from agent.envs.state import Restorable
from agent.envs.vector import found, interpreted, lone
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import ConfigError
from cosim.model.outcome import RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.onboard.features import DIRECTION_COUNT

Decision = Literal["arrival", "period"]


class NavigationEnv(Restorable, gym.Env[np.ndarray, np.int64]):
    """One robot that learns to reach its target.

    Observations are the features of Section III as MultiDiscrete (a lone robot: column and row),
    actions the eight directions, rewards Eq. (8). An episode that reaches the step limit is
    truncated, every other end terminates it. `info` has `outcome` (a rank of
    `cosim.model.outcome`), `is_success`, `path_length` in cm, and `active`: whether the next action
    counts. What is random in an environment that was never seeded comes from entropy, which
    `np_random_seed` tells.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 10}  # noqa: RUF012
    _mutable = ("episode",)

    def __init__(
        self,
        scenario: str | Scenario = "1a",
        process: ProcessConfig | None = None,
        *,
        cosim: bool = False,
        decision: Decision = "arrival",
        render_mode: str | None = None,
        outcome_names: bool = False,
        **physics: Any,
    ) -> None:
        """Make an environment.

        Args:
            scenario: name of a built-in scenario, a scenario file, or a scenario, of one robot.
            process: readings of the decision process.
            cosim: simulate motors and contacts instead of moving on the grid.
            decision: when a step of the co-simulation ends: on "arrival", when the robot waits for
                its next action, or after every "period" of 2 s, in which a robot under way ignores
                its action.
            render_mode: "ansi", "rgb_array" or None.
            outcome_names: whether infos have `outcome_name`, the text of the code `outcome`.
            physics: of the co-simulation, see `agent.envs.cosim_episode.set_up`.

        Raises:
            UserError: the scenario or an option cannot be used, or it has more than one robot.
        """
        require_render_mode(render_mode)
        self.episode = make_episode(
            scenario, process, physics, cosim=cosim, decision=decision, alone=True
        )
        self.observation_space = spaces.MultiDiscrete(list(self.episode.sizes))
        self.action_space = spaces.Discrete(DIRECTION_COUNT)
        self.render_mode = render_mode
        self._outcome_names = outcome_names
        self.episode.seed(self.np_random_seed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"starts": [[x, y]]}` gives the start cell.

        In the dynamics `mu` and `targets` ([[x, y]]) of the episode can be given too.

        Raises:
            StartsError: the start cell cannot be used.
        """
        super().reset(seed=seed)
        if seed is not None:
            self.episode.seed(seed)
        self.episode.reset(**known_options(options, *self.episode.reset_options))
        self.closed = False
        return self.episode.observation()[0], self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Move in a direction.

        Raises:
            ActionError: the action is no direction, or the episode has ended.
            ClosedError: the environment is closed.
        """
        self._require_open()
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
            self._info(),
        )

    def action_masks(self) -> np.ndarray:
        """Return (8,) bool, which directions lead to a free cell."""
        self._require_open()
        return self.episode.action_mask(0).astype(bool)

    def _info(self) -> dict[str, Any]:
        return episode_info(self.episode, 0, names=self._outcome_names)

    def render(self) -> Any:
        """The board as text or pixels."""
        self._require_open()
        return render_episode(self.episode, self.render_mode)

    def close(self) -> None:
        """Free the simulation; `reset` opens the environment again."""
        self.episode.close()
        self.closed = True


def cosim_env(scenario: str | Scenario = "1a", *arguments: Any, **options: Any) -> NavigationEnv:
    """A `NavigationEnv` in the co-simulation; arguments as of that."""
    return NavigationEnv(scenario, *arguments, cosim=True, **options)


def _row(sizes: tuple[int, ...], observations: np.ndarray) -> np.ndarray:
    rows = np.ravel_multi_index(tuple(np.moveaxis(observations, -1, 0)), sizes)
    return np.asarray(rows, dtype=np.int64)


class FlattenState(gym.ObservationWrapper, RecordConstructorArgs):
    """One integer for a MultiDiscrete observation: the row of a Q table, as the kernels count."""

    def __init__(self, env: gym.Env) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        assert isinstance(env.observation_space, spaces.MultiDiscrete)
        self._sizes = tuple(env.observation_space.nvec)
        self.observation_space = spaces.Discrete(int(np.prod(self._sizes)))

    def observation(self, observation: np.ndarray) -> np.int64:
        """Row of the table."""
        return np.int64(_row(self._sizes, observation))


class FlattenStateVector(gym.vector.VectorObservationWrapper):
    """`FlattenState` of vector environments: (num_envs,) int64."""

    def __init__(self, env: gym.vector.VectorEnv) -> None:
        super().__init__(env)
        assert isinstance(env.single_observation_space, spaces.MultiDiscrete)
        self._sizes = tuple(env.single_observation_space.nvec)
        self.single_observation_space = spaces.Discrete(int(np.prod(self._sizes)))
        self.observation_space = gym.vector.utils.batch_space(
            self.single_observation_space, env.num_envs
        )

    def observations(self, observations: np.ndarray) -> np.ndarray:
        """Rows of the table."""
        return _row(self._sizes, observations)


def parallel_env(
    scenario: str | Scenario = "2",
    process: ProcessConfig | None = None,
    *,
    cosim: bool = False,
    decision: Decision = "arrival",
    render_mode: str | None = None,
    outcome_names: bool = False,
    max_cycles: int | None = None,
    one_hot: bool = False,
    **physics: Any,
) -> NavigationParallelEnv:
    """PettingZoo environment of any scenario.

    Args:
        scenario, process, cosim, decision, render_mode, outcome_names, physics: as of
            `NavigationEnv`; of several robots a step ends when any of them waits for an action, and
            `active` says whose counts.
        max_cycles: limit of steps, after which robots still on their move are truncated.
        one_hot: observe a Box with a 0 or 1 for each value of each feature.
    """
    episode = make_episode(scenario, process, physics, cosim=cosim, decision=decision)
    return NavigationParallelEnv(
        episode,
        render_mode,
        outcome_names=outcome_names,
        max_cycles=max_cycles,
        one_hot=one_hot,
    )


def parallel_vector_env(
    scenario: str | Scenario = "2",
    process: ProcessConfig | None = None,
    *,
    num_envs: int = 1,
    outcome_names: bool = False,
) -> ParallelVectorEnv:
    """Boards of `parallel_env` on the grid, `num_envs` of them stepped together."""
    process = interpreted(process)
    return ParallelVectorEnv(num_envs, found(scenario), process, outcome_names=outcome_names)


def make_episode(
    scenario: str | Scenario,
    process: ProcessConfig | None,
    physics: Mapping[str, Any],
    *,
    cosim: bool,
    decision: Decision,
    alone: bool = False,
) -> EnvEpisode:
    """The world of an environment: on the grid, or the full co-simulation.

    Args:
        scenario, process, physics, cosim, decision: as of `NavigationEnv`.
        alone: whether the scenario must have one robot.

    Raises:
        UserError: the scenario or an option cannot be used.
    """
    only, process = lone if alone else found, interpreted(process)
    if cosim:
        # here, because the grid needs no FMUs
        from agent.envs.cosim_episode import CoSimEpisode, set_up  # noqa: PLC0415

        only(found(scenario))  # before the robots are calibrated
        return CoSimEpisode(set_up(scenario, physics), process, decision)
    for name in physics:
        raise ConfigError(f"{name} has no effect on the grid; leave it out, or give cosim=True")
    return GridEpisode(only(found(scenario)), process)
