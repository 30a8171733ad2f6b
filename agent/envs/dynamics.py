"""Boards in the full co-simulation, in the places of one batch: motors and contacts.

The boards of the grid are in `agent.envs.boards`.
"""

import math
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
from cosim.model.config import CoSimConfig
from cosim.model.outcome import RUNNING, TIMEOUT
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

    reset_options = ("starts", "targets", "mu")
    _mutable = ("_batch", "_seeds", "_arrived", "_steps", "arrays")

    def __init__(
        self,
        count: int,
        scenario: str | Path | Scenario,
        physics: Mapping[str, Any],
        limit: int | None,
    ) -> None:
        count = taken("num_envs", count, Count)
        self._limit = taken("max_episode_steps", limit, Count | None) or math.inf
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
        self._steps = np.zeros(count, dtype=np.int64)  # of the episode
        self._arrived: np.ndarray = np.zeros(rows, dtype=bool)
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
        for m, checked in given.items():
            self._begin_board(m, *checked)
        none = np.zeros(self.shape, dtype=bool)
        self._show(np.zeros(self.shape), none, none)

    @abstractmethod
    def _begin_board(self, m: int, *arguments: Any, **options: Any) -> None:
        """Begin an episode on board m: with what `_checked` returned, or drawn without it."""

    def _draws(self, m: int) -> tuple[np.random.Generator, np.random.SeedSequence]:
        """Return what draws the places of board m's next episode, and the seed of its noise."""
        places, noise = self._seeds[m].spawn(2)
        return np.random.default_rng(places), noise

    def _begin_episode(
        self,
        m: int,
        scenario: Scenario,
        cells: np.ndarray,
        mu: float | None,
        rng: np.random.Generator,
        seed: np.random.SeedSequence,
    ) -> CoSimConfig:
        """Begin an episode from (N, 2) cells, in a world that `rng` draws; returns its config."""
        config = self._config
        if self._worlds is not None:  # steering keeps its calibration, as in training of `robust`
            side = max(self.scenario.columns, self.scenario.rows)
            config = config.in_world(draw_world(self._worlds, side, side // 2, rng))
        if mu is not None:
            config = config.with_overrides(mu)
        starts = tuple((int(x), int(y)) for x, y in cells)
        self._batch.begin(m, scenario, starts, seed, config)
        self.arrays.outcomes[m], self._arrived[m], self._steps[m] = RUNNING, False, 0
        return config

    @abstractmethod
    def _looked(self) -> tuple[np.ndarray, np.ndarray]:
        """Return observations (K, N, F), and whose next action counts while boards run, (K, N)."""

    def _show(self, rewards: np.ndarray, terminated: np.ndarray, truncated: np.ndarray) -> None:
        observations, active = self._looked()
        active &= (self.arrays.outcomes == RUNNING)[:, None]
        self.arrays = Results(
            self.arrays.outcomes, observations, rewards, terminated, truncated, active
        )

    def _end(self, running: np.ndarray, outcomes: np.ndarray) -> None:
        """End boards with their (K,) outcomes after a step of those that were running, (K,) bool.

        A board that reached the limit of steps ends as well.
        """
        self._steps += running
        late = (outcomes == RUNNING) & (self._steps == self._limit)
        self.arrays.outcomes[running] = np.where(late, TIMEOUT, outcomes)[running]
        for m in np.flatnonzero(running & (self.arrays.outcomes != RUNNING)).tolist():
            self._batch.stop(m)

    def _episodes(self) -> list[RunningEpisode]:
        """Return the episode of each board, which has one."""
        begun = [episode for episode in self._batch.episodes if episode is not None]
        if len(begun) < self.shape[0]:
            raise ActionError("no episode has begun; call reset first")
        return begun

    def close(self) -> None:
        """Free the FMU instances."""
        self._batch.close()
        self.arrays.outcomes[:] = TIMEOUT
