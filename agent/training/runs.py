"""Training runs in folders: many seeds of one configuration, resumed run by run.

    experiment.json      configuration of all runs
    training.rrd         mean and scatter over the runs, if there are several
    run_000/policy.npz   trained policy (with policy.json next to it), written last
    run_000/training.npz learning curves (`agent.training.loop.TrainingLog`)
    run_000/training.rrd the same for the Rerun viewer

Where runs are computed is `cosim.base.backends`, the command `minirobots train`.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from agent.mdp.config import ProcessConfig
from agent.mdp.readings import build_process
from agent.moves.model import ObservedMoves
from agent.training.loop import TrainingLog
from agent.training.policy import Policy, PolicyConfig, Seed, read_policy
from agent.training.recording import write_training
from agent.training.settings import LearningConfig
from agent.training.store import POLICY_FILE, load_run, save_run, train_policy
from cosim.base.backends import sweep
from cosim.base.errors import FileError, UserError
from cosim.base.jobs import PROCESSES, JobKind, Workers, run
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.model.scenario import Scenario

EXPERIMENT_FILE = "experiment.json"
RECORDING_FILE = "training.rrd"


_FILE = Kind("configuration of runs", "choose another --out")


class Experiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Configuration of a folder of runs that differ only in their seeds, kept in the folder."""

    scenario: Scenario
    process: ProcessConfig
    learning: LearningConfig
    seed: int
    runs: int
    moves: ObservedMoves | None = None
    schema_version: int = 1

    def configs(self) -> list[PolicyConfig]:
        """One configuration per run; seeds are spawned from the experiment's seed."""
        sequences = np.random.SeedSequence(self.seed).spawn(self.runs)
        return [
            PolicyConfig(self.scenario, self.process, self.learning, Seed.of(sequence), self.moves)
            for sequence in sequences
        ]


class RunTask(NamedTuple):
    """One run, as a worker gets it.

    Attributes:
        config: of the run.
        run: number of the run in its experiment.
    """

    config: PolicyConfig
    run: int

    @property
    def key(self) -> tuple[str, int]:
        """Equal for equal runs."""
        return digest_of(self.config), self.run


class RunResult(NamedTuple):
    """A finished run.

    Attributes:
        run: its number.
        policy: trained policy.
        log: learning curves.
    """

    run: int
    policy: Policy
    log: TrainingLog


def run_name(run: int) -> str:
    """Name of the folder of a run."""
    return f"run_{run:03d}"


def train_runs(
    experiment: Experiment,
    out: Path,
    *,
    where: Workers = PROCESSES,
    progress: Progress = silent,
    task: str = "training",
) -> list[RunResult]:
    """Train the runs of an experiment and write each to its folder as soon as it is ready.

    Args:
        experiment: what to train.
        out: folder of the experiment, made if it is missing; runs that it has are only read.
        where: backend and number of workers.
        progress: receives how many runs have ended.
        task: what progress calls it.

    Returns:
        All runs in their order.

    Raises:
        UserError: the folder belongs to another configuration, or has runs of another version.
        UserError: the scenario cannot be used with these readings.
        UserError: see `cosim.base.backends.sweep`.
        OSError: the folder cannot be written.
    """
    out = out.absolute()
    build_process(experiment.scenario, experiment.process)  # refuse here, not in every worker
    tasks = [RunTask(config, number) for number, config in enumerate(experiment.configs())]
    _claim(out, experiment, tasks)
    store = _Runs(experiment.seed, out)
    for one in tasks:
        (out / run_name(one.run)).mkdir(exist_ok=True)
    for _ in run(tasks, store, RUNS, where, progress=progress, task=task):
        pass
    return [store.results[number] for number in sorted(store.results)]


def train_run(task: RunTask) -> RunResult:
    """Train one run; in a worker, which may be on another machine."""
    return RunResult(task.run, *train_policy(task.config))


def _trained(
    tasks: Sequence[RunTask], threads: int, may_begin: Callable[[], bool]
) -> Iterator[tuple[RunTask, RunResult]]:
    for k, result in sweep(train_run, tasks, Workers(jobs=threads), may_begin):
        yield tasks[k], result


RUNS: JobKind[RunTask, RunResult] = JobKind(_trained, lambda task: task.key)


class _Runs:
    """Runs in their folders.

    Args:
        seed: of the experiment.
        out: folder of the experiment.

    Attributes:
        results: those that are there, by number.
    """

    def __init__(self, seed: int, out: Path) -> None:
        self._seed, self._out = seed, out
        self.results: dict[int, RunResult] = {}

    def find(self, job: RunTask) -> RunResult | None:
        """Return a run, None if it is missing or damaged."""
        if found := load_run(self._out / run_name(job.run), job.config):
            self.results[job.run] = RunResult(job.run, *found)
        return self.results.get(job.run)

    def keep(self, job: RunTask, row: RunResult) -> None:
        """Write what a run has given to its folder."""
        facts = {
            "scenario": job.config.scenario.name,
            "seed": self._seed,
            "run": job.run,
            "config_digest": digest_of(job.config),
        }
        folder = self._out / run_name(job.run)
        write_training(folder / RECORDING_FILE, row.policy, row.log, facts)
        save_run(folder, row.policy, row.log)
        self.results[job.run] = row


def policy_paths(out: Path) -> list[Path]:
    """Policies of all finished runs in a folder of runs, in order."""
    return sorted(out.glob(f"run_*/{POLICY_FILE}"))


def _claim(out: Path, experiment: Experiment, tasks: Sequence[RunTask]) -> None:
    """Make the folder this experiment's, or refuse; damaged runs are trained again."""
    path = out / EXPERIMENT_FILE
    if not path.exists():
        write_json(path, experiment)
    elif read_json(path, _FILE, Experiment) != experiment:
        raise UserError(
            f"{path}: belongs to another configuration; give the options it was started with or "
            "choose another --out"
        )
    for task in tasks:
        policy = out / run_name(task.run) / POLICY_FILE
        with contextlib.suppress(FileError):
            if policy.exists() and read_policy(policy, ())[0] != task.config:
                raise UserError(
                    f"{policy}: was trained by another version with other results; choose "
                    "another --out to train again"
                )
