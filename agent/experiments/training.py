"""Options and body of `python -m agent.train`: many runs of one configuration."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from agent.process.config import ProcessConfig
from agent.training.settings import Backend, LearningConfig, read_settings
from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train Q-learning agents on the grid: many independent runs, each from a seed of its own.

    Every run gets a folder with its policy, its learning curves and a recording for the Rerun
    viewer; runs are evaluated from every start. The same command with --out goes on after an
    interrupt, and the results are bit-identical to those of a command that was not interrupted.
    """

    scenario: str = "4"
    """Built-in scenario (1a, 1b, 2, 3, 4 of Fig. 5, and 1a-zone to 4-zone, whose zone is forbidden;
    5-corridor, 5-slalom, 5-doorway; 4-cross, 4-ring, 6-swap) or a scenario file (.toml)."""
    runs: int = 1
    """Independent runs (the paper: 20)."""
    seed: int = 0
    """Seed of the experiment; the runs' seeds are spawned from it."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Output folder; by default runs/train-<scenario>-<time>."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Settings file with tables [process] and [learning]; options given here override it."""
    moves: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Moves observed by `python -m agent.moves`: train on them instead of the grid."""
    jobs: Jobs = -1
    backend: Backend = "loky"
    """Where runs are computed: processes or threads here, or a Ray or Dask cluster (extras)."""
    address: str | None = None
    """Address of the cluster's head; without it Ray and Dask start on this machine."""
    checkpoint_episodes: int = 500_000
    """Episodes between two checkpoints of a run."""
    json: Json = False
    process: ProcessConfig = field(default_factory=ProcessConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(1, runs=self.runs, checkpoint_episodes=self.checkpoint_episodes)
        require_at_least(0, seed=self.seed)


def options_of(arguments: list[str]) -> Train:
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
    return parse(Train, "agent.train", arguments, default)


def main() -> None:
    """Command line; see `Train`."""
    options = options_of(sys.argv[1:])
    from agent.evaluation.grid import show
    from agent.experiments.run import new_folder, train_and_evaluate
    from agent.moves.model import ObservedMoves
    from agent.training.runs import Experiment
    from cosim.base.progress import progress_bars
    from cosim.scenarios.file import find_scenario

    scenario = find_scenario(options.scenario)
    moves = options.moves and ObservedMoves.load(options.moves)
    experiment = Experiment(
        scenario, options.process, options.learning, options.seed, options.runs, moves
    )
    out = options.out or new_folder(f"train-{scenario.name}")
    with progress_bars() as progress:
        summary = train_and_evaluate(
            experiment,
            out,
            jobs=options.jobs,
            backend=options.backend,
            address=options.address,
            checkpoint_episodes=options.checkpoint_episodes,
            progress=progress,
        )
    show(summary)
    print(
        f"results in {out}/: summary.json, run_*/policy.npz, training.npz, training.rrd"
        + (", and training.rrd of all runs" if options.runs > 1 else "")
    )
    if options.json:
        print_json(summary)
