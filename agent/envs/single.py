"""Gymnasium environments for one robot."""

from typing import Any

import gymnasium as gym
import numpy as np

from agent.envs.boards import checked_options
from agent.envs.rendering import Rows, View
from agent.envs.vector import direction_boards
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError, shorten
from cosim.model.outcome import RUNNING
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario


class SingleEnv(View, gym.Env[np.ndarray, Any]):
    """Base of environments with one board and one robot; arguments as of `View`.

    What is random in an environment that was never seeded comes from entropy, `np_random_seed`.
    """

    def __init__(self, scenario: str | Scenario = "1a", *arguments: Any, **options: Any) -> None:
        if (robots := find_scenario(scenario).robots) != 1:
            raise UserError(
                f"scenario {shorten(scenario)} has {robots} robots, not one; use agent.envs."
                "parallel_env, or gymnasium.make_vec with MiniRobots/Pair-v0 or CoSimPair-v0"
            )
        super().__init__(1, scenario, *arguments, **options)
        self.observation_space = self._boards.observation_space
        self.action_space = self._boards.action_space
        self._boards.seed(self.np_random_seed)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode with options of the class; raises ConfigError where one is unusable."""
        super().reset(seed=seed)
        given = checked_options(options, *self._boards.reset_options)
        rows = self._begin({name: [value] for name, value in given.items()}, seed)
        return rows.observations[0], _info(rows)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take an action.

        Raises:
            ConfigError: the action is none of the action space, or the episode has ended.
            ConfigError: the environment is closed.
        """
        self._require_open()
        if self._boards.arrays.outcomes[0] != RUNNING:
            raise ConfigError("no episode is running; call reset before the next step")
        rows = self._step([action])
        ends = bool(rows.terminated[0]), bool(rows.truncated[0])
        return rows.observations[0], float(rows.rewards[0]), *ends, _info(rows)


def _info(rows: Rows) -> dict[str, Any]:
    return {name: values.item(0) for name, values in rows.infos.items()}


class NavigationEnv(SingleEnv):
    """One robot that learns to reach its target cell, on the grid or in the dynamics.

    - Observation: MultiDiscrete (F,) int64, the features of `process.features` (Section III), each
      counted from 0; by default column and row of the robot's cell, [30, 30] on the paper's board.
      A robot that left the board seems to be at its edge.
    - Action: Discrete(8), the next move goes to the neighbour at k · 45° counter-clockwise from +x.
      In the dynamics a step lasts until the robot waits for its next action (`decision="arrival"`),
      or an RL step of 2 s (`decision="period"`), in which a robot on its move ignores the action.
    - Reward, Eq. (8): 100 on arrival, -100 on failure, else -1 per move, in the dynamics per RL
      step that passed. `process` can give other amounts.
    - Termination: the robot arrived, left the board or touched an obstacle.
    - Truncation: after `max_episode_steps`, on the grid also `process.step_limit` (1000 moves), in
      the dynamics also `time_limit` (600 s of simulated time).
    - Infos: `outcome`, int, 0 running, 1 timeout, 2 success, 3 collision, 4 out of the board;
      `is_success`, bool; `path_length`, float, cm since the start; `active`, bool, whether the next
      action counts; with `outcome_names`, `outcome_name`, str.
    - Options of `reset`: `starts`, [[column, row]]; in the dynamics also `targets`, likewise,
      and `mu`, friction coefficient of the floor, for this episode.

    Args: those of `agent.envs.vector.direction_boards` but for `count`, and of `View`.

    >>> env = NavigationEnv("1a")
    >>> env.reset(seed=0, options={"starts": [[15, 20]]})[0]
    array([15, 20])
    >>> env.step(6)[:4]
    (array([15, 19]), -1.0, False, False)
    >>> observation, reward, terminated, truncated, info = env.step(6)
    >>> reward, terminated, info["outcome"], info["path_length"]
    (100.0, True, 2, 2.0)
    """

    _boards_of = staticmethod(direction_boards)

    def action_masks(self) -> np.ndarray:
        """Return (8,) bool, which directions lead to a free cell."""
        self._require_open()
        return self._boards.action_masks()[0, 0].astype(bool)
