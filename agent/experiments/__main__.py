"""`python -m agent.experiments`: run a learning experiment and evaluate every run exactly."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agent.experiments.variants import Name
from agent.training.settings import LearningConfig
from cosim.base.command import Json, parse, print_json, require_at_least
from cosim.base.errors import run_command
from cosim.base.jobs import PROCESSES, Workers


@dataclass(frozen=True, kw_only=True)
class Experiments:
    """Run a learning experiment of the paper over many seeds and evaluate every run.

    fig08: one robot, scenarios 1a and 1b. fig10: the coefficient c. fig11: pairs, scenarios 2, 3
    and 4. features: which of x, y, d, g (and the bearing b) a robot needs. readings: what each
    assumed reading of the paper changes. zone: scenarios 1a to 4 with the central zone open and
    forbidden. factorial: c under every combination of zone, target obstacle, η and ε in scenarios 2
    to 4, 192 variants; choose fewer --episodes. sequel: groups of four and six robots, by
    Q-learning and double Q-learning. The same command with --out continues after an interrupt. Draw
    the figures with python -m analysis.figures.
    """

    experiment: Annotated[Name, tyro.conf.Positional]
    """Experiment to run."""
    runs: int = 20
    """Independent runs of each variant (the paper: 20)."""
    seed: int = 0
    """Seed that the runs' seeds are spawned from, the same for all variants."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Output folder; by default runs/<experiment>-<time>."""
    episodes: int = LearningConfig().episodes
    """Training episodes of a run (Section V: 5 000 000)."""
    where: Annotated[Workers, tyro.conf.OmitArgPrefixes] = PROCESSES
    json: Json = False

    def __post_init__(self) -> None:
        require_at_least(1, runs=self.runs, episodes=self.episodes)
        require_at_least(0, seed=self.seed)


def main() -> None:
    """Command line; see `Experiments`."""
    options = parse(Experiments, "agent.experiments")

    from agent.experiments.results import show
    from agent.experiments.run import new_folder, run_experiment
    from cosim.base.progress import progress_bars

    with progress_bars() as progress:
        result = run_experiment(
            options.experiment,
            options.out or new_folder(options.experiment),
            runs=options.runs,
            seed=options.seed,
            episodes=options.episodes,
            where=options.where,
            progress=progress,
        )
    show(result)
    if options.json:
        print_json(result)


if __name__ == "__main__":
    run_command(main)
