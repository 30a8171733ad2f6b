"""Episodes of a policy from enumerated starts in the co-simulation.

Every start has an index, every index its own noise: an episode is determined by its case and its
index, not by other episodes or their order.
"""

import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from agent.mdp.exact import joint_starts
from agent.mdp.greedy import GreedyPolicy
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of, identity_of
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell
from cosim.recording.series import with_bursts
from cosim.simulation.result import EpisodeResult
from cosim.simulation.simulate import run_facts
from cosim.simulation.tasks import Record, Task, simulate_tasks
from fmus.build import identity_of_fmu

VERSION = 3  # of episodes: raise it when their bits change
# What is drawn from the seed: the order of the starts, and the noise of every one.
_ORDER, _NOISE = 0, 1


@dataclass(frozen=True)
class Case:
    """A policy, in its own scenario, under one configuration of the co-simulation."""

    policy: GreedyPolicy
    config: CoSimConfig
    fmu: Path
    seed: int  # of samples of starts and of the speed noise

    @cached_property
    def starts(self) -> np.ndarray:
        """(K, N, 2) int64, see `agent.mdp.exact.joint_starts`."""
        return joint_starts(self.policy.process)

    def sample(self, count: int) -> list[int]:
        """Return distinct indices of starts in an order drawn with the seed; refuse too many.

        A smaller sample is the beginning of a larger one.
        """
        if count > len(self.starts):
            raise UserError(
                f"scenario {self.policy.config.scenario.name} has only {len(self.starts)} starts, "
                f"not {count}; ask for at most that many"
            )
        return self.rounds(count)

    def rounds(self, count: int) -> list[int]:
        """Return indices that go round all starts, each round in an order of its own.

        Fewer are the beginning of more; every index has noise of its own.
        """
        available, indices = len(self.starts), list[int]()
        for number in range(-(-count // available)):
            key = (_ORDER, number) if number else (_ORDER,)
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))
            indices += (number * available + rng.permutation(available)).tolist()
        return indices[:count]

    @cached_property
    def known(self) -> bool:
        """Whether the policy is known by what it decides, so that its episodes can be kept."""
        return identity_of(self.policy) is not None

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What decides the result of every episode, for people and for the digest."""
        scenario = self.policy.config.scenario
        return {
            "scenario": scenario.name,
            "scenario_digest": scenario.digest(),
            "policy_digest": identity_of(self.policy) or uuid.uuid4().hex,
            "seed": self.seed,
            "motor_fmu_digest": identity_of_fmu(self.fmu),
            "parameters": {name: row["value"] for name, row in self.config.table().items()},
            "version": VERSION,
        }

    @cached_property
    def digest(self) -> str:
        """Hash (16 hex digits) of the identity."""
        return digest_of(self.identity)

    def start_cells(self, index: int) -> tuple[Cell, ...]:
        """Return the start cell of each robot; after the last start they begin again."""
        return tuple((int(x), int(y)) for x, y in self.starts[index % len(self.starts)])

    def noise_seed(self, index: int) -> np.random.SeedSequence:
        """Return the seed of the speed noise of an episode, and of what its world draws."""
        return np.random.SeedSequence(self.seed, spawn_key=(_NOISE, index))


@dataclass(frozen=True)
class Job:
    """An episode to simulate, from the start of an index, and where to record it, if at all."""

    case: Case
    index: int
    recording: Path | None = None

    @property
    def key(self) -> tuple[str, int]:
        """Equal for equal episodes."""
        return self.case.digest, self.index

    def task(self) -> Task:
        """Return what to simulate."""
        case, policy, config, record = self.case, self.case.policy, self.case.config, None
        scenario, starts = policy.config.scenario, case.start_cells(self.index)
        if self.recording is not None:
            config = with_bursts(config, "default")
            facts = run_facts(scenario, case.seed, case.fmu) | {
                "episode": self.index,
                "starts": starts,
                "train_episodes": policy.episodes,
                "method": getattr(policy.config, "method", "other"),
            }
            identity = f"{case.digest}-{self.index}"
            record = Record(self.recording, facts, maps=False, recording_id=identity)
        noise_seed = case.noise_seed(self.index)
        return Task(scenario, case.fmu, config, policy, starts, noise_seed, record)


def run_jobs(
    jobs: Sequence[Job], threads: int, may_begin: Callable[[], bool] = lambda: True
) -> Iterator[tuple[Job, EpisodeResult]]:
    """Simulate episodes; results in the order in which they end, see `cosim.simulation.tasks`."""
    for number, result in simulate_tasks([job.task() for job in jobs], threads, may_begin):
        job = jobs[number]
        name = None if job.recording is None else job.recording.name
        yield job, msgspec.structs.replace(result, recording=name)
