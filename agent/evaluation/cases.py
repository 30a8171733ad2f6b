"""Episodes of a policy from enumerated starts in the co-simulation.

Every start has an index, every index its own noise: an episode is determined by its case and its
index, not by other episodes or their order. Results are kept by `agent.study.store`, statistics
are `agent.evaluation.outcomes`, the command lines `minirobots evaluate` and `minirobots transfer`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from agent.mdp.exact import joint_starts
from agent.mdp.greedy import GreedyPolicy
from agent.policies import method_name
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.series import with_bursts
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.result import EpisodeResult
from cosim.simulation.simulate import episode_facts
from cosim.simulation.tasks import Task, recorder_of, simulate_tasks
from fmus.build import identity_of_fmu

VERSION = 1  # of episodes: raise it when their bits change
# What is drawn from the seed: the order of the starts, and the noise of every one.
_ORDER, _NOISE = 0, 1


class CaseIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides the results of a case, for people and for its digest."""

    scenario: str
    scenario_digest: str
    policy_digest: str
    seed: int
    motor_fmu_digest: str
    parameters: dict[str, float | bool | str | list[Any]]
    version: int


@dataclass(frozen=True)
class Case:
    """A policy under one configuration of the co-simulation.

    Attributes:
        policy: acts; its scenario is the one simulated.
        config: of the co-simulation.
        fmu: motor FMU file.
        seed: of samples of starts and of the speed noise.
    """

    policy: GreedyPolicy
    config: CoSimConfig
    fmu: Path
    seed: int

    @cached_property
    def starts(self) -> np.ndarray:
        """(K, N, 2) int64, see `agent.mdp.exact.joint_starts`."""
        return joint_starts(self.policy.process)

    def sample(self, count: int) -> list[int]:
        """Distinct indices of starts in an order drawn with the seed.

        A smaller sample is the beginning of a larger one, and whatever was simulated of a sample
        is a sample itself.

        Args:
            count: how many.

        Raises:
            UserError: there are fewer.
        """
        available = len(self.starts)
        if count > available:
            raise UserError(
                f"scenario {self.policy.config.scenario.name} has only {available} starts, "
                f"not {count}; ask for at most that many"
            )
        return self._order()[:count]

    def rounds(self, count: int) -> list[int]:
        """Indices that go round all starts, again and again, each with noise of its own.

        Every round has an order of its own; the first one is that of `sample`.

        Args:
            count: how many; the beginning of any larger number.
        """
        available = len(self.starts)
        numbers = range(-(-count // available))
        return [k * available + index for k in numbers for index in self._order(k)][:count]

    def _order(self, number: int = 0) -> list[int]:
        key = (_ORDER, number) if number else (_ORDER,)
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))
        return rng.permutation(len(self.starts)).tolist()

    @cached_property
    def identity(self) -> CaseIdentity:
        """Return what decides the result of every episode."""
        policy = self.policy
        return CaseIdentity(
            scenario=policy.config.scenario.name,
            scenario_digest=policy.config.scenario.digest(),
            policy_digest=policy.digest(),
            seed=self.seed,
            motor_fmu_digest=identity_of_fmu(self.fmu),
            parameters={name: row["value"] for name, row in self.config.table().items()},
            version=VERSION,
        )

    @cached_property
    def digest(self) -> str:
        """Hash (16 hex digits) of the identity."""
        return digest_of(self.identity)

    def start_cells(self, index: int) -> tuple[Cell, ...]:
        """Start cell of each robot; beyond the last start they begin again, see `rounds`."""
        return tuple((int(x), int(y)) for x, y in self.starts[index % len(self.starts)])

    def noise_seed(self, index: int) -> np.random.SeedSequence:
        """Seed of the speed noise of an episode, and of what its world draws."""
        return np.random.SeedSequence(self.seed, spawn_key=(_NOISE, index))

    def recorder(self, path: Path, index: int, episode: RunningEpisode) -> EpisodeRecorder:
        """Recorder of the episode from a start."""
        scenario = self.policy.config.scenario
        facts = episode_facts(scenario, self.seed, self.fmu, index, self.start_cells(index))
        facts |= {"train_episodes": self.policy.episodes, "method": method_name(self.policy)}
        return recorder_of(episode, path, f"{self.digest}-{index}", facts)


@dataclass(frozen=True)
class Job:
    """An episode to simulate.

    Attributes:
        case: policy and configuration.
        index: of the start.
        recording: where to record it, if at all.
    """

    case: Case
    index: int
    recording: Path | None = None

    @property
    def key(self) -> tuple[str, int]:
        """Equal for equal episodes."""
        return self.case.digest, self.index

    def task(self) -> Task:
        """Return what to simulate."""
        case, path, config = self.case, self.recording, self.case.config
        return Task(
            case.policy.config.scenario,
            case.fmu,
            config if path is None else with_bursts(config, "default"),
            case.policy,
            case.start_cells(self.index),
            case.noise_seed(self.index),
            None if path is None else lambda episode: case.recorder(path, self.index, episode),
        )


def run_jobs(
    jobs: Sequence[Job], threads: int, may_begin: Callable[[], bool] = lambda: True
) -> Iterator[tuple[Job, EpisodeResult]]:
    """Simulate episodes; results in the order in which they end, see `cosim.simulation.tasks`."""
    for number, result in simulate_tasks([job.task() for job in jobs], threads, may_begin):
        job = jobs[number]
        name = None if job.recording is None else job.recording.name
        yield job, msgspec.structs.replace(result, recording=name)
