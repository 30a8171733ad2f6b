"""Bases of the environments, which step boards: one robot, and rows of robots; their pictures."""

from collections.abc import Sequence
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from agent.envs.boards import checked_options
from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.base.colours import rgb, robot_colour
from cosim.base.errors import UserError, shorten
from cosim.model.outcome import BY_RANK, SUCCESS
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario

Ends = Literal["together", "own"]
_NAMES = np.array(BY_RANK, dtype=object)
PIXELS_PER_CELL = 12
RenderMode = Literal["ansi", "rgb_array"]
_BOARD, _GRID, _ZONE, _OBSTACLE = 255, 238, 222, 90


# Observations, rewards, terminated and truncated as of `agent.envs.boards.Results`, and arrays of
# infos by name; by robots, those of a board one after the other: R = K · N rows.
Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class View:
    """Base of the environments: boards that are stepped, pictured, saved and closed.

    Args:
        count: boards.
        scenario, arguments, options: of the boards, see `_boards_of`.
        render_mode: "ansi", "rgb_array" or None.
        outcome_names: whether infos have `outcome_name`, the text of the code `outcome`.

    Attributes:
        closed: whether `close` has been called since the last `reset`.
    """

    metadata: Any = {"render_modes": [*get_args(RenderMode)], "render_fps": 10}  # noqa: RUF012
    closed: bool = False
    _boards_of: Any  # makes the boards

    def __init__(
        self,
        count: int,
        scenario: str | Scenario,
        *arguments: Any,
        render_mode: str | None = None,
        outcome_names: bool = False,
        **options: Any,
    ) -> None:
        self._outcome_names = validate_argument("outcome_names", outcome_names, bool)
        self.render_mode = validate_argument("render_mode", render_mode, RenderMode | None)
        self._boards = self._boards_of(count, scenario, *arguments, **options)

    def _begin(self, options: dict[str, Any] | None, seed: Any) -> Rows:
        """Begin episodes, see `EnvBoards.reset`."""
        self._boards.reset(options, seed)
        self.closed = False
        return self._rows()

    def _step(self, actions: Any) -> Rows:
        """Let K · N robots take their actions."""
        self._require_open()
        self._boards.step(self._boards.joint(actions))
        return self._rows()

    def _rows(self) -> Rows:
        arrays = self._boards.arrays
        ranks = np.repeat(arrays.outcomes, self._boards.shape[1])
        observations = arrays.observations.reshape(len(ranks), -1).copy()
        ends = arrays.terminated.flatten(), arrays.truncated.flatten()
        infos = {
            "outcome": ranks,
            "is_success": ranks == SUCCESS,
            "path_length": self._boards.path_length_cm().ravel(),
            "active": arrays.active.flatten(),
        }
        for name, values in self._boards.terms.items():
            infos[f"reward_{name.replace(' ', '_')}"] = values.flatten()
        if self._outcome_names:
            infos["outcome_name"] = _NAMES[ranks]
        return observations, arrays.rewards.flatten(), *ends, infos

    def render(self) -> Any:
        """Return the first board as text ("ansi") or pixels ("rgb_array")."""
        self._require_open()
        if self.render_mode is None:
            gym.logger.warn("render() does nothing without a render_mode")
            return None
        return picture(self.render_mode, *self._boards.scenes()[0])

    def close(self, **_: Any) -> None:
        """Free the simulation; `reset` opens the environment again."""
        self._boards.close()
        self.closed = True

    def get_state(self) -> dict[str, Any]:
        """Return a copy of everything that changes; it can be pickled."""
        self._require_open()
        return self._boards.get_state()

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state from `get_state` of this environment, or of an equal one."""
        self._require_open()
        self._boards.set_state(state)

    def _require_open(self) -> None:
        if self.closed:
            raise ConfigError("the environment is closed; call reset to use it again")


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
        observations, *_, infos = self._begin({name: [v] for name, v in given.items()}, seed)
        return observations[0], _info(infos)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Take an action.

        Raises:
            ConfigError: the action is none of the action space, the episode has ended, or the
                environment is closed.
        """
        self._require_open()
        if self._boards.arrays.over[0]:
            raise ConfigError("no episode is running; call reset before the next step")
        observations, *(reward, terminated, truncated), infos = self._step([action])
        ends = bool(terminated[0]), bool(truncated[0])
        return observations[0], float(reward[0]), *ends, _info(infos)


def _info(infos: dict[str, np.ndarray]) -> dict[str, Any]:
    return {name: values.item(0) for name, values in infos.items()}


class RowsVectorEnv(View, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Base of environments whose rows are the robots of boards, those of a board consecutive.

    A board begins again with the step after the end of its episode. Arguments as of `View`, and:

    Args:
        num_envs: boards.
        ends: "together", every row ends with its board, or "own", with its robot.

    Attributes:
        boards: number of boards.
        scenario: board, targets and start cells.
    """

    metadata = View.metadata | {"autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "1a",
        *arguments: Any,
        ends: Ends = "together",
        **options: Any,
    ) -> None:
        require_one_of("ends", ends, ("together", "own"))
        super().__init__(num_envs, scenario, *arguments, **options)
        boards, self._together = self._boards, ends == "together"
        self.scenario, (self.boards, self._robots) = boards.scenario, boards.shape
        self.num_envs = self.boards * self._robots
        self.single_observation_space = boards.observation_space
        self.single_action_space = boards.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        boards.seed(self.np_random_seed)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; one seed counts up over the boards, as entropy does without one.

        Raises:
            ConfigError: an option cannot be used, or "reset_mask" leaves out a board that has never
                begun; the environment is as it was.
        """
        observations, *_, infos = self._begin(options, seed)
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        return observations, _masked(infos)

    def step(self, actions: np.ndarray) -> Rows:
        """Step all boards; one whose episode has ended begins again instead.

        Raises:
            ConfigError: an action is none of the action space, or the environment is closed.
            FmuError: an FMU failed.
        """
        observations, rewards, terminated, truncated, infos = self._step(actions)
        if self._together:
            over = np.repeat(self._boards.arrays.over, self._robots)
            terminated = over & (terminated | ~truncated)
        return observations, rewards, terminated, truncated, _masked(infos)

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture for each row, that of its board with the targets of the episode."""
        self._require_open()
        if self.render_mode is None:
            return None
        pictures = [picture(self.render_mode, *scene) for scene in self._boards.scenes()]
        return tuple(one for one in pictures for _ in range(self._robots))


def _masked(infos: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return infos with the masks that Gymnasium has, which say that every row has them."""
    everywhere = np.ones(len(infos["outcome"]), dtype=bool)
    return infos | {f"_{name}": everywhere for name in infos}


def picture(mode: str, scenario: Scenario, positions_m: np.ndarray) -> str | np.ndarray:
    """Return the board as the text or the pixels of a render mode, with robots at (N, 2) m."""
    return (board_text if mode == "ansi" else board_pixels)(scenario, positions_m)


def board_text(scenario: Scenario, positions_m: np.ndarray) -> str:
    """Return the board, top row first: robots 1, 2, …; targets a, b, …; obstacles #; zone ':'."""
    cells = np.full((scenario.columns, scenario.rows), ".")
    left, bottom, right, top = scenario.zone
    cells[left : right + 1, bottom : top + 1] = ":"
    for x, y in scenario.obstacles:
        cells[x, y] = "#"
    for robot, (x, y) in enumerate(scenario.targets):
        cells[x, y] = chr(ord("a") + robot % 26)
    limits = (scenario.columns - 1, scenario.rows - 1)
    for robot, position in enumerate(positions_m):
        x, y = np.clip((position / scenario.cell_m).astype(int), 0, limits)
        cells[x, y] = str((robot + 1) % 10)
    return "\n".join("".join(row) for row in cells.T[::-1]) + "\n"


def board_pixels(scenario: Scenario, positions_m: np.ndarray) -> np.ndarray:
    """Return (rows · 12, columns · 12, 3) uint8: robots as discs, targets as squares."""
    scale = PIXELS_PER_CELL
    picture = np.full((scenario.columns * scale, scenario.rows * scale, 3), _BOARD, dtype=np.uint8)
    picture[::scale] = picture[:, ::scale] = _GRID
    left, bottom, right, top = scenario.zone
    picture[left * scale : (right + 1) * scale, bottom * scale : (top + 1) * scale] = _ZONE
    for x, y in scenario.obstacles:
        picture[x * scale : (x + 1) * scale, y * scale : (y + 1) * scale] = _OBSTACLE
    for robot, (x, y) in enumerate(scenario.targets):
        colour = np.array(rgb(robot_colour(robot)), np.uint8)
        picture[x * scale : (x + 1) * scale, y * scale : (y + 1) * scale] = colour
    centres = (np.indices(picture.shape[:2]) + 0.5) * scenario.cell_m / scale
    for robot, position in enumerate(positions_m):
        squared = ((centres - position[:, None, None]) ** 2).sum(axis=0)
        disc = squared <= (scenario.diameter_m / 2.0) ** 2
        colour = np.array(rgb(robot_colour(robot)), np.uint8)
        picture[disc] = picture[disc] // 2 + colour // 2
    return np.ascontiguousarray(picture.transpose(1, 0, 2)[::-1])
