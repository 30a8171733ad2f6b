"""One training run as a worker computes it: its task, its checkpoint, its progress.

Workers may be other processes or machines; folders of runs and what is written into them at the
end are in `agent.training.runs`, the learning itself is in `agent.training.loop`.
"""

import logging
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agent.training.learning import TrainingState
from agent.training.loop import (
    TrainingLog,
    TrainingProgress,
    fresh_state,
    run_training,
    training_log,
)
from agent.training.pair_policy import trained_policy
from agent.training.policy import PolicyConfig
from agent.training.store import Trained, config_digest
from cosim.base.errors import UserError
from cosim.base.reading import Kind, parsing, read_arrays
from cosim.base.storage import replacing

CHECKPOINT_FILE = "checkpoint.npz"
PROGRESS_FILE = ".progress"

_ARRAYS = tuple(f.name for f in fields(TrainingState) if f.type is np.ndarray)
_LOGGER = logging.getLogger(__name__)
_NUMBERS = ("episode", "agent_steps")


class CheckpointError(UserError):
    """Invalid checkpoint."""


_FILE = Kind("checkpoint", "train from the start", CheckpointError)


def run_name(run: int) -> str:
    """Name of the folder of a run."""
    return f"run_{run:03d}"


class RunTask(NamedTuple):
    """One run, as a worker gets it.

    Attributes:
        config: of the run.
        run: number of the run in its experiment.
        out: folder of the experiment.
        runs: number of runs in the experiment.
        checkpoint_episodes: episodes between two checkpoints.
    """

    config: PolicyConfig
    run: int
    out: Path
    runs: int
    checkpoint_episodes: int

    @property
    def key(self) -> tuple[str, int]:
        """Equal for equal runs."""
        return config_digest(self.config), self.run

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.out / run_name(self.run)


def train_run(task: RunTask) -> tuple[Trained, TrainingLog]:
    """Train one run, from its checkpoint if it has one.

    A worker on another machine may not see the experiment's folder: then it keeps no checkpoints
    and shows no progress, and the result is the same.
    """
    config = task.config
    state = fresh_state(config)
    shared = task.folder.is_dir()
    checkpoint_path = task.folder / CHECKPOINT_FILE
    if shared:
        state = load_checkpoint(checkpoint_path, config, state) or state
    run_training(
        config,
        state,
        progress=_progress_writer(task) if shared else None,
        checkpoint=(lambda s: save_checkpoint(checkpoint_path, config, s)) if shared else None,
        checkpoint_episodes=task.checkpoint_episodes,
    )
    log = training_log(config.learning, state, config.scenario.cell_m)
    return trained_policy(config, state), log


def save_checkpoint(path: Path, config: PolicyConfig, state: TrainingState) -> None:
    """Write a training state, whole or not at all."""
    numbers = {name: getattr(state, name) for name in _NUMBERS}
    arrays = {name: getattr(state, name) for name in _ARRAYS}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, config=config_digest(config), **numbers, **arrays)


def load_checkpoint(path: Path, config: PolicyConfig, fresh: TrainingState) -> TrainingState | None:
    """Read a training state; None if there is none of this configuration, or it is damaged.

    Args:
        path: of the checkpoint.
        config: of the run.
        fresh: the run's initial state; the checkpoint must have its shapes.
    """
    try:
        arrays = read_arrays(path, _FILE, (*_ARRAYS, *_NUMBERS, "config"))
        with parsing(path, _FILE):
            known = str(arrays.pop("config")) == config_digest(config)
            numbers: dict[str, Any] = {name: int(arrays.pop(name)) for name in _NUMBERS}
    except CheckpointError as error:
        if path.exists():
            _LOGGER.warning("%s", error)
        return None
    fits = all(
        (a.shape, a.dtype) == (getattr(fresh, n).shape, getattr(fresh, n).dtype)
        for n, a in arrays.items()
    )
    return TrainingState(**arrays, **numbers) if known and fits else None


def _progress_writer(task: RunTask) -> Callable[[TrainingProgress], None]:
    """Puts a run's progress where `read_progress` of another process finds it."""
    rows = np.memmap(
        task.out / PROGRESS_FILE,
        dtype=float,
        mode="r+",
        shape=(task.runs, len(TrainingProgress._fields)),
    )

    def write(progress: TrainingProgress) -> None:
        rows[task.run] = progress

    return write


def clear_progress(out: Path, runs: int) -> None:
    """Make the file that workers write their progress to."""
    (out / PROGRESS_FILE).write_bytes(np.zeros((runs, len(TrainingProgress._fields))).tobytes())


def read_progress(out: Path) -> np.ndarray:
    """(runs, 4) float64, the last `TrainingProgress` of every run; empty if none is going on."""
    try:
        return np.fromfile(out / PROGRESS_FILE).reshape(-1, len(TrainingProgress._fields))
    except (OSError, ValueError):  # ValueError: it is being made
        return np.empty((0, len(TrainingProgress._fields)))
