"""One episode in the full co-simulation, as environments step it: motors, contacts, 2 s a step.

The grid's counterpart, and the interface of both, is in `agent.envs.grid_episode`. An action is
adopted when the robot waits for one: a robot under way ignores it, and earns the
reward of every step that its move takes.
"""

import numpy as np

from agent.envs.grid_episode import FEATURE_COLUMNS, place_checked
from agent.process.acting import on_grid
from agent.process.config import ProcessConfig
from agent.process.grid import ARRIVED, COLUMN_COUNT, HIT, LEFT, MOVING, SIGN
from agent.process.readings import build_process, feature_sizes
from agent.process.rewards import failed, step_reward
from cosim.base.config import CoSimConfig
from cosim.base.outcome import BY_RANK, OUT_OF_BOARD, RUNNING
from cosim.base.params import TABLE_I
from cosim.base.scenario import Scenario
from cosim.navigation.calibration_cache import calibrated_for
from cosim.navigation.episode import CoSimulation
from cosim.navigation.observing import draw_starts
from fmus.build import cached_fmu


class CoSimEpisode:
    """An episode in the co-simulation, see `agent.envs.grid_episode.EnvEpisode`.

    Without a configuration robots have the default parameters; those of another diameter than
    Table I's are calibrated first.

    Raises:
        UserError: the scenario cannot be used, or the motor FMU cannot be built.
    """

    def __init__(
        self,
        scenario: Scenario,
        process: ProcessConfig | None = None,
        config: CoSimConfig | None = None,
    ) -> None:
        process = process or ProcessConfig()
        self.scenario = scenario
        self.process = build_process(scenario, process)
        sizes = feature_sizes(scenario, process)
        self.sizes = tuple(sizes.values())
        self._columns = [FEATURE_COLUMNS[name] for name in sizes]
        fmu = cached_fmu()
        if config is None and scenario.robot_diameter_m != TABLE_I.diameter_m:
            config = calibrated_for(scenario, fmu)
        self._system = CoSimulation(scenario, fmu, config)
        self.status = np.full(scenario.robots, MOVING)
        self.rewards = np.zeros(scenario.robots)
        self.outcome = RUNNING
        self.seed(None)

    def seed(self, seed: int | None) -> None:
        """Seed start cells and speed noise; with entropy if None."""
        self._seed = np.random.SeedSequence(seed)

    def reset(self, starts: np.ndarray | None) -> None:
        """Set the robots down, motors at rest.

        Raises:
            StartsError: start cells are off the board, blocked or in contact.
            FmuError: the FMU cannot be instantiated.
        """
        start_seed, noise_seed = self._seed.spawn(2)
        if starts is None:
            starts = np.array(draw_starts(self.scenario, np.random.default_rng(start_seed)))
        world = np.zeros((self.scenario.robots, COLUMN_COUNT), dtype=np.int64)
        place_checked(self.process, world, starts)
        cells = tuple((int(x), int(y)) for x, y in starts)
        self._seen = self._system.reset(cells, noise_seed)
        self._positions_m = np.array([self.scenario.centre_m(cell) for cell in cells])
        self.status = np.full(self.scenario.robots, MOVING)
        self.rewards = np.zeros(self.scenario.robots)
        self.outcome = RUNNING

    def step(self, actions: np.ndarray) -> None:
        """Simulate 2 s.

        Raises:
            FmuError: an FMU failed.
        """
        step = self._system.advance(np.asarray(actions, dtype=np.int64))
        self._seen = step.after
        self._positions_m = step.samples.position[-1, :, :2].copy()
        arrived = self._system.arrived
        self.rewards = np.nan_to_num(step_reward(self.process, step, arrived))
        self.outcome = BY_RANK.index(step.outcome)
        self.status[arrived] = ARRIVED
        lost = failed(step, arrived)
        self.status[lost] = np.where(step.events[lost] == OUT_OF_BOARD, LEFT, HIT)

    def observation(self) -> np.ndarray:
        """(N, features) int64; a robot that left the board seems to be at its edge."""
        cells = np.clip(self._seen.cells, 0, (self.scenario.columns - 1, self.scenario.rows - 1))
        world, _ = on_grid(self.process, self._seen._replace(cells=cells))
        world[:, SIGN] += 1
        return world[:, self._columns]

    def path_length_cm(self) -> np.ndarray:
        """(N,) float64."""
        return 100.0 * self._system.measures.path_length_m

    def positions_m(self) -> np.ndarray:
        """(N, 2) float64."""
        return self._positions_m

    def close(self) -> None:
        """Free the FMU instances."""
        self._system.close()
