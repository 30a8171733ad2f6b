"""One episode at a time: a batch with one place."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cosim.coupling.parameters import with_motor
from cosim.coupling.rl_step import Step, SupportsAct, decide
from cosim.model.config import CoSimConfig
from cosim.model.outcome import Outcome
from cosim.model.scenario import Cell, Scenario
from cosim.onboard.features import Observation
from cosim.simulation.batch import Batch
from cosim.simulation.episode import RunningEpisode


class CoSimulation(Batch):
    """Robots, motors and floor of one scenario; by default with the default parameters."""

    episode: RunningEpisode

    def __init__(
        self, scenario: Scenario, fmu: Path, config: CoSimConfig | None = None, **how: Any
    ) -> None:
        self.scenario = scenario
        config = with_motor(config or CoSimConfig().sized(scenario.diameter_m), fmu)
        super().__init__(fmu, config, scenario.robots, 1, **how)

    def reset(self, starts: tuple[Cell, ...], seed: np.random.SeedSequence | int) -> Observation:
        seed = np.random.SeedSequence(seed) if isinstance(seed, int) else seed
        self.episode = self.begin(0, self.scenario, starts, seed)
        return self.episode.observation

    def step(self, action: np.ndarray) -> Step:
        return self.advance({0: action})[0]


def run_episode(
    system: CoSimulation,
    policy: SupportsAct,
    starts: tuple[Cell, ...],
    seed: np.random.SeedSequence,
    observe_step: Callable[[Step], None],
) -> Outcome:
    """Run one episode and return its outcome; `observe_step` sees every RL step."""
    observation = system.reset(starts, seed)
    while not system.episode.outcome:
        step = system.step(decide(policy, observation).action)
        observation = step.after
        observe_step(step)
    return system.episode.outcome
