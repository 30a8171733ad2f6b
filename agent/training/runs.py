"""Training runs in folders: many seeds of one configuration, checkpoints, going on after a kill.

    experiment.json      configuration of all runs
    training.rrd         mean and scatter over the runs, if there are several
    run_000/policy.npz   trained policy (with policy.json next to it), written last
    run_000/training.npz learning curves (`agent.training.loop.TrainingLog`)
    run_000/training.rrd the same for the Rerun viewer
    run_000/checkpoint.npz   only while the run is going on

One run is `agent.training.worker`, where runs are computed `cosim.base.backends`, the command
`minirobots train`.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from agent.mdp.config import ProcessConfig
from agent.mdp.greedy import GreedyPolicy
from agent.mdp.readings import build_process
from agent.moves.model import ObservedMoves
from agent.training.loop import TrainingLog
from agent.training.policy import PolicyConfig, Seed
from agent.training.recording import write_training
from agent.training.settings import LearningConfig
from agent.training.store import POLICY_FILE, config_digest, load_run, save_run
from agent.training.worker import (
    CHECKPOINT_FILE,
    PROGRESS_FILE,
    RunTask,
    clear_progress,
    read_progress,
    train_run,
)
from cosim.base.backends import sweep
from cosim.base.errors import UserError
from cosim.base.jobs import PROCESSES, JobKind, Workers, run
from cosim.base.progress import Progress, silent
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.model.scenario import Scenario

EXPERIMENT_FILE = "experiment.json"
RECORDING_FILE = "training.rrd"

_POLL_S = 0.2


class RunsError(UserError):
    """Invalid folder of runs. The message names the folder and how to fix it."""


_FILE = Kind("configuration of runs", "choose another --out", RunsError)


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


class RunResult(NamedTuple):
    """A finished run.

    Attributes:
        run: its number.
        policy: trained policy.
        log: learning curves.
    """

    run: int
    policy: GreedyPolicy
    log: TrainingLog


def train_runs(
    experiment: Experiment,
    out: Path,
    *,
    where: Workers = PROCESSES,
    checkpoint_episodes: int = 500_000,
    progress: Progress = silent,
    task: str = "training",
) -> list[RunResult]:
    """Train the runs of an experiment and write each to its folder as soon as it is ready.

    Args:
        experiment: what to train.
        out: folder of the experiment, made if it is missing; runs that it has are only read, or
            gone on with from their checkpoints.
        where: backend and number of workers.
        checkpoint_episodes: episodes between two checkpoints of a run.
        progress: receives the episodes of all runs together, mean success and exploration.
        task: what progress calls it.

    Returns:
        All runs in their order.

    Raises:
        RunsError: the folder belongs to another configuration.
        ScenarioError: the scenario cannot be used with these readings.
        BackendError: see `cosim.base.backends.sweep`.
        OSError: the folder cannot be written.
    """
    out = out.absolute()
    build_process(experiment.scenario, experiment.process)  # refuse here, not in every worker
    tasks = [
        RunTask(config, number, out, experiment.runs, checkpoint_episodes)
        for number, config in enumerate(experiment.configs())
    ]
    _claim(out, experiment)
    store = _Runs(experiment.seed)
    for one in tasks:
        one.folder.mkdir(exist_ok=True)
    clear_progress(out, experiment.runs)
    try:
        with _watched(experiment, out, store.results, progress, task):
            for _ in run(tasks, store, RUNS, where):
                pass
    finally:
        (out / PROGRESS_FILE).unlink(missing_ok=True)
    return [store.results[number] for number in sorted(store.results)]


def _trained(
    tasks: Sequence[RunTask], threads: int, may_begin: Callable[[], bool]
) -> Iterator[tuple[RunTask, RunResult]]:
    for k, (policy, log) in sweep(train_run, tasks, Workers(jobs=threads), may_begin):
        yield tasks[k], RunResult(tasks[k].run, policy, log)


RUNS: JobKind[RunTask, RunResult] = JobKind(_trained, lambda task: task.key)


class _Runs:
    """Runs in their folders.

    Args:
        seed: of the experiment.

    Attributes:
        results: those that are there, by number.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self.results: dict[int, RunResult] = {}

    def find(self, job: RunTask) -> RunResult | None:
        """Return a run, None if it is missing or damaged."""
        if found := load_run(job.folder, job.config):
            self.results[job.run] = RunResult(job.run, *found)
        return self.results.get(job.run)

    def keep(self, job: RunTask, row: RunResult) -> None:
        """Write what a run has given to its folder."""
        facts = {
            "scenario": job.config.scenario.name,
            "seed": self._seed,
            "run": job.run,
            "config_digest": config_digest(job.config),
        }
        write_training(job.folder / RECORDING_FILE, row.policy, row.log, facts)
        save_run(job.folder, row.policy, row.log)
        (job.folder / CHECKPOINT_FILE).unlink(missing_ok=True)
        self.results[job.run] = row


@contextlib.contextmanager
def _watched(
    experiment: Experiment,
    out: Path,
    finished: Mapping[int, RunResult],
    progress: Progress,
    task: str,
) -> Iterator[None]:
    """Report the progress of all runs while the body computes them."""
    episodes = experiment.learning.episodes
    over = threading.Event()

    def report() -> None:
        rows = read_progress(out)
        going = [row for run, row in enumerate(rows) if run not in finished and row[0] > 0]
        done = len(finished) * episodes + sum(row[0] for row in going)
        state = f"{len(finished)}/{experiment.runs} runs"
        if going:
            success, epsilon = np.mean(going, axis=0)[2:]
            state += f"  success {success:.1%}  ε {epsilon:.3f}"
        progress(task, done, experiment.runs * episodes, state)

    def watch() -> None:
        while not over.wait(_POLL_S):
            report()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        report()


def policy_paths(out: Path) -> list[Path]:
    """Policies of all finished runs in a folder of runs, in order."""
    return sorted(out.glob(f"run_*/{POLICY_FILE}"))


def _claim(out: Path, experiment: Experiment) -> None:
    """Make the folder this experiment's, or refuse."""
    path = out / EXPERIMENT_FILE
    if not path.exists():
        write_json(path, experiment)
    elif read_json(path, _FILE, Experiment) != experiment:
        raise RunsError(
            f"{path}: belongs to another configuration; give the options it was started with or "
            "choose another --out"
        )
