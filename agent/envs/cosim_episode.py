"""One episode in the full co-simulation, as environments step it: motors, contacts, 2 s a step.

The grid's counterpart, and the interface of both, is in `agent.envs.grid_episode`. An action is
adopted when the robot waits for one: a robot under way ignores it, and earns the
reward of every step that its move takes.
"""

import numpy as np

from agent.envs.grid_episode import FEATURE_COLUMNS, place_checked
from agent.process.acting import on_grid
from agent.process.config import ProcessConfig, refuse_without_effect
from agent.process.grid import ARRIVED, COLUMN_COUNT, HIT, LEFT, MOVING, SIGN, X, Y
from agent.process.readings import build_process, feature_sizes
from agent.process.rewards import failed, step_reward
from cosim.base.config import CoSimConfig
from cosim.base.outcome import BY_RANK, OUT_OF_BOARD, RUNNING, TIMEOUT
from cosim.base.params import TABLE_I
from cosim.base.progress import progress_bars
from cosim.calibration.cache import calibrated_slower
from cosim.navigation.batch import Batch
from cosim.navigation.observing import draw_starts
from cosim.navigation.step import Step
from cosim.scenarios.scenario import Scenario
from fmus.build import cached_fmu


def new_batch(scenario: Scenario, places: int, config: CoSimConfig | None = None) -> Batch:
    """Places for episodes of a scenario.

    Without a configuration robots have the default parameters; those of another diameter than
    Table I's are calibrated first.

    Raises:
        UserError: the motor FMU cannot be built.
    """
    fmu = cached_fmu()
    if config is None and scenario.robot_diameter_m != TABLE_I.diameter_m:
        with progress_bars() as progress:
            config = calibrated_slower(
                CoSimConfig().sized(scenario.robot_diameter_m), fmu, progress
            )
    return Batch(fmu, config or CoSimConfig(), scenario.robots, places)


class CoSimPlace:
    """The episodes of an environment in one place of a batch; advancing the batch is its owner's.

    Attributes as of `agent.envs.grid_episode.EnvEpisode`.

    Raises:
        UserError: the scenario cannot be used.
    """

    def __init__(
        self, scenario: Scenario, process: ProcessConfig | None, batch: Batch, place: int
    ) -> None:
        process = process or ProcessConfig()
        refuse_without_effect(process, "the co-simulation")
        self.scenario = scenario
        self.process = build_process(scenario, process)
        sizes = feature_sizes(scenario, process)
        self.sizes = tuple(sizes.values())
        self._columns = [FEATURE_COLUMNS[name] for name in sizes]
        self._batch, self._place = batch, place
        self.status = np.full(scenario.robots, MOVING)
        self.rewards = np.zeros(scenario.robots)
        self.outcome = TIMEOUT  # none is running yet
        self.seed(None)

    def seed(self, seed: int | None) -> None:
        """Seed start cells and speed noise; with entropy if None."""
        self._seed = np.random.SeedSequence(seed)

    def check(self, starts: np.ndarray) -> np.ndarray:
        """(N, 2) int64, start cells that a user gave.

        Raises:
            StartsError: they are off the board, blocked or in contact.
        """
        world = np.zeros((self.scenario.robots, COLUMN_COUNT), dtype=np.int64)
        place_checked(self.process, world, starts)
        return world[:, [X, Y]]

    def reset(self, starts: np.ndarray | None) -> None:
        """Set the robots down, motors at rest.

        Raises:
            StartsError: see `check`; nothing has changed.
            FmuError: the FMU cannot be instantiated.
        """
        given = None if starts is None else self.check(starts)
        start_seed, noise_seed = self._seed.spawn(2)
        if given is None:
            drawn = draw_starts(self.scenario, np.random.default_rng(start_seed))
            given = self.check(np.array(drawn))
        cells = tuple((int(x), int(y)) for x, y in given)
        self._running = self._batch.begin(self._place, self.scenario, cells, noise_seed)
        self._positions_m = np.array([self.scenario.centre_m(cell) for cell in cells])
        self.status = np.full(self.scenario.robots, MOVING)
        self.rewards = np.zeros(self.scenario.robots)
        self.outcome = RUNNING

    def take(self, step: Step) -> None:
        """Go on to the end of an RL step of the batch."""
        self._positions_m = step.samples.position[-1, :, :2].copy()
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

    def path_length_cm(self) -> np.ndarray:
        """(N,) float64."""
        return 100.0 * self._running.measures.path_length_m

    def positions_m(self) -> np.ndarray:
        """(N, 2) float64."""
        return self._positions_m

    def close(self) -> None:
        """Free the FMU instances."""
        self._batch.close()


class CoSimEpisode(CoSimPlace):
    """An episode in the co-simulation, alone, see `agent.envs.grid_episode.EnvEpisode`.

    Raises:
        UserError: the scenario cannot be used, or the motor FMU cannot be built.
    """

    def __init__(
        self,
        scenario: Scenario,
        process: ProcessConfig | None = None,
        config: CoSimConfig | None = None,
    ) -> None:
        super().__init__(scenario, process, new_batch(scenario, 1, config), 0)

    def step(self, actions: np.ndarray) -> None:
        """Simulate 2 s.

        Raises:
            FmuError: an FMU failed.
        """
        action = np.asarray(actions, dtype=np.int64)
        self.take(self._batch.advance({self._place: action})[self._place])
