"""Many boards in the full co-simulation, stepped in the lanes of one batch; rows are robots.

    gymnasium.make_vec("MiniRobots/CoSim-v0", num_envs=16)
    gymnasium.make_vec("MiniRobots/CoSimPair-v0", num_envs=8)

Boards advance together, 2 s of simulated time a step, in which robots under way ignore their
actions: `infos["active"]` says whose next action counts. Boards with one robot have the same bits
as a `SyncVectorEnv` of environments with `decision="period"` and the same seeds.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.envs.boards import board_options, counted
from agent.envs.cosim_episode import CoSimPlace, set_up
from agent.envs.vector import Ends, RobotRowsVectorEnv, interpreted
from agent.mdp.config import ProcessConfig
from agent.mdp.grid import MOVING
from cosim.base.arguments import ConfigError
from cosim.model.outcome import RUNNING, TIMEOUT
from cosim.model.scenario import Scenario


class CoSimVectorEnv(RobotRowsVectorEnv):
    """Boards in the co-simulation; a step is an RL step."""

    _mutable = ("_batch", "_places")

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "1a",
        process: ProcessConfig | None = None,
        *,
        decision: str = "period",
        render_mode: str | None = None,
        ends: Ends = "together",
        outcome_names: bool = False,
        max_episode_steps: int | None = None,
        **physics: Any,
    ) -> None:
        """Make the boards.

        Args:
            num_envs: boards.
            scenario: name of a built-in scenario, a scenario file, or a scenario.
            process: readings of the decision process.
            decision: "period" alone; boards that wait for each other would have other bits.
            render_mode: "ansi", "rgb_array" or None; a picture per row, that of its board.
            ends: "together" or "own", see `agent.envs.vector.RobotRowsVectorEnv`.
            outcome_names: whether infos have `outcome_name`, the text of the code `outcome`.
            max_episode_steps: limit of RL steps, next to the physics' own `time_limit`.
            physics: see `agent.envs.cosim_episode.set_up`.

        Raises:
            UserError: the scenario or an option cannot be used, or the motor FMU cannot be built.
        """
        if decision != "period":
            raise ConfigError(
                f"decision = {decision} is not possible for boards that advance together; leave "
                'it out and look at infos["active"], or make_vec with vectorization_mode="sync"'
            )
        process = interpreted(process)
        setup = set_up(scenario, physics)
        super().__init__(
            num_envs, setup.scenario, process, render_mode, ends=ends, outcome_names=outcome_names
        )
        self._limit = counted("max_episode_steps", max_episode_steps, int | None)
        self._batch = setup.batch(self.boards)
        self._places = [CoSimPlace(setup, process, self._batch, k) for k in range(self.boards)]
        for m, place in enumerate(self._places):
            place.seed(int(self.np_random_seed or 0) + m)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; seeds and options as of `agent.envs.vector.RobotsVectorEnv`.

        `options={"mu": (boards,)}` gives friction coefficients, `{"targets": (boards, robots, 2)}`
        target cells of these episodes.

        Raises:
            StartsError: start cells cannot be used, or a mask leaves out an environment that has
                never begun; the environments are as they were.
        """
        begun = np.array([episode is not None for episode in self._batch.episodes])
        begins, rows = board_options(options, begun, "starts", "mu", "targets")
        for m in begins:
            self._places[m].check(**rows[m])
        seeds = self._seeds(seed)
        for m in begins:
            if (value := seeds[m]) is not None:
                self._places[m].seed(value)
            self._places[m].reset(**rows[m])
        return self._observations(), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all boards; one that has ended begins again with its next step.

        Raises:
            ActionError: the actions are not one direction per row.
            FmuError: an FMU failed.
        """
        actions = self._checked(actions)
        moved = np.array([place.status == MOVING for place in self._places])
        running = [m for m, place in enumerate(self._places) if place.outcome == RUNNING]
        steps = self._batch.advance({m: actions[m] for m in running}) if running else {}
        for m, place in enumerate(self._places):
            if m not in steps:
                place.reset()
                moved[m] = True
                continue
            place.take(steps[m])
            if place.outcome == RUNNING and steps[m].number + 1 == self._limit:
                place.outcome = TIMEOUT
                self._batch.stop(m)
        moving = np.array([place.status == MOVING for place in self._places])
        outcomes = self._outcomes()
        ended = self._ended(
            outcomes, moved & ~moving, moved & moving & (outcomes != RUNNING)[:, None]
        )
        rewards = np.concatenate([place.rewards for place in self._places])
        return self._observations(), rewards, *ended, self._infos()

    def _outcomes(self) -> np.ndarray:
        return np.array([place.outcome for place in self._places])

    def _observations(self) -> np.ndarray:
        return np.concatenate([place.observation() for place in self._places])

    def action_masks(self) -> np.ndarray:
        """Return (rows, 8) bool, which directions lead to a free cell."""
        self._require_open()
        robots = range(self.scenario.robots)
        return np.array([p.action_mask(i) for p in self._places for i in robots], dtype=bool)

    def _infos(self) -> dict[str, Any]:
        path_cm = np.stack([place.path_length_cm() for place in self._places])
        active = np.stack([place.active for place in self._places])
        return self._infos_of(self._outcomes(), path_cm, active)

    def render(self) -> tuple[Any, ...] | None:
        """One picture per row."""
        return self._pictures(np.stack([place.positions_m() for place in self._places]))

    def close_extras(self, **_: Any) -> None:
        """Free the FMU instances."""
        self._batch.close()
        for place in self._places:
            place.outcome = TIMEOUT
