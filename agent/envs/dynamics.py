"""Boards in the full co-simulation, in the places of one batch: motors and contacts.

The boards of the grid are in `agent.envs.boards`.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agent.envs.boards import Count, EnvBoards, Results
from agent.envs.grid_episode import ActionError
from agent.moves.worlds import WorldRange, checked_ranges, draw_world
from cosim.base.arguments import ConfigError, taken
from cosim.base.progress import progress_bars
from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.outcome import BY_RANK, RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.model.world import IDEAL
from cosim.simulation.batch import Batch
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import SimulationOptions, resolve


class EnvSetup(NamedTuple):
    """Settings that all episodes of an environment share.

    Attributes:
        scenario: board, targets and start cells.
        config: calibrated parameters.
        motor_fmu: of every motor.
        worlds: ranges that every episode draws its world from; None for the world of `config`.
    """

    scenario: Scenario
    config: CoSimConfig
    motor_fmu: Path
    worlds: WorldRange | None

    def batch(self, places: int) -> Batch:
        """Places for as many episodes."""
        return Batch(self.motor_fmu, self.config, self.scenario.robots, places)

    def drawn(self, rng: np.random.Generator, mu: float | None) -> CoSimConfig:
        """Parameters of an episode, in a world drawn from the ranges and with a friction if given.

        The steering keeps the calibration of `config`, as in training of the method `robust`.
        """
        config = self.config
        if self.worlds is not None:
            side = max(self.scenario.columns, self.scenario.rows)
            config = config.in_world(draw_world(self.worlds, side, side // 2, rng))
        return config if mu is None else config.with_overrides(mu)


def set_up(scenario: str | Path | Scenario, options: Mapping[str, Any]) -> EnvSetup:
    """Prepare the dynamics by the names of `cosim.simulate`.

    The motor FMU is compiled and the robots calibrated the first time (some seconds).

    Args:
        scenario: name, scenario file or record.
        options: fields of `cosim.simulation.options.SimulationOptions`, `world` as of
            `cosim.simulate`, and `worlds`, ranges to draw a world from in every episode.

    Raises:
        UserError: an option is unknown or does not fit, or the scenario cannot be used.
    """
    given = dict(options)
    known = ["worlds", *(field.name for field in fields(SimulationOptions))]
    for name in given:
        if name not in known:
            raise ConfigError(f"environments have no option {name}; choose from {', '.join(known)}")
    world, worlds = given.pop("world", None), given.pop("worlds", None)
    if worlds is not None and find_in_world(scenario, world)[1] != IDEAL:
        raise ConfigError("worlds has no effect on a given world; leave out world or worlds")
    with progress_bars() as progress:
        setup = resolve(SimulationOptions(**given), scenario, progress, world=world)
    if worlds is not None:
        worlds = checked_ranges(worlds, setup.config)
    return EnvSetup(*setup, worlds)


class DynamicsBoards(EnvBoards):
    """K boards that share a batch and end at the first failure, at a time or at a limit of steps.

    Args:
        count: K.
        setup: see `set_up`.
        limit: of steps, in addition to the physics' own `time_limit`; None for none.

    Raises:
        UserError: a number is invalid, or the motor FMU cannot be used.
    """

    _mutable = ("_batch", "_seeds", "_arrived", "arrays")
    _kind: type[RunningEpisode] = RunningEpisode

    def __init__(self, count: int, setup: EnvSetup, limit: int | None) -> None:
        self._setup, self.scenario = setup, setup.scenario
        self.shape = rows = (taken("num_envs", count, Count), setup.scenario.robots)
        self._limit = taken("max_episode_steps", limit, Count | None)
        self._batch = setup.batch(count)
        self._seeds = [np.random.SeedSequence() for _ in range(count)]
        self._arrived = np.zeros(rows, dtype=bool)
        none, shape = np.zeros(rows, dtype=bool), self.observation_space.shape or ()
        seen = np.zeros((*rows, *shape), dtype=self.observation_space.dtype)
        # none is running yet
        outcomes = np.full(count, TIMEOUT)
        self.arrays = Results(outcomes, seen, np.zeros(rows), none, none, none)

    def _seed(self, m: int, seed: int) -> None:
        self._seeds[m] = np.random.SeedSequence(seed)

    def _begun(self) -> np.ndarray:
        return np.array([episode is not None for episode in self._batch.episodes])

    def _checked(self, *, mu: float | None = None, **options: Any) -> tuple[Any, ...]:
        if mu is not None:
            self._setup.config.with_overrides(mu)  # refuses some
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
        config = self._setup.drawn(rng, mu)
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
