"""Gymnasium environments for one robot."""

from typing import Any

import gymnasium as gym
import numpy as np

from agent.envs.boards import known_options
from agent.envs.rendering import View
from agent.envs.vector import direction_boards
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError, shorten
from cosim.model.outcome import RUNNING
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario


class SingleEnv(View, gym.Env[np.ndarray, Any]):
    """One board with one robot.

    An episode that reaches a limit is truncated, every other end terminates it. `info` has
    `outcome` (a rank of `cosim.model.outcome`), `is_success`, `path_length` in cm, and `active`:
    whether the next action counts. What is random in an environment that was never seeded comes
    from entropy, which `np_random_seed` tells.
    """

    _boards_of: Any

    def __init__(
        self,
        scenario: str | Scenario = "1a",
        *arguments: Any,
        render_mode: str | None = None,
        outcome_names: bool = False,
        **options: Any,
    ) -> None:
        """Make an environment.

        Args:
            scenario: of one robot.
            arguments, options: of the boards, see the class.
            render_mode, outcome_names: as of `View`.

        Raises:
            UserError: the scenario or an option cannot be used, or it has more than one robot.
        """
        if (robots := find_scenario(scenario).robots) != 1:
            raise UserError(
                f"scenario {shorten(scenario)} has {robots} robots, not one; use agent.envs."
                "parallel_env, or gymnasium.make_vec with MiniRobots/Pair-v0 or CoSimPair-v0"
            )
        boards = self._boards_of(1, scenario, *arguments, **options)
        super().__init__(boards, render_mode, outcome_names)
        self.observation_space, self.action_space = boards.observation_space, boards.action_space
        boards.seed([self.np_random_seed])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"starts": [[x, y]]}` gives the start cell.

        In the dynamics `mu` and `targets` ([[x, y]]) of the episode can be given too.

        Raises:
            ConfigError: the start cannot be used.
        """
        super().reset(seed=seed)
        given = known_options(options, *self._boards.reset_options)
        self._boards.reset({name: [value] for name, value in given.items()}, seed)
        self.closed = False
        return self._seen(), self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take an action.

        Raises:
            ConfigError: the action is none of the action space, or the episode has ended.
            ConfigError: the environment is closed.
        """
        self._require_open()
        boards = self._boards
        joint = boards.joint([action])
        if boards.arrays.outcomes[0] != RUNNING:
            raise ConfigError("no episode is running; call reset before the next step")
        boards.step(joint)
        arrays = boards.arrays
        ends = bool(arrays.terminated[0, 0]), bool(arrays.truncated[0, 0])
        return self._seen(), float(arrays.rewards[0, 0]), *ends, self._info()

    def _seen(self) -> np.ndarray:
        return self._boards.arrays.observations[0, 0].copy()

    def _info(self) -> dict[str, Any]:
        infos = self._boards.infos(names=self._outcome_names)
        return {name: values.item(0) for name, values in infos.items()}


class NavigationEnv(SingleEnv):
    """One robot that learns to reach its target; options are `agent.envs.vector.direction_boards`'.

    Observations are the features of Section III as MultiDiscrete (a lone robot: column and row),
    actions the eight directions, rewards Eq. (8).
    """

    _boards_of = staticmethod(direction_boards)

    def action_masks(self) -> np.ndarray:
        """Return (8,) bool, which directions lead to a free cell."""
        self._require_open()
        return self._boards.action_masks()[0, 0].astype(bool)
