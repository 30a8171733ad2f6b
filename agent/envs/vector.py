"""Many robots stepped by one compiled loop: Gymnasium's native vector interface.

    gymnasium.make_vec("MiniRobots/SingleA-v0", num_envs=1024)
    gymnasium.make_vec("MiniRobots/Pair-v0", num_envs=1024)

Boards with one robot have the same bits as a `SyncVectorEnv` of `agent.envs.NavigationEnv` with the
same seeds, boards with several those of as many `agent.envs.parallel_env`. What they have in common
with co-simulated environments (`agent.envs.cosim_vector`) is here too.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from agent.envs.boards import Boards, board_seeds, require_boards
from agent.envs.grid_episode import ActionError, direction_error
from agent.envs.rendering import RENDER_MODES, board_pixels, board_text, require_render_mode
from agent.process.config import ProcessConfig
from agent.process.readings import feature_sizes
from cosim.base.errors import UserError
from cosim.base.outcome import BY_RANK, SUCCESS
from cosim.navigation.features import DIRECTION_COUNT
from cosim.scenarios.file import find_scenario
from cosim.scenarios.scenario import Scenario

_NAMES = np.array(BY_RANK, dtype=object)


class RobotRowsVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Rows are the robots of `boards` boards, those of one board one after the other.

    A board whose episode has ended begins anew with its next step.
    """

    metadata = {  # noqa: RUF012
        "render_modes": RENDER_MODES,
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self, boards: int, scenario: Scenario, process: ProcessConfig, render_mode: str | None
    ) -> None:
        require_render_mode(render_mode)
        require_boards(boards)
        self.scenario = scenario
        self.boards = boards
        self.num_envs = boards * scenario.robots
        self.render_mode = render_mode
        sizes = list(feature_sizes(scenario, process).values())
        self.single_observation_space = spaces.MultiDiscrete(sizes)
        self.single_action_space = spaces.Discrete(DIRECTION_COUNT)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._everywhere = np.ones(self.num_envs, dtype=bool)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        """One seed of each board; `np_random_seed` becomes that of the first."""
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        return board_seeds(seed, self.boards)

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        """(boards, robots) int64.

        Raises:
            ActionError: the actions are not one direction per row.
        """
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs,) or actions.dtype.kind not in "iu":
            raise ActionError(
                f"actions of shape {actions.shape} and type {actions.dtype}; give one whole number "
                f"to each of the {self.num_envs} environments"
            )
        if actions.min() < 0 or actions.max() >= DIRECTION_COUNT:
            row = np.flatnonzero((actions < 0) | (actions >= DIRECTION_COUNT))[0]
            raise direction_error(int(actions[row]), f" of environment {row}")
        return actions.astype(np.int64, copy=False).reshape(self.boards, -1)

    def _infos_of(
        self, outcomes: np.ndarray, path_cm: np.ndarray, **more: np.ndarray
    ) -> dict[str, Any]:
        """Infos from (boards,) ranks and (boards, robots) cm; `more` has a value per row."""
        outcomes = np.repeat(outcomes, self.scenario.robots)
        values = {
            "outcome": _NAMES[outcomes],
            "is_success": outcomes == SUCCESS,
            "path_length": path_cm.ravel(),
        } | more
        return values | {f"_{name}": self._everywhere for name in values}

    def _pictures(self, positions_m: np.ndarray) -> tuple[Any, ...] | None:
        """One picture per board, of robots at (boards, robots, 2) m."""
        if self.render_mode is None:
            return None
        draw = board_text if self.render_mode == "ansi" else board_pixels
        return tuple(draw(self.scenario, position) for position in positions_m)


class RobotsVectorEnv(RobotRowsVectorEnv):
    """Robots on the grid that share a policy: every robot is a sub-environment.

    `make_vec("MiniRobots/Pair-v0", num_envs=K)` has K boards and so K·N rows, which is what
    `env.num_envs` says, as learners that share parameters expect it; the robots of a board are
    consecutive rows. Observations, rewards and ends of a robot are those of
    `agent.envs.parallel_env`. A robot that arrives is terminated once; from then on
    `infos["active"]` is false in its row, its actions (any direction) are ignored and its rewards
    0, until its board begins anew, for all its robots in one step, which is the step after the
    board's end (next-step autoreset) and ignores actions too. `active` says whose next action
    counts: leave what the others do out of a learner's batch.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "2",
        process: ProcessConfig | None = None,
        *,
        render_mode: str | None = None,
        copy: bool = True,
    ) -> None:
        """Make the boards.

        Args:
            num_envs: boards.
            scenario: name of a built-in scenario, a scenario file, or a scenario.
            process: readings of the decision process.
            render_mode: "ansi", "rgb_array" or None; a picture per board.
            copy: whether observations are arrays of their own; or else the same memory, which
                the next step overwrites.

        Raises:
            UserError: the scenario cannot be used.
        """
        process = process or ProcessConfig()
        super().__init__(num_envs, found(scenario), process, render_mode)
        self._boards = Boards(num_envs, self.scenario, process)
        self._boards.seed(board_seeds(int(self.np_random_seed or 0), num_envs))
        self._observations = self._boards.arrays.observations.reshape(self.num_envs, -1)
        self._copy = copy

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; one seed counts up over the boards, as entropy does without one.

        `options={"starts": (boards, robots, 2) cells}` gives the start cells,
        `options={"reset_mask": (boards,) bool}` begins anew on some boards only.

        Raises:
            StartsError: start cells cannot be used.
        """
        self._boards.reset(options, self._seeds(seed))
        return self._seen(), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all boards; one whose episode has ended begins anew with its next step.

        Raises:
            ActionError: the actions are not one direction per row.
        """
        self._boards.step(self._checked(actions))
        arrays = self._boards.arrays
        rewards, terminated, truncated = (
            array.flatten() for array in (arrays.rewards, arrays.terminated, arrays.truncated)
        )
        return self._seen(), rewards, terminated, truncated, self._infos()

    def _seen(self) -> np.ndarray:
        return self._observations.copy() if self._copy else self._observations

    def _infos(self) -> dict[str, Any]:
        arrays = self._boards.arrays
        path_cm = self._boards.path_length_cm()
        return self._infos_of(arrays.outcomes, path_cm, active=arrays.active.flatten())

    def render(self) -> tuple[Any, ...] | None:
        """One picture per board."""
        return self._pictures(self._boards.positions_m())


class NavigationVectorEnv(RobotsVectorEnv):
    """Boards with one robot each, see `agent.envs.NavigationEnv`; infos are that one's."""

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "1a",
        process: ProcessConfig | None = None,
        *,
        render_mode: str | None = None,
        copy: bool = True,
    ) -> None:
        """Make the environments; arguments as of `RobotsVectorEnv`.

        Raises:
            UserError: the scenario cannot be used, or has more than one robot.
        """
        super().__init__(num_envs, lone(scenario), process, render_mode=render_mode, copy=copy)

    def _infos(self) -> dict[str, Any]:
        return self._infos_of(self._boards.arrays.outcomes, self._boards.path_length_cm())


def found(scenario: str | Scenario, *, cosim: bool = False) -> Scenario:
    """A scenario by its name or file, or the scenario itself.

    Raises:
        UserError: it cannot be used, or is to be co-simulated and has a world of its own.
    """
    return scenario if isinstance(scenario, Scenario) else find_scenario(scenario, ideal=cosim)


def lone(scenario: str | Scenario, *, cosim: bool = False) -> Scenario:
    """The scenario, which must be of one robot.

    Raises:
        UserError: it cannot be used (see `found`), or has more than one robot.
    """
    scenario = found(scenario, cosim=cosim)
    if scenario.robots != 1:
        raise UserError(f"scenario {scenario.name} has {scenario.robots} robots, not one")
    return scenario
