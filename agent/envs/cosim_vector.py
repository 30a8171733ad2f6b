"""Many one-robot environments in the full co-simulation, stepped in the lanes of one batch.

    gymnasium.make_vec("MiniRobots/CoSim-v0", num_envs=16)

The same bits as a `SyncVectorEnv` of `agent.envs.NavigationEnv` with the same seeds.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.envs.boards import reset_options
from agent.envs.cosim_episode import CoSimPlace, new_batch
from agent.envs.grid_episode import StartsError
from agent.envs.vector import RobotRowsVectorEnv, lone
from agent.process.config import ProcessConfig
from cosim.base.outcome import RUNNING, TIMEOUT
from cosim.scenarios.scenario import Scenario


class CoSimVectorEnv(RobotRowsVectorEnv):
    """Environments in the co-simulation; a step is 2 s."""

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
            UserError: the scenario cannot be used, has more than one robot, or the motor FMU cannot
                be built.
        """
        process = process or ProcessConfig()
        super().__init__(num_envs, lone(scenario, cosim=True), process, render_mode)
        self._batch = new_batch(self.scenario, num_envs)
        self._places = [
            CoSimPlace(self.scenario, process, self._batch, place) for place in range(num_envs)
        ]
        self._begun = False
        for m, place in enumerate(self._places):
            place.seed(int(self.np_random_seed or 0) + m)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes; seeds and options as of `agent.envs.vector.NavigationVectorEnv`.

        Raises:
            StartsError: start cells cannot be used, or a mask leaves out an environment that has
                never begun; the environments are as they were.
        """
        which, starts = reset_options(options, (self.num_envs, 1))
        if not (which | self._begun).all():
            raise StartsError("reset_mask leaves out environments that have not begun; reset all")
        given = {
            m: None if starts is None else self._places[m].check(starts[m])
            for m in np.flatnonzero(which).tolist()
        }
        seeds = self._seeds(seed)
        for m, cells in given.items():
            if (value := seeds[m]) is not None:
                self._places[m].seed(value)
            self._places[m].reset(cells)
        self._begun = True
        return self._observations(), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all environments; one that has ended begins anew with its next step.

        Raises:
            ActionError: the actions are not one direction per environment.
            FmuError: an FMU failed.
        """
        actions = self._checked(actions)
        going_on = [m for m, place in enumerate(self._places) if place.outcome == RUNNING]
        steps = self._batch.advance({m: actions[m] for m in going_on}) if going_on else {}
        for m, place in enumerate(self._places):
            if m in steps:
                place.take(steps[m])
            else:
                place.reset(None)
        self._begun = True
        outcomes = self._outcomes()
        truncated = outcomes == TIMEOUT
        terminated = (outcomes != RUNNING) & ~truncated
        rewards = np.array([place.rewards[0] for place in self._places])
        return self._observations(), rewards, terminated, truncated, self._infos()

    def _outcomes(self) -> np.ndarray:
        return np.array([place.outcome for place in self._places])

    def _observations(self) -> np.ndarray:
        return np.stack([place.observation()[0] for place in self._places])

    def _infos(self) -> dict[str, Any]:
        path_cm = np.stack([place.path_length_cm() for place in self._places])
        return self._infos_of(self._outcomes(), path_cm)

    def render(self) -> tuple[Any, ...] | None:
        """One picture per environment."""
        return self._pictures(np.stack([place.positions_m() for place in self._places]))

    def close_extras(self, **_: Any) -> None:
        """Free the FMU instances."""
        self._batch.close()
