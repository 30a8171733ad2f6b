"""Episodes of a policy from enumerated starts in the co-simulation, in threads.

Every start has an index, every index its own noise: an episode is determined by its case and its
index, whatever else runs, in whatever order. Results are kept by `agent.evaluation.result_file`,
statistics are `agent.evaluation.outcomes`, the command lines `cosim.evaluate` and `cosim.transfer`.
"""

import itertools
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from agent.process.exact import all_starts
from agent.training.policy import Policy
from cosim.base.config import CoSimConfig
from cosim.base.errors import UserError
from cosim.base.provenance import ROOT, code_digest, digest_of, with_imports
from cosim.base.scenario import Cell
from cosim.navigation.batch import CoSimulation
from cosim.navigation.episode import Step
from cosim.recording.episode import EpisodeRecorder
from cosim.simulation import EpisodeResult, episode_facts, simulate_episode

# What is drawn from the seed: the order of the starts, and the noise of every one.
_ORDER, _NOISE = 0, 1


class CaseIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides the results of a case, for people and for its digest."""

    scenario: str
    scenario_digest: str
    policy_digest: str
    seed: int
    motor_fmu_digest: str
    parameters: dict[str, float | bool | str]
    code_digest: str


@dataclass(frozen=True)
class Case:
    """A policy under one configuration of the co-simulation.

    Attributes:
        policy: acts; its scenario is the one simulated.
        config: of the co-simulation.
        fmu: motor FMU file.
        seed: of samples of starts and of the speed noise.
    """

    policy: Policy
    config: CoSimConfig
    fmu: Path
    seed: int

    @cached_property
    def starts(self) -> np.ndarray:
        """(K, N, 2) int64, all combinations of start cells in which no robots touch.

        Raises:
            UserError: there are too many.
        """
        return all_starts(self.policy.process)

    def sample(self, count: int | None) -> list[int]:
        """Indices of distinct starts in an order drawn with the seed.

        A smaller sample is the beginning of a larger one, and whatever was simulated of a sample
        is a sample itself.

        Args:
            count: how many; None for all.

        Raises:
            UserError: there are not so many.
        """
        available = len(self.starts)
        if count is not None and count > available:
            raise UserError(
                f"scenario {self.policy.config.scenario.name} has only {available} starts, "
                f"not {count}; ask for at most that many, or for all"
            )
        sequence = np.random.SeedSequence(self.seed, spawn_key=(_ORDER,))
        order = np.random.default_rng(sequence).permutation(available)
        return [int(index) for index in order[:count]]

    @cached_property
    def identity(self) -> CaseIdentity:
        """What decides the result of every episode."""
        policy = self.policy
        # what is recorded of an episode does not change it
        records = [ROOT / "cosim" / folder / "episode.py" for folder in ("recording", "reading")]
        return CaseIdentity(
            scenario=policy.config.scenario.name,
            scenario_digest=policy.config.scenario.digest(),
            policy_digest=digest_of(policy.config.process, policy.values),
            seed=self.seed,
            motor_fmu_digest=digest_of(self.fmu),
            parameters={name: row["value"] for name, row in self.config.table().items()},
            code_digest=code_digest(with_imports([Path(__file__)], but=records)),
        )

    @cached_property
    def digest(self) -> str:
        """Hash (16 hex digits) of the identity."""
        return digest_of(self.identity)

    def start_cells(self, index: int) -> tuple[Cell, ...]:
        """Start cell of each robot."""
        return tuple((int(x), int(y)) for x, y in self.starts[index])

    def system(self) -> CoSimulation:
        """A co-simulation for any number of episodes, one after the other."""
        return CoSimulation(self.policy.config.scenario, self.fmu, self.config)

    def recorder(self, path: Path, index: int) -> EpisodeRecorder:
        """Recorder of the episode from a start."""
        scenario = self.policy.config.scenario
        facts = episode_facts(scenario, self.seed, self.fmu, index, self.start_cells(index))
        facts["train_episodes"] = self.policy.episodes
        return EpisodeRecorder(path, scenario, self.config, f"{self.digest}-{index}", facts)


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

    def run(self, system: CoSimulation, stop: threading.Event) -> EpisodeResult:
        """Simulate it, until `stop` is set.

        Raises:
            UserError: of the FMU or the recording.
            KeyboardInterrupt: it was stopped.
        """

        def watch(_: Step) -> None:
            if stop.is_set():
                raise KeyboardInterrupt

        sequence = np.random.SeedSequence(self.case.seed, spawn_key=(_NOISE, self.index))
        arguments = (system, self.case.policy, self.case.start_cells(self.index), sequence)
        if self.recording is None:
            return simulate_episode(*arguments, watch=watch)
        with self.case.recorder(self.recording, self.index) as recorder:
            result = simulate_episode(*arguments, recorder, watch)
        return msgspec.structs.replace(result, recording=self.recording.name)


def run_jobs(jobs: Iterable[Job], threads: int) -> Iterator[tuple[Job, EpisodeResult]]:
    """Simulate episodes in threads; results in the order in which they end.

    Compiled code runs without the interpreter lock, so threads share the work without sharing
    anything else. A job is taken from `jobs` when a thread is free for it. On an interrupt, an
    error, or when the iterator is closed, running episodes end after their RL step, without result.

    Args:
        jobs: may be endless, or look at the results so far.
        threads: episodes at the same time.

    Raises:
        UserError: of an FMU or a recording.
    """
    stop = threading.Event()
    own = threading.local()

    def run(job: Job) -> tuple[Job, EpisodeResult]:
        if getattr(own, "case", None) is not job.case:
            own.case, own.system = job.case, job.case.system()
        return job, job.run(own.system, stop)

    waiting = iter(jobs)
    with ThreadPoolExecutor(threads) as pool:
        running: set[Future[tuple[Job, EpisodeResult]]] = set()
        try:
            running |= {pool.submit(run, job) for job in itertools.islice(waiting, threads)}
            while running:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                # before the results are dealt with, so that no thread waits for that
                running |= {pool.submit(run, job) for job in itertools.islice(waiting, len(done))}
                for future in done:
                    yield future.result()
        finally:
            stop.set()
