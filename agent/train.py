"""`python -m agent.train`: train many runs, with checkpoints, and evaluate every one exactly."""

import contextlib
import json
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from agent.evaluation.grid import report_of, show
from agent.moves.model import ObservedMoves
from agent.process.config import ProcessConfig
from agent.training.recording import write_runs
from agent.training.runs import RECORDING_FILE, Experiment, RunResult, train_runs
from agent.training.settings import LearningConfig, read_settings
from agent.training.store import POLICY_FILE
from agent.training.sweep import Backend
from agent.training.worker import read_progress
from cosim.base.errors import UserError, run_command
from cosim.base.scenario import find_scenario
from cosim.base.storage import replacing

_POLL_S = 0.2


@dataclass(frozen=True)
class Train:
    """Train Q-learning agents on the grid: many independent runs, each from a seed of its own.

    Every run gets a folder with its policy, its learning curves and a recording for the Rerun
    viewer; runs are evaluated from every start. A killed command goes on with --resume, and the
    results are bit-identical to those of a command that was not killed.
    """

    scenario: str = "4"
    """Built-in scenario of Fig. 5 (1a, 1b, 2, 3, 4) or a scenario file (.toml)."""
    runs: int = 1
    """Independent runs (the paper: 20)."""
    seed: int = 0
    """Seed of the experiment; the runs' seeds are spawned from it."""
    out: Path | None = None
    """Output folder; by default runs/train-<scenario>-<time>."""
    config: Path | None = None
    """Settings file with tables [process] and [learning]; options given here override it."""
    moves: Path | None = None
    """Moves observed by `python -m agent.moves`: train on them instead of the grid."""
    jobs: int = -1
    """Runs at once; -1 for one per core."""
    backend: Backend = "loky"
    """Where runs are computed: processes or threads here, or a Ray or Dask cluster (extras)."""
    address: str | None = None
    """Address of the cluster's head; without it Ray and Dask start on this machine."""
    resume: bool = False
    """Go on with the runs of --out, from their checkpoints."""
    checkpoint_episodes: int = 500_000
    """Episodes between two checkpoints of a run."""
    json: bool = False
    """Print a JSON object as the last line of output."""
    process: ProcessConfig = field(default_factory=ProcessConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)

    def __post_init__(self) -> None:
        if self.runs < 1 or self.checkpoint_episodes < 1 or self.jobs == 0:
            raise UserError("--runs, --checkpoint-episodes and --jobs must be at least 1 (or -1)")


def train(options: Train, console: Console) -> dict[str, Any]:
    """Train all runs, evaluate them and write `summary.json`, which is also returned.

    Raises:
        UserError: see its message.
    """
    scenario = find_scenario(options.scenario)
    moves = options.moves and ObservedMoves.load(options.moves)
    experiment = Experiment(
        scenario, options.process, options.learning, options.seed, options.runs, moves
    )
    name = f"train-{scenario.name}-{datetime.now():%Y%m%d-%H%M%S}"
    out = options.out or Path("runs") / name
    results: list[RunResult] = []
    began = time.perf_counter()
    with progress_bar(out, experiment, results, console, label=f"scenario {scenario.name}"):
        for result in train_runs(
            experiment,
            out,
            jobs=options.jobs,
            backend=options.backend,
            address=options.address,
            resume=options.resume,
            checkpoint_episodes=options.checkpoint_episodes,
        ):
            results.append(result)  # noqa: PERF402 - the bar looks at the list meanwhile
    results.sort(key=lambda result: result.run)
    seconds = time.perf_counter() - began
    summary = report_of((f"run_{r.run:03d}/{POLICY_FILE}", r.policy) for r in results)
    summary |= {"seed": options.seed, "seconds": seconds, "out": str(out)}
    if options.runs > 1:
        facts = {"scenario": scenario.name, "seed": options.seed}
        write_runs(out / RECORDING_FILE, [result.log for result in results], facts)
    with replacing(out / "summary.json") as temporary:
        temporary.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return summary


@contextlib.contextmanager
def progress_bar(
    out: Path,
    experiment: Experiment,
    results: list[RunResult],
    console: Console,
    *,
    label: str = "training",
) -> Iterator[None]:
    """A bar over all runs with mean success and exploration; none without a terminal.

    Args:
        out: folder of the runs, whose workers' progress is shown.
        experiment: what is trained.
        results: finished runs, as the caller collects them.
        console: to draw on.
        label: what the bar is called.
    """
    total = experiment.runs * experiment.learning.episodes
    bar = Progress(
        TextColumn("[progress.description]{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[state]}"),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )
    task = bar.add_task(label, total=total, state="")
    finished = threading.Event()

    def poll() -> None:
        while not finished.wait(_POLL_S):
            done = {result.run for result in results}
            rows = read_progress(out)
            going = [row for k, row in enumerate(rows) if k not in done and row[0] > 0]
            episodes = len(done) * experiment.learning.episodes + sum(row[0] for row in going)
            state = f"{len(done)}/{experiment.runs} runs"
            if going:
                success, epsilon = np.mean(going, axis=0)[2:]
                state += f"  success {success:.1%}  ε {epsilon:.3f}"
            bar.update(task, completed=episodes, state=state)

    with bar:
        thread = threading.Thread(target=poll, daemon=True)
        thread.start()
        try:
            yield
        finally:
            finished.set()
            thread.join()


def parse(arguments: list[str]) -> Train:
    """Command line over settings file over defaults.

    Raises:
        UserError: a value cannot be used.
    """
    config = None
    for k, argument in enumerate(arguments):
        name, _, value = argument.partition("=")
        if name == "--config":
            config = value or (arguments[k + 1] if k + 1 < len(arguments) else None)
    default = Train()
    if config is not None:
        process, learning = read_settings(Path(config))
        default = Train(config=Path(config), process=process, learning=learning)
    return tyro.cli(
        Train,
        prog="python -m agent.train",
        args=arguments,
        default=default,
        config=(tyro.conf.FlagCreatePairsOff,),
    )


def main() -> None:
    """Command line; see `Train`."""
    options = parse(sys.argv[1:])
    summary = train(options, Console(stderr=True))
    show(summary, Console())
    print(
        f"results in {summary['out']}/: summary.json, run_*/policy.npz, training.npz, training.rrd"
        + (", and training.rrd of all runs" if options.runs > 1 else "")
    )
    if options.json:
        print(json.dumps(summary))


if __name__ == "__main__":
    run_command(main)
