"""Many one-robot environments stepped by one compiled loop: Gymnasium's native vector interface.

    gymnasium.make_vec("MiniRobots/SingleA-v0", num_envs=1024)

The same bits as a `SyncVectorEnv` of `agent.envs.NavigationEnv` with the same seeds. What it has in
common with many co-simulated environments (`agent.envs.cosim_vector`) is here too.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from agent.envs.grid_episode import FEATURE_COLUMNS, ActionError, direction_error, place_checked
from agent.envs.rendering import board_pixels, board_text
from agent.process.config import ProcessConfig
from agent.process.grid import COLUMN_COUNT, VX, VY, X, Y, move, place_randomly, slipped
from agent.process.readings import Process, build_process, feature_sizes
from agent.process.rng import seeded_state
from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.base.outcome import BY_RANK, RUNNING, SUCCESS, TIMEOUT
from cosim.navigation.features import DIRECTION_COUNT
from cosim.scenarios.file import find_scenario
from cosim.scenarios.scenario import Scenario


@kernel
def _reset_all(process: Process, worlds: np.ndarray, random: np.ndarray, which: np.ndarray) -> None:
    """Place the robots of the environments in `which`, (M,) bool, on drawn start cells."""
    cells = np.empty((worlds.shape[1], 2), dtype=np.int64)
    for m in range(worlds.shape[0]):
        if which[m]:
            place_randomly(process, worlds[m], cells, random[m])


@kernel
def _step_all(
    process: Process,
    worlds: np.ndarray,
    random: np.ndarray,
    actions: np.ndarray,
    steps: np.ndarray,
    rewards: np.ndarray,
    outcomes: np.ndarray,
    path_cells: np.ndarray,
) -> None:
    """Step every environment; those that ended are placed anew instead (next-step autoreset)."""
    cells = np.empty((worlds.shape[1], 2), dtype=np.int64)
    executed = np.empty(worlds.shape[1], dtype=np.int64)
    reward = np.empty(worlds.shape[1], dtype=np.float32)
    slips = process.slip_threshold > np.uint64(0)
    for m in range(worlds.shape[0]):
        world = worlds[m]
        if outcomes[m] != RUNNING:
            place_randomly(process, world, cells, random[m])
            outcomes[m] = RUNNING
            steps[m] = 0
            rewards[m] = 0.0
            path_cells[m] = 0.0
            continue
        executed[0] = actions[m]
        if slips:
            executed[0] = slipped(process, executed[0], random[m])
        outcomes[m] = move(process, world, executed, reward)
        steps[m] += 1
        rewards[m] = reward[0]
        path_cells[m] += np.sqrt(float(world[0, VX] ** 2 + world[0, VY] ** 2))
        if outcomes[m] == RUNNING and steps[m] == process.step_limit:
            outcomes[m] = TIMEOUT


class LoneRobotVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` environments of one robot each, see `agent.envs.NavigationEnv`.

    An environment that has ended begins anew with its next step.
    """

    metadata = {  # noqa: RUF012
        "render_modes": ["ansi", "rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int,
        scenario: str | Scenario,
        process: ProcessConfig,
        render_mode: str | None,
    ) -> None:
        if not isinstance(scenario, Scenario):
            scenario = find_scenario(scenario)
        if scenario.robots != 1:
            raise UserError(f"scenario {scenario.name} has {scenario.robots} robots, not one")
        self.scenario = scenario
        self.num_envs = num_envs
        self.render_mode = render_mode
        self._sizes = np.array(list(feature_sizes(scenario, process).values()))
        self.single_observation_space = spaces.MultiDiscrete(self._sizes.tolist())
        self.single_action_space = spaces.Discrete(DIRECTION_COUNT)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """One seed of each environment; one for all counts up, None leaves them as they are."""
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
            return [int(seed) + m for m in range(self.num_envs)]
        return list(seed)

    def _begun(self, options: dict[str, Any]) -> np.ndarray:
        """(num_envs,) bool, which environments a reset is for."""
        return np.asarray(options.get("reset_mask", np.ones(self.num_envs, dtype=bool)))

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        """(num_envs,) int64.

        Raises:
            ActionError: the actions are not one direction per environment.
        """
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs,) or actions.dtype.kind not in "iu":
            raise ActionError(
                f"actions of shape {actions.shape} and type {actions.dtype}; give one whole number "
                f"to each of the {self.num_envs} environments"
            )
        wrong = np.flatnonzero((actions < 0) | (actions >= DIRECTION_COUNT))
        if len(wrong):
            raise direction_error(int(actions[wrong[0]]), f" of environment {wrong[0]}")
        return actions.astype(np.int64)

    def _infos_of(self, outcomes: np.ndarray, path_cm: np.ndarray) -> dict[str, Any]:
        everywhere = np.ones(self.num_envs, dtype=bool)
        values = {
            "outcome": np.array(BY_RANK, dtype=object)[outcomes],
            "is_success": outcomes == SUCCESS,
            "path_length": path_cm,
        }
        return values | {f"_{name}": everywhere for name in values}

    def _pictures(self, positions_m: np.ndarray) -> tuple[Any, ...] | None:
        """One picture per environment, of robots at (num_envs, 1, 2) m."""
        if self.render_mode is None:
            return None
        draw = board_text if self.render_mode == "ansi" else board_pixels
        return tuple(draw(self.scenario, position) for position in positions_m)


class NavigationVectorEnv(LoneRobotVectorEnv):
    """Environments on the grid."""

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "1a",
        process: ProcessConfig | None = None,
        *,
        render_mode: str | None = None,
    ) -> None:
        """Make the environments.

        Raises:
            UserError: the scenario cannot be used, or has more than one robot.
        """
        process = process or ProcessConfig()
        super().__init__(num_envs, scenario, process, render_mode)
        self.process = build_process(self.scenario, process)
        self._columns = [FEATURE_COLUMNS[name] for name in feature_sizes(self.scenario, process)]
        self._last = self._sizes - 1
        self._worlds = np.zeros((num_envs, 1, COLUMN_COUNT), dtype=np.int64)
        entropy = int(self.np_random_seed or 0)
        self._random = np.stack([seeded_state(entropy + m) for m in range(num_envs)])
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._rewards = np.zeros(num_envs)
        self._outcomes = np.full(num_envs, RUNNING)
        self._path_cells = np.zeros(num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; one seed counts up over the environments, as entropy does without one.

        `options={"starts": (num_envs, 1, 2) cells}` gives the start cells,
        `options={"reset_mask": (num_envs,) bool}` restarts some environments only.

        Raises:
            StartsError: start cells cannot be used.
        """
        for m, value in enumerate(self._seeds(seed)):
            if value is not None:
                self._random[m] = seeded_state(value)
        options = options or {}
        which = self._begun(options)
        if "starts" in options:
            for m in np.flatnonzero(which):
                place_checked(self.process, self._worlds[m], options["starts"][m])
        else:
            _reset_all(self.process, self._worlds, self._random, which)
        self._steps[which] = 0
        self._outcomes[which] = RUNNING
        self._path_cells[which] = 0.0
        return self._observations(), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all environments; one that has ended begins anew with its next step.

        Raises:
            ActionError: the actions are not one direction per environment.
        """
        _step_all(
            self.process,
            self._worlds,
            self._random,
            self._checked(actions),
            self._steps,
            self._rewards,
            self._outcomes,
            self._path_cells,
        )
        truncated = self._outcomes == TIMEOUT
        terminated = (self._outcomes != RUNNING) & ~truncated
        return self._observations(), self._rewards.copy(), terminated, truncated, self._infos()

    def _observations(self) -> np.ndarray:
        return np.clip(self._worlds[:, 0, self._columns], 0, self._last)

    def _infos(self) -> dict[str, Any]:
        return self._infos_of(self._outcomes, 100.0 * self.scenario.cell_m * self._path_cells)

    def render(self) -> tuple[Any, ...] | None:
        """One picture per environment."""
        return self._pictures((self._worlds[:, :, [X, Y]] + 0.5) * self.scenario.cell_m)
