"""The paper's learning experiments."""

from collections.abc import Iterator
from typing import Annotated, Any

import tyro

from agent.experiments.variants import Name
from agent.training.settings import LearningConfig
from cosim.base.jobs import PROCESSES, Workers
from cosim.base.progress import Progress
from minirobots.options import Count, NewFolder, Seed


class Experiments(NewFolder):
    """Run a learning experiment of the paper over many seeds and evaluate every run.

    fig08: one robot, scenarios 1a and 1b. fig10: the coefficient c. fig11: pairs, scenarios 2, 3
    and 4. features: which of x, y, d, g (and the bearing b) a robot needs. readings: the effect of
    each assumed interpretation of the paper. zone: scenarios 1a to 4 with the central zone open and
    forbidden. factorial: c under every combination of zone, target obstacle, η and ε in scenarios 2
    to 4, 192 variants; choose fewer --episodes. sequel: groups of four and six robots, by
    Q-learning and double Q-learning. The same command with --out continues after an interrupt. Draw
    the figures with `minirobots figures`.
    """

    experiment: Annotated[Name, tyro.conf.Positional]
    """Experiment to run."""
    runs: Count = 20
    """Independent runs of each variant (the paper: 20)."""
    seed: Seed = 0
    episodes: Count = LearningConfig().episodes
    """Training episodes of a run (Section V: 5 000 000)."""
    where: Annotated[Workers, tyro.conf.OmitArgPrefixes] = PROCESSES

    @property
    def subject(self) -> str:
        """Return what the results are of."""
        return self.experiment


def run(options: Experiments, progress: Progress) -> Iterator[Any]:
    """Train missing runs, evaluate every run and print the variants."""
    from agent.experiments.results import show
    from agent.experiments.run import run_experiment

    arguments = options.arguments("experiment", out=options.folder, progress=progress)
    result = run_experiment(options.experiment, **arguments)
    yield result
    show(result)
