"""Many robots stepped by one compiled loop: Gymnasium's native vector interface.

    gymnasium.make_vec("MiniRobots/SingleA-v0", num_envs=1024)
    gymnasium.make_vec("MiniRobots/Pair-v0", num_envs=1024)

Boards with one robot have the same bits as a `SyncVectorEnv` of `agent.envs.NavigationEnv` with the
same seeds, boards with several those of as many `agent.envs.parallel_env`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from agent.envs.boards import Boards, Count, DirectionBoards, board_seeds
from agent.envs.rendering import View, picture
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.model.outcome import RUNNING
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario

Ends = Literal["together", "own"]


class RowsVectorEnv(View, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Rows are the robots of `boards` boards, those of one board one after the other.

    A board begins again with the step after the end of its episode. A row has one end per episode:
    with `ends="together"` that of its board, until which a robot that has arrived stays where it
    is, with rewards of 0; with `ends="own"` the robot's own, after which `infos["active"]` is false
    in its row until the board begins again.
    """

    metadata = View.metadata | {"autoreset_mode": AutoresetMode.NEXT_STEP}
    _boards_of: Any

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "1a",
        *arguments: Any,
        render_mode: str | None = None,
        outcome_names: bool = False,
        ends: Ends = "together",
        **options: Any,
    ) -> None:
        """Make the boards.

        Args:
            num_envs: boards.
            scenario: of any number of robots.
            arguments, options: of the boards, see the class.
            render_mode, outcome_names: as of `View`; there is a picture per row.
            ends: "together" or "own".

        Raises:
            UserError: the scenario or an option cannot be used, or the motor FMU cannot be built.
        """
        require_one_of("ends", ends, ("together", "own"))
        boards = self._boards_of(num_envs, scenario, *arguments, **options)
        super().__init__(boards, render_mode, outcome_names)
        self._together, self.scenario = ends == "together", boards.scenario
        self.boards, self._robots = boards.shape
        self.num_envs = self.boards * self._robots
        self.single_observation_space = boards.observation_space
        self.single_action_space = boards.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        boards.seed(board_seeds(int(self.np_random_seed or 0), self.boards))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; one seed counts up over the boards, as entropy does without one.

        `options={"starts": (boards, robots, 2) cells}` gives the start cells,
        `options={"reset_mask": (boards,) bool}` begins again on some boards only; their seeds alone
        are taken.

        Raises:
            ConfigError: start cells cannot be used, or a mask leaves out an environment that has
                never begun; the environments are as they were.
        """
        self._boards.reset(options, seed)
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        self.closed = False
        return self._seen(), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all boards; a board begins again with the step after the end of its episode.

        Raises:
            ConfigError: an action is none of the action space, or the environment is closed.
            FmuError: an FMU failed.
        """
        self._require_open()
        self._boards.step(self._boards.joint(actions))
        arrays = self._boards.arrays
        terminated, truncated = arrays.terminated.flatten(), arrays.truncated.flatten()
        if self._together:
            terminated = np.repeat(arrays.outcomes != RUNNING, self._robots) & ~truncated
        return self._seen(), arrays.rewards.flatten(), terminated, truncated, self._infos()

    def _seen(self) -> np.ndarray:
        return self._boards.arrays.observations.reshape(self.num_envs, -1).copy()

    def _infos(self) -> dict[str, Any]:
        infos = self._boards.infos(names=self._outcome_names)
        values = {name: value.ravel() for name, value in infos.items()}
        everywhere = np.ones(self.num_envs, dtype=bool)
        return values | {f"_{name}": everywhere for name in values}

    def render(self) -> tuple[Any, ...] | None:
        """One picture per row, that of its board with the targets of the episode."""
        self._require_open()
        if self.render_mode is None:
            return None
        pictures = [picture(self.render_mode, *scene) for scene in self._boards.scenes()]
        return tuple(one for one in pictures for _ in range(self._robots))


def direction_boards(
    count: int,
    scenario: str | Scenario,
    process: ProcessConfig | None = None,
    *,
    cosim: bool = False,
    max_episode_steps: int | None = None,
    **physics: Any,
) -> DirectionBoards:
    """Boards of an environment: on the grid, or in the full co-simulation.

    Args:
        count: boards.
        scenario: name of a built-in scenario, a scenario file, or a scenario.
        process: readings of the decision process.
        cosim: simulate motors and contacts instead of moving on the grid.
        max_episode_steps: limit of steps, next to the process's own `step_limit`, and in the
            co-simulation to the physics' `time_limit`.
        physics: of the co-simulation, see `agent.envs.dynamics.CoSimBoards`.

    Raises:
        UserError: the scenario or an option cannot be used.
    """
    limit = validate_argument("max_episode_steps", max_episode_steps, Count | None)
    config: ProcessConfig = (
        ProcessConfig() if process is None else validate_argument("process", process, ProcessConfig)
    )
    if cosim:
        # here, because the grid needs no FMUs
        from agent.envs.dynamics import CoSimBoards  # noqa: PLC0415

        return CoSimBoards(count, scenario, config, physics, limit)
    for name in physics:
        raise ConfigError(f"{name} has no effect on the grid; leave it out, or give cosim=True")
    if limit is not None:
        config = replace(config, step_limit=min(config.step_limit, limit))
    return Boards(count, find_scenario(scenario, ideal=True), config)


def _together(
    count: int,
    scenario: str | Scenario,
    process: ProcessConfig | None = None,
    *,
    cosim: bool = False,
    **options: Any,
) -> DirectionBoards:
    """`direction_boards` that advance together."""
    if cosim and options.setdefault("decision", "period") != "period":
        raise ConfigError(
            f"decision = {options['decision']} is not possible for boards that advance "
            'together; leave it out and look at infos["active"], or make_vec with '
            'vectorization_mode="sync"'
        )
    return direction_boards(count, scenario, process, cosim=cosim, **options)


class RobotsVectorEnv(RowsVectorEnv):
    """Robots that choose directions and share a policy: every robot is a sub-environment.

    `make_vec("MiniRobots/Pair-v0", num_envs=K)` has K boards and so K·N rows, which is what
    `env.num_envs` says, as learners that share parameters expect it; the robots of a board are
    consecutive rows. Observations and rewards of a robot are those of `agent.envs.parallel_env`;
    of ends see `RowsVectorEnv`. Actions (any direction) of a robot that has arrived are
    ignored, and so are those of the step after a board's end, with which all its robots begin again
    (next-step autoreset). `infos["active"]` marks the robots that use their next action.

    In the co-simulation boards advance together, 2 s of simulated time a step, in which robots
    under way ignore their actions. `reset(options={"mu": (boards,)})` gives friction coefficients,
    `{"targets": (boards, robots, 2)}` target cells of these episodes.
    """

    _boards_of = staticmethod(_together)

    def action_masks(self) -> np.ndarray:
        """Return (rows, 8) bool, which directions lead to a free cell."""
        self._require_open()
        return self._boards.action_masks().astype(bool).reshape(self.num_envs, -1)
