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

from agent.envs.boards import Boards, Count, EnvBoards
from agent.envs.rendering import Rows, View, picture
from agent.mdp.config import ProcessConfig
from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.model.outcome import RUNNING
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario

Ends = Literal["together", "own"]


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
        rows = self._begin(options, seed)
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        return rows.observations, _infos(rows)

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all boards; one whose episode has ended begins again instead.

        Raises:
            ConfigError: an action is none of the action space, or the environment is closed.
            FmuError: an FMU failed.
        """
        rows = self._step(actions)
        if self._together:
            ended = rows.infos["outcome"] != RUNNING
            rows = rows._replace(terminated=ended & ~rows.truncated)
        return *rows[:4], _infos(rows)

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture for each row, that of its board with the targets of the episode."""
        self._require_open()
        if self.render_mode is None:
            return None
        pictures = [picture(self.render_mode, *scene) for scene in self._boards.scenes()]
        return tuple(one for one in pictures for _ in range(self._robots))


def _infos(rows: Rows) -> dict[str, Any]:
    """Return infos with the masks that Gymnasium has, which say that every row has them."""
    everywhere = np.ones(len(rows.rewards), dtype=bool)
    return rows.infos | {f"_{name}": everywhere for name in rows.infos}


def direction_boards(
    count: int,
    scenario: str | Scenario,
    process: ProcessConfig | None = None,
    *,
    cosim: bool = False,
    max_episode_steps: int | None = None,
    **physics: Any,
) -> EnvBoards:
    """Return the boards of an environment: on the grid, or in the full co-simulation.

    Args:
        count: boards.
        scenario: name of a built-in scenario, a scenario file, or a scenario.
        process: interpretations of the decision process.
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


class RobotsVectorEnv(RowsVectorEnv):
    """Robots that choose directions and share a policy; every robot of the boards is a row.

    `num_envs=K` boards of N robots have R = K · N rows, and `env.num_envs` is R, as learners that
    share parameters expect it. The robots of a board are consecutive rows.

    - Observation: MultiDiscrete (R, F) int64, each row the features of `process.features` (Section
      III) counted from 0; by default column, row, distance class (0 near, 1 medium, 2 large) and
      change of distance (0 closer, 1 same, 2 farther) of the nearest other robot; without the last
      two for a lone robot.
    - Action: MultiDiscrete (R,), directions k · 45° counter-clockwise from +x, 0 to 7. A row
      ignores its action where `active` was False, and in the step that begins a board again. In
      the dynamics a step is an RL step of 2 s, in which robots on their move ignore their actions.
    - Reward: (R,) float64, Eq. (8) and (11): 100 on arrival, -100 on failure, else -1 per step and
      more for closing in on a robot within 10 cm; 0 for robots that have ended, and where a board
      begins again.
    - Termination: (R,) bool, by `ends="together"` the rows of a board at its end: all its robots
      have arrived, or one left the board or touched something; by `ends="own"` each robot that
      arrived or failed, in its own step. Each row ends once per episode.
    - Truncation: (R,) bool, robots still on their move when their board ended, by a failure of
      another robot or at a limit: `max_episode_steps`, on the grid `process.step_limit` (1000
      moves), in the dynamics `time_limit` (600 s of simulated time).
    - Restart: a board begins again in the step after its end, all its robots (next-step autoreset).
    - Infos: (R,) arrays; `outcome` of the board, int64, 0 running, 1 timeout, 2 success, 3
      collision, 4 out of the board; `is_success`, bool; `path_length`, float64, cm since the start;
      `active`, bool, rows that use their next action; with `outcome_names`, `outcome_name`, str.
      Gymnasium's masks `_outcome` and so on are True in every row.
    - Options of `reset`: `starts`, (K, N, 2) columns and rows; `reset_mask`, (K,) bool, boards to
      begin again, whose seeds alone are used; in the dynamics also `targets`, (K, N, 2) columns and
      rows, and `mu`, (K,) friction coefficients, for these episodes.

    Args: `num_envs` and `ends` as above, those of `direction_boards` and of `View`.

    >>> env = RobotsVectorEnv(2, "2")
    >>> starts = [[[15, 19], [5, 5]], [[3, 3], [25, 25]]]
    >>> env.reset(seed=0, options={"starts": starts})[0].tolist()
    [[15, 19, 2, 1], [5, 5, 2, 1], [3, 3, 2, 1], [25, 25, 2, 1]]
    >>> observations, rewards, terminated, truncated, infos = env.step(np.array([6, 0, 0, 0]))
    >>> rewards, infos["active"]
    (array([100.,  -1.,  -1.,  -1.]), array([False,  True,  True,  True]))
    """

    @staticmethod
    def _boards_of(*arguments: Any, **options: Any) -> EnvBoards:
        if options.get("cosim") and options.setdefault("decision", "period") != "period":
            raise ConfigError(
                f"decision = {options['decision']} is not possible for boards that advance "
                'together; leave it out and look at infos["active"], or make_vec with '
                'vectorization_mode="sync"'
            )
        return direction_boards(*arguments, **options)

    def action_masks(self) -> np.ndarray:
        """Return (rows, 8) bool, which directions lead to a free cell."""
        self._require_open()
        return self._boards.action_masks().astype(bool).reshape(self.num_envs, -1)
