"""Boards in the full co-simulation, in the places of one batch: motors and contacts.

The boards of the grid are in `agent.envs.boards`.
"""

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from agent.envs.boards import Count, EnvBoards, Results
from agent.envs.grid_episode import ActionError
from agent.moves.worlds import checked_ranges, draw_world
from cosim.base.arguments import ConfigError, taken
from cosim.base.progress import progress_bars
from cosim.coupling.rl_step import Step
from cosim.model.outcome import BY_RANK, RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.model.world import IDEAL
from cosim.simulation.batch import Batch
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import options_of, resolve


class DynamicsBoards(EnvBoards):
    """K boards that share a batch and end at the first failure, at a time or at a limit of steps.

    The motor FMU is compiled and the robots calibrated the first time (some seconds).

    Args:
        count: K.
        scenario: name, scenario file or record.
        physics: options by the names of `cosim.simulate`, and `worlds`, ranges to draw a world from
            in every episode.
        limit: of steps, in addition to the physics' own `time_limit`; None for none.

    Raises:
        UserError: an option is unknown or does not fit, or the scenario or the motor FMU cannot be
            used.
    """

    _mutable = ("_batch", "_seeds", "_arrived", "arrays")
    _kind: type[RunningEpisode] = RunningEpisode

    def __init__(
        self,
        count: int,
        scenario: str | Path | Scenario,
        physics: Mapping[str, Any],
        limit: int | None,
    ) -> None:
        count = taken("num_envs", count, Count)
        self._limit = taken("max_episode_steps", limit, Count | None)
        given = dict(physics)
        world, worlds = given.pop("world", None), given.pop("worlds", None)
        options = options_of("an environment", given, "world", "worlds")
        if worlds is not None and find_in_world(scenario, world)[1] != IDEAL:
            raise ConfigError("worlds has no effect on a given world; leave out world or worlds")
        with progress_bars() as progress:
            setup = resolve(options, scenario, progress, world=world)
        self.scenario, self._config, motor_fmu = setup
        self._worlds = None if worlds is None else checked_ranges(worlds, self._config)
        self.observation_space, self.action_space = self._spaces()
        self.shape = rows = (count, self.scenario.robots)
        self._batch = Batch(motor_fmu, self._config, self.scenario.robots, count)
        self._seeds = [np.random.SeedSequence() for _ in range(count)]
        self._arrived = np.zeros(rows, dtype=bool)
        none, shape = np.zeros(rows, dtype=bool), self.observation_space.shape or ()
        seen = np.zeros((*rows, *shape), dtype=self.observation_space.dtype)
        # none is running yet
        outcomes = np.full(count, TIMEOUT)
        self.arrays = Results(outcomes, seen, np.zeros(rows), none, none, none)

    @abstractmethod
    def _spaces(self) -> tuple[spaces.Space, spaces.Space]:
        """Return observation and action space of a robot."""

    def _seed(self, m: int, seed: int) -> None:
        self._seeds[m] = np.random.SeedSequence(seed)

    def _begun(self) -> np.ndarray:
        return np.array([episode is not None for episode in self._batch.episodes])

    def _checked(self, *, mu: float | None = None, **options: Any) -> tuple[Any, ...]:
        if mu is not None:
            self._config.with_overrides(mu)  # refuses some
            if mu == 0.0:
                raise ConfigError("mu = 0 is invalid: no robot could drive; give more")
        return (mu, *self._checked_places(**options))

    @abstractmethod
    def _checked_places(self, *arguments: Any, **options: Any) -> tuple[Any, ...]:
        """Return what `_put` takes, from the starts and targets of a reset; raises UserError."""

    def _begin(self, given: dict[int, tuple[Any, ...]]) -> None:
        for m, (mu, *places) in given.items():
            self._begin_board(m, mu, *places)
        none = np.zeros(self.shape, dtype=bool)
        self._show(np.zeros(self.shape), none, none)

    def _begin_board(self, m: int, mu: float | None = None, *places: Any) -> None:
        """Begin an episode on a board, with a friction; what is not given is drawn."""
        start_seed, noise_seed = self._seeds[m].spawn(2)
        rng = np.random.default_rng(start_seed)
        scenario, cells, *rest = self._placed(rng, *places)
        config = self._config
        if self._worlds is not None:  # steering keeps its calibration, as in training of `robust`
            side = max(self.scenario.columns, self.scenario.rows)
            config = config.in_world(draw_world(self._worlds, side, side // 2, rng))
        if mu is not None:
            config = config.with_overrides(mu)
        cells = tuple((int(x), int(y)) for x, y in cells)
        self._batch.begin(m, scenario, cells, noise_seed, config, self._kind)
        self._put(m, *rest)
        self.arrays.outcomes[m], self._arrived[m] = RUNNING, False

    @abstractmethod
    def _placed(self, rng: np.random.Generator, *arguments: Any, **options: Any) -> tuple[Any, ...]:
        """Return scenario and start cells of an episode, and what `_put` takes.

        Args:
            rng: is drawn from.
            arguments: as `_checked_places` returns them; none in the step after an end.
        """

    @abstractmethod
    def _put(self, m: int, *arguments: Any, **options: Any) -> None:
        """Prepare board m, whose episode has begun."""

    @abstractmethod
    def _looked(self) -> tuple[np.ndarray, np.ndarray]:
        """Return observations (K, N, F), and whose next action counts while boards run, (K, N)."""

    def _show(self, rewards: np.ndarray, terminated: np.ndarray, truncated: np.ndarray) -> None:
        observations, active = self._looked()
        active &= (self.arrays.outcomes == RUNNING)[:, None]
        self.arrays = Results(
            self.arrays.outcomes, observations, rewards, terminated, truncated, active
        )

    def _advance(self, actions: np.ndarray) -> dict[int, Step]:
        """Simulate an RL step of the boards that run; returns their steps.

        Raises:
            FmuError: an FMU failed.
        """
        outcomes = self.arrays.outcomes
        running = np.flatnonzero(outcomes == RUNNING).tolist()
        steps = self._batch.advance({m: actions[m] for m in running}) if running else {}
        for m, step in steps.items():
            outcomes[m] = BY_RANK.index(step.outcome)
            self._arrived[m] = self._episode(m).arrived
            if outcomes[m] == RUNNING and step.number + 1 == self._limit:
                outcomes[m] = TIMEOUT
                self._batch.stop(m)
        return steps

    def _episode(self, m: int) -> Any:
        if (episode := self._batch.episodes[m]) is None:
            raise ActionError("no episode has begun; call reset first")
        return episode

    def path_length_cm(self) -> np.ndarray:
        """See `EnvBoards.path_length_cm`."""
        boards = range(self.shape[0])
        return 100.0 * np.array([self._episode(m).measures.path_length_m for m in boards])

    def close(self) -> None:
        """Free the FMU instances."""
        self._batch.close()
        self.arrays.outcomes[:] = TIMEOUT
