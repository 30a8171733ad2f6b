"""Train many runs of one configuration and evaluate them."""

from collections.abc import Iterator
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import tyro

from agent.mdp.config import ProcessConfig
from agent.training.settings import LearningConfig, read_settings
from cosim.base.jobs import PROCESSES, Workers
from cosim.base.progress import Progress
from minirobots.options import Count, File, NewFolder, ScenarioName, Seed


class Train(NewFolder):
    """Train Q-learning agents on the grid: many independent runs, each with its own seed.

    Every run gets a folder with its policy, its learning curves and a recording for the Rerun
    viewer; runs are evaluated from every start. The same command with --out continues after an
    interrupt, and the results are bit-identical to those of a command that was not interrupted.
    """

    prefix: ClassVar[str] = "train-"

    scenario: ScenarioName = "4"
    runs: Count = 1
    """Independent runs (the paper: 20)."""
    seed: Seed = 0
    config: File | None = None
    """Settings file with tables [process] and [learning]; options given here override it."""
    moves: File | None = None
    """Moves observed by `minirobots moves`: train on them instead of the grid."""
    where: Annotated[Workers, tyro.conf.OmitArgPrefixes] = PROCESSES
    log: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of event files for TensorBoard, with a folder for each run; by default none. It needs
    the extra log."""
    process: ProcessConfig = field(default_factory=ProcessConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)

    @classmethod
    def defaults(cls, arguments: list[str]) -> Self | None:
        """Return the values of the settings file, which the command line overrides."""
        config = None
        for k, argument in enumerate(arguments):
            name, _, value = argument.partition("=")
            if name == "--config":
                config = value or (arguments[k + 1] if k + 1 < len(arguments) else None)
        if config is None:
            return None
        process, learning = read_settings(Path(config))
        return cls(config=Path(config), process=process, learning=learning)


def run(options: Train, progress: Progress) -> Iterator[Any]:
    """Train missing runs, evaluate every run, and print a row for each."""
    from agent.experiments.run import train_and_evaluate
    from agent.moves.model import ObservedMoves
    from agent.study.grid import show
    from agent.training.runs import Experiment
    from cosim.model.scenario_file import find_scenario

    moves = options.moves and ObservedMoves.load(options.moves)
    experiment = Experiment(
        find_scenario(options.scenario),
        options.process,
        options.learning,
        options.seed,
        options.runs,
        moves,
    )
    summary = train_and_evaluate(
        experiment,
        options.folder,
        where=options.where,
        log=options.log,
        progress=progress,
    )
    yield summary
    show(summary)
    print(
        f"results in {options.folder}/: summary.json, run_*/policy.npz, training.npz, training.rrd"
        + (", and training.rrd of all runs" if options.runs > 1 else "")
    )
