"""One episode at a time: a batch with one place."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cosim.base.arguments import validate_argument, validate_seed
from cosim.coupling.parameters import with_motor
from cosim.coupling.rl_step import Step, SupportsAct, decide
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.scenario import Cell, Scenario
from cosim.onboard.features import Observation
from cosim.simulation.batch import Batch, require_size
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.measures import Measures


class CoSimulation:
    """Robots, motors and floor of one scenario, one episode at a time.

    Attributes:
        scenario, config: as given; by default the default parameters, uncalibrated, with robots of
            the scenario's diameter.
        episode: under way, or the last one.
    """

    episode: RunningEpisode

    def __init__(
        self,
        scenario: Scenario,
        motor_fmu: Path,
        config: CoSimConfig | None = None,
        driver: str = "compiled",
        lanes: int | None = None,
    ) -> None:
        self.scenario = scenario
        motor_fmu = validate_argument("motor_fmu", motor_fmu, Path)
        self.config = with_motor(config or CoSimConfig().sized(scenario.diameter_m), motor_fmu)
        require_size(scenario, self.config)
        self._batch = Batch(motor_fmu, self.config, scenario.robots, 1, driver, lanes)

    def compile(self) -> None:
        """Compile the kernels, or load them from the cache, by simulating nothing."""
        self._batch.compile()

    def reset(self, starts: tuple[Cell, ...], seed: np.random.SeedSequence | int) -> Observation:
        """Begin an episode; arguments as of `Batch.begin`, where a seed can be a number."""
        if not isinstance(seed, np.random.SeedSequence):
            seed = np.random.SeedSequence(validate_seed(seed))
        self.episode = self._batch.begin(0, self.scenario, starts, seed, self.config)
        return self.episode.observation

    @property
    def outcome(self) -> Outcome:
        """Of the episode, RUNNING before its end."""
        return self.episode.outcome

    @property
    def time_s(self) -> float:
        """Simulated time in s."""
        return self.episode.time_s

    @property
    def arrived(self) -> np.ndarray:
        """Which robots have reached their targets, shape (N,), bool."""
        return self.episode.arrived

    @property
    def measures(self) -> Measures:
        """Of the episode so far."""
        return self.episode.measures

    @property
    def conflicts(self) -> int:
        """Decisions that the shield changed."""
        return self.episode.conflicts

    def advance(self, action: np.ndarray) -> Step:
        """Simulate one RL step with (N,) directions; a robot under way keeps its own."""
        return self._batch.advance({0: action})[0]

    def close(self) -> None:
        """Free the FMU instances."""
        self._batch.close()


def run_episode(
    system: CoSimulation,
    policy: SupportsAct,
    starts: tuple[Cell, ...],
    seed: np.random.SeedSequence,
    observe_step: Callable[[Step], None],
) -> Outcome:
    """Run one episode and return its outcome; `observe_step` sees every RL step."""
    observation = system.reset(starts, seed)
    while not system.outcome:
        step = system.advance(decide(policy, observation).action)
        observation = step.after
        observe_step(step)
    return system.outcome
