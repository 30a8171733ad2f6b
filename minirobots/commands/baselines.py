"""Compare what learners achieve on the same boards, and their cost."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from agent.baselines import LEARNERS, NETWORKS, Learner
from cosim.base.errors import UserError
from cosim.base.progress import Progress
from minirobots.options import BudgetMinutes, Count, Distributed, Folder, Resumable

_SCENARIOS = ("1b", "2", "3", "4", "4-cross")
_LAST_SEED = 4_000_000_000


class Baselines(Distributed, Resumable):
    """Compare learners on the same boards: success, paths and times over the optimum, and effort.

    Tables by the paper's Q-learning and by double Q-learning, on observed moves (moves, pair),
    computed optima (shortest, fastest), and networks (ddqn, ippo, mappo; they need the extra
    deep). Every training and every episode is kept when it ends: the same command resumes, and
    --budget-minutes 0 only writes the table of existing results.
    """

    out: Folder = Path("runs/baselines")
    """Folder of the table (baselines.json, baselines.md), trainings, policies and episodes."""
    quick: bool = False
    """Short trial: little training, by default with one seed in the first two scenarios."""
    scenarios: tuple[str, ...] | None = None
    """Built-in scenarios or scenario files (.toml), by default 1b, 2, 3, 4 and 4-cross."""
    learners: tuple[Learner, ...] = LEARNERS
    """Learners to compare, all by default."""
    seed: int = 0
    """First seed of training, of samples of starts and of random draws in episodes."""
    seeds: Count | None = None
    """Number of seeds, 5 by default."""
    episodes: Count | None = None
    """Episodes in the dynamics of every training, 8 by default."""
    budget_minutes: BudgetMinutes = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.seed <= _LAST_SEED:
            raise UserError(f"--seed must be from 0 to {_LAST_SEED}")
        for name, given in (("scenarios", self.scenarios), ("learners", self.learners)):
            if given is not None and (not given or len(set(given)) < len(given)):
                raise UserError(f"--{name} must name one or more, each once")


def run(options: Baselines, progress: Progress) -> Iterator[Any]:
    """Train and simulate missing results, and write and print the table."""
    if not set(NETWORKS).isdisjoint(options.learners):
        from agent.deep import require_learners

        require_learners()
    from agent.baselines.comparison import baselines
    from agent.baselines.table import COLUMNS
    from cosim.base.table import show

    arguments = options.arguments(
        scenarios=options.scenarios or _SCENARIOS[: 2 if options.quick else None],
        seeds=options.seeds or (1 if options.quick else 5),
        episodes=options.episodes or (2 if options.quick else 8),
    )
    report = baselines(**arguments, progress=progress)
    yield report
    show(COLUMNS, report.rows, names=2)
    print(f"table in {options.out}/: baselines.json, baselines.md")
