"""One episode in the full co-simulation, as environments step it: motors and contacts.

The grid's counterpart is `agent.envs.boards.GridEpisode`. A robot adopts
an action when it waits for one. A step of `CoSimEpisode` lasts until a robot does, or one RL step
of 2 s; its rewards cover the time that passed.
"""

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agent.envs.grid_episode import (
    FEATURE_COLUMNS,
    free_directions,
    place_checked,
    whole_cells,
)
from agent.envs.state import Restorable
from agent.envs.worlds import checked_ranges
from agent.mdp.acting import on_grid
from agent.mdp.config import ProcessConfig, refuse_without_effect
from agent.mdp.grid import ARRIVED, COLUMN_COUNT, HIT, LEFT, MOVING, SIGN, X, Y
from agent.mdp.readings import Process, build_process, feature_sizes
from agent.mdp.rewards import failed, step_reward
from agent.moves.worlds import Ranges, draw_world
from cosim.base.arguments import ConfigError, require_one_of
from cosim.base.progress import progress_bars
from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.outcome import BY_RANK, OUT_OF_BOARD, RUNNING, TIMEOUT
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.model.world import IDEAL
from cosim.onboard.observing import draw_starts
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
    worlds: Ranges | None

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


class CoSimPlace(Restorable):
    """The episodes of an environment in one place of a batch; advancing the batch is its owner's.

    Attributes as of `agent.envs.boards.GridEpisode`.

    Raises:
        UserError: the scenario cannot be used.
    """

    reset_options = ("starts", "mu", "targets")
    _mutable = ("scenario", "process", "status", "rewards", "outcome", "_positions_m", "_seed")

    def __init__(
        self, setup: EnvSetup, process: ProcessConfig | None, batch: Batch, place: int
    ) -> None:
        self._config = process or ProcessConfig()
        refuse_without_effect(self._config, "the co-simulation")
        self._setup = setup
        self.scenario = setup.scenario
        self.process = self._usual = build_process(setup.scenario, self._config)
        sizes = feature_sizes(setup.scenario, self._config)
        self.sizes = tuple(sizes.values())
        self._columns = [FEATURE_COLUMNS[name] for name in sizes]
        self._batch, self._place = batch, place
        self._last = np.array([self.scenario.columns, self.scenario.rows])
        self.status = np.full(self.scenario.robots, MOVING)
        self.rewards = np.zeros(self.scenario.robots)
        self._positions_m = np.zeros((self.scenario.robots, 2))
        self.outcome = TIMEOUT  # none is running yet
        self.seed(None)

    @property
    def _running(self) -> RunningEpisode:
        episode = self._batch.episodes[self._place]
        assert episode is not None
        return episode

    @property
    def active(self) -> np.ndarray:
        """(N,) bool, robots that adopt an action in the next step."""
        return self._running.awaiting & (self.outcome == RUNNING)

    def seed(self, seed: int | None) -> None:
        """Seed start cells, worlds and speed noise; with entropy if None."""
        self._seed = np.random.SeedSequence(seed)

    def check(
        self, starts: Any = None, mu: Any = None, targets: Any = None
    ) -> tuple[Scenario, Process, np.ndarray | None]:
        """Scenario, process and (N, 2) int64 start cells (None to draw them) of an episode.

        Args:
            starts, mu, targets: as of `reset`.

        Raises:
            StartsError: start cells are off the board, blocked or in contact.
            UserError: friction or targets cannot be used.
        """
        scenario, process, cells = self._setup.scenario, self._usual, None
        if targets is not None:
            aims = whole_cells(targets, (scenario.robots, 2), "targets")
            scenario = replace(scenario, targets=tuple((int(x), int(y)) for x, y in aims))
            process = build_process(scenario, self._config)
        if starts is not None:
            world = np.zeros((scenario.robots, COLUMN_COUNT), dtype=np.int64)
            place_checked(process, world, starts)
            cells = world[:, [X, Y]]
        if mu is not None:
            self._setup.config.with_overrides(mu)
        return scenario, process, cells

    def reset(
        self,
        starts: np.ndarray | None = None,
        mu: float | None = None,
        targets: np.ndarray | None = None,
    ) -> None:
        """Set the robots down, motors at rest.

        Args:
            starts: (N, 2) start cells, drawn if None.
            mu: friction coefficient of the floor in this episode.
            targets: (N, 2) target cells of this episode, by default those of the scenario.

        Raises:
            UserError: see `check`; nothing has changed.
            FmuError: the FMU cannot be instantiated.
        """
        self.scenario, self.process, given = self.check(starts, mu, targets)
        start_seed, noise_seed = self._seed.spawn(2)
        rng = np.random.default_rng(start_seed)
        if given is None:
            _, _, given = self.check(np.array(draw_starts(self.scenario, rng)), None, targets)
            assert given is not None
        cells = tuple((int(x), int(y)) for x, y in given)
        config = self._setup.drawn(rng, mu)
        self._batch.begin(self._place, self.scenario, cells, noise_seed, config)
        self._positions_m = np.array([self.scenario.centre_m(cell) for cell in cells])
        self.status = np.full(self.scenario.robots, MOVING)
        self.rewards = np.zeros(self.scenario.robots)
        self.outcome = RUNNING

    def take(self, step: Step) -> None:
        """Go on to the end of an RL step of the batch."""
        self._positions_m = self._running.positions_m
        arrived = self._running.arrived
        self.rewards = np.nan_to_num(step_reward(self.process, step, arrived))
        self.outcome = BY_RANK.index(step.outcome)
        self.status[arrived] = ARRIVED
        lost = failed(step, arrived)
        self.status[lost] = np.where(step.events[lost] == OUT_OF_BOARD, LEFT, HIT)

    def observation(self) -> np.ndarray:
        """(N, features) int64; a robot that left the board seems to be at its edge."""
        seen = self._running.observation
        cells = np.clip(seen.cells, 0, (self.scenario.columns - 1, self.scenario.rows - 1))
        world, _ = on_grid(self.process, seen._replace(cells=cells))
        world[:, SIGN] += 1
        return world[:, self._columns]

    def action_mask(self, robot: int) -> np.ndarray:
        """(8,) int8, see `agent.envs.grid_episode.free_directions`."""
        table = free_directions(self.process)[robot]
        return table[tuple(self._running.observation.cells[robot].clip(-1, self._last) + 1)]

    def path_length_cm(self) -> np.ndarray:
        """(N,) float64."""
        return 100.0 * self._running.measures.path_length_m

    def positions_m(self) -> np.ndarray:
        """(N, 2) float64."""
        return self._positions_m

    def close(self) -> None:
        """Free the FMU instances."""
        self._batch.close()
        self.outcome = TIMEOUT


class CoSimEpisode(CoSimPlace):
    """One episode in the co-simulation, with the interface of `agent.envs.boards.GridEpisode`.

    Raises:
        UserError: the scenario cannot be used, or the motor FMU cannot be built.
    """

    _mutable = (*CoSimPlace._mutable, "_batch")

    def __init__(
        self, setup: EnvSetup, process: ProcessConfig | None = None, decision: str = "arrival"
    ) -> None:
        require_one_of("decision", decision, ("arrival", "period"))
        self._until_arrival = decision == "arrival"
        super().__init__(setup, process, setup.batch(1), 0)

    def step(self, actions: np.ndarray) -> None:
        """Simulate until a robot waits for an action, or one RL step.

        Raises:
            FmuError: an FMU failed.
        """
        action, rewards = np.asarray(actions, dtype=np.int64), np.zeros(self.scenario.robots)
        while True:
            self.take(self._batch.advance({self._place: action})[self._place])
            rewards += self.rewards
            if self.outcome != RUNNING or not self._until_arrival or self.active.any():
                break
        self.rewards = rewards
