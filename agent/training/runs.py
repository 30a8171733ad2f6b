"""Training runs in folders: many seeds of one configuration, checkpoints, going on after a kill.

    experiment.json      configuration of all runs
    training.rrd         mean and scatter over the runs, if there are several
    run_000/policy.npz   trained policy (with policy.json beside it), written last
    run_000/training.npz learning curves (`agent.training.loop.TrainingLog`)
    run_000/training.rrd the same for the Rerun viewer
    run_000/checkpoint.npz   only while the run is going on

One run is `agent.training.worker`, where runs are computed `agent.training.sweep`, the command line
`agent.train`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from agent.moves.model import ObservedMoves
from agent.process.config import ProcessConfig
from agent.process.readings import build_process
from agent.training.loop import TrainingLog
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.recording import write_training
from agent.training.settings import LearningConfig
from agent.training.store import POLICY_FILE, config_digest, load_run, save_run
from agent.training.sweep import Backend, sweep
from agent.training.worker import CHECKPOINT_FILE, PROGRESS_FILE, RunTask, clear_progress, train_run
from cosim.base.errors import UserError
from cosim.base.scenario import Scenario
from cosim.base.storage import replacing

EXPERIMENT_FILE = "experiment.json"
RECORDING_FILE = "training.rrd"


class RunsError(UserError):
    """A folder of runs that cannot be used; the message says what to do instead."""


class Experiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Configuration of a folder of runs that differ only in their seeds."""

    scenario: Scenario
    process: ProcessConfig
    learning: LearningConfig
    seed: int
    runs: int
    moves: ObservedMoves | None = None

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
        seconds: time that it took, since its last checkpoint if there was one; 0 if it was there.
    """

    run: int
    policy: Policy
    log: TrainingLog
    seconds: float


def train_runs(
    experiment: Experiment,
    out: Path,
    *,
    jobs: int = -1,
    backend: Backend = "loky",
    address: str | None = None,
    resume: bool = False,
    checkpoint_episodes: int = 500_000,
) -> Iterator[RunResult]:
    """Train the runs of an experiment and write each to its folder as soon as it is ready.

    Args:
        experiment: what to train.
        out: folder of the experiment, made if it is missing.
        jobs, backend, address: see `agent.training.sweep.sweep`.
        resume: go on with what the folder has; finished runs are only read.
        checkpoint_episodes: episodes between two checkpoints of a run.

    Yields:
        Results in the order of completion, those already there first.

    Raises:
        RunsError: the folder has runs and `resume` is false, or has another configuration.
        ScenarioError: the scenario cannot be used with these readings.
        SweepError: see `agent.training.sweep.sweep`.
        OSError: the folder cannot be written.
    """
    out = out.absolute()
    build_process(experiment.scenario, experiment.process)  # refuse here, not in every worker
    tasks = [
        RunTask(config, run, out, experiment.runs, checkpoint_episodes)
        for run, config in enumerate(experiment.configs())
    ]
    _claim(out, experiment, resume)
    missing: list[RunTask] = []
    for task in tasks:
        found = load_run(task.folder, task.config)
        if found is None:
            task.folder.mkdir(exist_ok=True)
            missing.append(task)
        else:
            yield RunResult(task.run, *found, seconds=0.0)
    clear_progress(out, experiment.runs)
    try:
        for k, result in sweep(train_run, missing, jobs=jobs, backend=backend, address=address):
            task = missing[k]
            policy, log, seconds = result
            facts = {
                "scenario": experiment.scenario.name,
                "seed": experiment.seed,
                "run": task.run,
                "config_digest": config_digest(task.config),
            }
            write_training(task.folder / RECORDING_FILE, policy, log, facts)
            save_run(task.folder, policy, log)
            (task.folder / CHECKPOINT_FILE).unlink(missing_ok=True)
            yield RunResult(task.run, policy, log, seconds)
    finally:
        (out / PROGRESS_FILE).unlink(missing_ok=True)


def policy_paths(out: Path) -> list[Path]:
    """Policies of all finished runs in a folder of runs, in order."""
    return sorted(out.glob(f"run_*/{POLICY_FILE}"))


def _claim(out: Path, experiment: Experiment, resume: bool) -> None:
    """Make the folder this experiment's, or refuse."""
    path = out / EXPERIMENT_FILE
    encoded = msgspec.json.format(msgspec.json.encode(experiment), indent=1) + b"\n"
    if path.exists():
        if not resume:
            raise RunsError(f"{out}: has runs already; add --resume or choose another --out")
        if path.read_bytes() != encoded:
            raise RunsError(
                f"{path}: belongs to another configuration; give the options it was started with "
                "or choose another --out"
            )
        return
    with replacing(path) as temporary:
        temporary.write_bytes(encoded)
