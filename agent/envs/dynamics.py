"""Boards in the full co-simulation, in the places of one batch: motors and contacts.

Boards with one robot have the same bits in environments of one and of many boards. The boards of
the grid are in `agent.envs.boards`, those with commanded motors in `agent.envs.drive`.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from agent.envs.boards import (
    Count,
    EnvBoards,
    Results,
    direction_spaces,
    free_directions,
    observed_columns,
    placed_world,
    whole_cells,
)
from agent.mdp.config import ProcessConfig, refuse_without_effect
from agent.mdp.greedy import on_grid
from agent.mdp.grid import X, Y
from agent.mdp.interpretations import build_process
from agent.mdp.rewards import failed, reward_parts
from agent.moves.worlds import checked_ranges, draw_world
from cosim.base.arguments import ConfigError, require_one_of, validate_argument
from cosim.base.progress import progress_bars
from cosim.model.outcome import BY_RANK, RUNNING
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.model.world import IDEAL
from cosim.onboard.observing import draw_starts
from cosim.recording.series import REWARD_PARTS
from cosim.simulation.batch import Batch, shared
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.options import options_of, resolve

# Draws what a reset left open: scenario, (N, 2) cells, and what `DynamicsBoards._set_up` takes.
Place = Callable[[np.random.Generator], tuple[Scenario, np.ndarray, Any]]


class DynamicsBoards(EnvBoards):
    """K boards that share a batch and end at the first failure or at a time.

    The motor FMU is compiled and the robots calibrated the first time (some seconds).

    Args:
        physics: options by the names of `cosim.simulate`, and `worlds`, ranges to draw a world from
            in every episode.
        limit: of steps, which cuts episodes; None for none.
        terms: names of the terms of the reward.
    """

    reset_options = ("starts", "targets", "mu")
    _calibrated = True  # whether actions are directions or velocities
    _mutable = ("_batch", "_seeds", "_arrived", "_steps", "arrays")

    def __init__(
        self,
        count: int,
        scenario: str | Path | Scenario,
        physics: Mapping[str, Any],
        limit: int | None,
        terms: Iterable[str],
    ) -> None:
        validate_argument("num_envs", count, Count)  # before anything is measured
        self._limit = validate_argument("max_episode_steps", limit, Count | None) or math.inf
        given = dict(physics)
        world, worlds = given.pop("world", None), given.pop("worlds", None)
        options = options_of("an environment", given, "worlds")
        if worlds is not None and find_in_world(scenario, world)[1] != IDEAL:
            raise ConfigError("worlds has no effect on a given world; leave out world or worlds")
        if worlds is not None and options.shield:
            raise ConfigError(
                "the shield is measured in one world, not in each that is drawn; leave out worlds "
                "or shield, or give a world"
            )
        with progress_bars() as progress:
            resolved = resolve(options, scenario, progress, world=world, calibrate=self._calibrated)
        self.scenario, self._config, motor_fmu = resolved
        super().__init__(count, self.scenario, *self._spaces(), shared(self._config))
        self._worlds = None if worlds is None else checked_ranges(worlds, self._config)
        self._batch = Batch(motor_fmu, self._config, self.scenario.robots, count)
        self._seeds = [np.random.SeedSequence() for _ in range(count)]
        self._steps = np.zeros(count, dtype=np.int64)  # of the episode
        self._arrived: np.ndarray = np.zeros(self.shape, dtype=bool)
        self.terms = {name: np.zeros(self.shape) for name in terms}

    @abstractmethod
    def _spaces(self) -> tuple[spaces.Space, spaces.Space]:
        """Return observation and action space of a robot."""

    def _seed(self, m: int, seed: int) -> None:
        self._seeds[m] = np.random.SeedSequence(seed)

    def _begun(self) -> np.ndarray:
        return np.array([episode is not None for episode in self._batch.episodes])

    def _checked(
        self, *, mu: float | None = None, starts: Any = None, targets: Any = None
    ) -> tuple[float | None, Place]:
        if mu is not None:
            if self._config.shield:
                raise ConfigError(
                    "the shield is measured on one floor; leave out shield, or give mu to the "
                    "environment instead of a reset"
                )
            self._config.having("given", mu=mu)  # refuses some
            if mu == 0.0:
                raise ConfigError("mu = 0 is invalid: no robot could drive; give more")
        return mu, self._placement(starts, targets)

    @abstractmethod
    def _placement(self, starts: Any, targets: Any) -> Place:
        """Return what places robots, from starts and targets that a user gave, or None each."""

    def _begin(self, given: dict[int, tuple[float | None, Place]]) -> None:
        for m, (mu, place) in given.items():
            self._begin_board(m, mu, place)
        self._clear_terms()
        none = np.zeros(self.shape, dtype=bool)
        self._publish(np.zeros(self.shape), none, none)

    def _clear_terms(self) -> None:
        for values in self.terms.values():
            values[:] = 0.0

    def _begin_board(self, m: int, mu: float | None, place: Place) -> None:
        """Begin an episode on board m, in a drawn world if worlds are drawn."""
        positions, noise = self._seeds[m].spawn(2)
        rng, config = np.random.default_rng(positions), self._config
        scenario, cells, placed = place(rng)
        if self._worlds is not None:  # steering keeps its calibration, as in drawn worlds
            side = max(self.scenario.columns, self.scenario.rows)
            config = config.in_world(draw_world(self._worlds, side, side // 2, rng))
        if mu is not None:
            config = config.having("given", mu=mu)
        starts = tuple((int(x), int(y)) for x, y in cells)
        self.arrays.outcomes[m], self._arrived[m], self._steps[m] = RUNNING, False, 0
        self.arrays.over[m] = False
        self._set_up(m, self._batch.begin(m, scenario, starts, noise, config), placed)

    @abstractmethod
    def _set_up(self, m: int, episode: RunningEpisode, placed: Any) -> None:
        """Prepare board m for an episode that has begun."""

    def step(self, actions: np.ndarray) -> None:
        """See `EnvBoards.step`."""
        outcomes, over, moved = self.arrays.outcomes, self.arrays.over, self.remaining()
        running = ~over
        rewards, lost = np.zeros(self.shape), np.zeros(self.shape, dtype=bool)
        self._clear_terms()
        self._steps += running
        if running.any():
            self._advance(actions, rewards, lost)
        cut, ended = self._steps >= self._limit, outcomes != RUNNING
        over |= cut | ended
        for m in np.flatnonzero(running & over).tolist():
            self._batch.stop(m)
        for m in np.flatnonzero(~running).tolist():
            self._begin_board(m, None, self._placement(None, None))
        moving = ~(self._arrived | lost)
        truncated = moved & (cut[:, None] | (moving & ended[:, None]))
        self._publish(rewards, moved & ~moving, truncated)

    @abstractmethod
    def _advance(self, actions: np.ndarray, rewards: np.ndarray, lost: np.ndarray) -> None:
        """Simulate a step of the boards that are not over by (K, N, ...) actions.

        Args:
            rewards: (K, N), zeros that get the rewards of the step, as `terms` gets their terms.
            lost: (K, N) bool, gets the robots that failed.
        """

    @abstractmethod
    def _observed(self) -> tuple[np.ndarray, np.ndarray]:
        """Return observations (K, N, F), and the robots that await an action, (K, N) bool."""

    def _publish(self, rewards: np.ndarray, terminated: np.ndarray, truncated: np.ndarray) -> None:
        outcomes, (observations, awaiting) = self.arrays.outcomes, self._observed()
        active = awaiting & (outcomes == RUNNING)[:, None]
        ends = terminated, truncated
        self.arrays = Results(outcomes, self.arrays.over, observations, rewards, *ends, active)

    def remaining(self) -> np.ndarray:
        """See `EnvBoards.remaining`."""
        return ~self._arrived & ~self.arrays.over[:, None]

    def _episodes(self) -> list[RunningEpisode]:
        """Return the episode of each board, which has one."""
        begun = [episode for episode in self._batch.episodes if episode is not None]
        if len(begun) < self.shape[0]:
            raise ConfigError("no episode has begun; call reset first")
        return begun

    def path_length_cm(self) -> np.ndarray:
        """See `EnvBoards.path_length_cm`."""
        return 100.0 * np.array([episode.measures.path_length_m for episode in self._episodes()])

    def scenes(self) -> list[tuple[Scenario, np.ndarray]]:
        """See `EnvBoards.scenes`."""
        return [(episode.scenario, episode.positions_m) for episode in self._episodes()]

    def close(self) -> None:
        """See `EnvBoards.close`."""
        super().close()
        self._batch.close()


class CoSimBoards(DynamicsBoards):
    """K boards with robots that adopt directions when they wait for one.

    Args:
        count, scenario, limit: as of `DynamicsBoards`.
        physics: as of `DynamicsBoards`; and `decision`, when a step ends: after every
            "period" of 2 s, or, of one board, on "arrival", when a robot waits for an action; its
            rewards cover the time that passed.
    """

    _mutable = (*DynamicsBoards._mutable, "_processes")

    def __init__(
        self,
        count: int,
        scenario: str | Scenario,
        config: ProcessConfig,
        physics: Mapping[str, Any],
        limit: int | None = None,
    ) -> None:
        options = {"decision": "arrival", **physics}
        require_one_of("decision", decision := options.pop("decision"), ("arrival", "period"))
        refuse_without_effect(config, "the co-simulation")
        self._until_arrival, self._process = decision == "arrival", config
        super().__init__(count, scenario, options, limit, REWARD_PARTS)
        self._features = np.array(observed_columns(self.scenario, config))
        self._usual = build_process(self.scenario, config)
        self._processes = [self._usual] * count

    def _spaces(self) -> tuple[spaces.Space, spaces.Space]:
        return direction_spaces(self.scenario, self._process)

    def _placement(self, starts: Any, targets: Any) -> Place:
        scenario, process = self.scenario, self._usual
        if targets is not None:
            aims = whole_cells("targets", targets, (scenario.robots, 2))
            scenario = replace(scenario, targets=tuple((int(x), int(y)) for x, y in aims))
            process = build_process(scenario, self._process)
        given = None if starts is None else placed_world(process, starts)[:, [X, Y]]

        def place(rng: np.random.Generator) -> tuple[Scenario, np.ndarray, Any]:
            cells = given
            if cells is None:
                cells = np.array(draw_starts(scenario, rng))
                placed_world(process, cells)  # refuses some
            return scenario, cells, process

        return place

    def _set_up(self, m: int, episode: RunningEpisode, placed: Any) -> None:
        self._processes[m] = placed

    def _advance(self, actions: np.ndarray, rewards: np.ndarray, lost: np.ndarray) -> None:
        """Simulate an RL step, or until a robot waits for an action; see the base class."""
        outcomes, episodes = self.arrays.outcomes, self._episodes()
        while running := np.flatnonzero((outcomes == RUNNING) & ~self.arrays.over).tolist():
            for m, step in self._batch.advance({m: actions[m] for m in running}).items():
                outcomes[m] = BY_RANK.index(step.outcome)
                self._arrived[m] = arrived = episodes[m].arrived
                lost[m] = failed(step, arrived)
                parts = np.nan_to_num(reward_parts(self._processes[m], step, arrived))
                rewards[m] += parts.sum(axis=1)
                for name, part in zip(REWARD_PARTS, parts.T, strict=True):
                    self.terms[name][m] += part
            if not self._until_arrival or episodes[0].awaiting.any():
                break

    def _observed(self) -> tuple[np.ndarray, np.ndarray]:
        episodes, last = self._episodes(), (self.scenario.columns - 1, self.scenario.rows - 1)
        rows = []
        for process, episode in zip(self._processes, episodes, strict=True):
            observation = episode.observation
            cells = np.clip(observation.cells, 0, last)
            world, _ = on_grid(process, observation._replace(cells=cells))
            rows.append(world[:, self._features[:, 0]] + self._features[:, 1])
        return np.array(rows), np.array([episode.awaiting for episode in episodes])

    def action_masks(self) -> np.ndarray:
        """Return which directions lead to a free cell, (K, N, 8) int8; see `free_directions`."""
        last, robots = (self.scenario.columns, self.scenario.rows), np.arange(self.shape[1])
        masks = []
        for process, episode in zip(self._processes, self._episodes(), strict=True):
            x, y = (episode.observation.cells.clip(-1, last) + 1).T
            masks.append(free_directions(process)[robots, x, y])
        return np.array(masks)
