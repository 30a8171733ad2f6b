"""`python -m agent.baselines`: what learners achieve on the same boards, and at what price."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agent.baselines import LEARNERS, NETWORKS, Learner
from cosim.base.command import Jobs, Json, parse, print_json, require_at_least, workers
from cosim.base.errors import UserError, run_command

_SCENARIOS = ("1b", "2", "3", "4", "4-cross")
_LAST_SEED = 4_000_000_000


@dataclass(frozen=True, kw_only=True)
class Baselines:
    """Compare learners on the same boards: success, paths and times over the optimum, and effort.

    Tables by the paper's Q-learning and by double Q-learning, on observed moves (moves, prompt),
    computed optima (shortest, quickest), and networks (ddqn, ippo, mappo; they need the extra
    deep). Every training and every episode is kept as it ends: the same command goes on where an
    earlier one ended, and --budget-minutes 0 only writes the table of what is there.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/baselines")
    """Folder of the table (baselines.json, baselines.md), trainings, policies and episodes."""
    quick: bool = False
    """Train little, by default with one seed in the first two scenarios: to see that it works."""
    scenarios: tuple[str, ...] | None = None
    """Built-in scenarios or scenario files (.toml), by default 1b, 2, 3, 4 and 4-cross."""
    learners: tuple[Learner, ...] = LEARNERS
    """Learners to compare, all by default."""
    seed: int = 0
    """First seed of training, of samples of starts and of what episodes draw."""
    seeds: int | None = None
    """How many seeds, 5 by default."""
    episodes: int | None = None
    """Episodes in the dynamics of every training, 8 by default."""
    budget_minutes: Annotated[float | None, tyro.conf.arg(metavar="M")] = None
    """Begin no training and no episode after so many minutes."""
    jobs: Jobs = -1
    json: Json = False

    def __post_init__(self) -> None:
        workers(self.jobs)
        require_at_least(1, seeds=self.seeds, episodes=self.episodes)
        require_at_least(0, budget_minutes=self.budget_minutes)
        if not 0 <= self.seed <= _LAST_SEED:
            raise UserError(f"--seed must be from 0 to {_LAST_SEED}")
        for name, given in (("scenarios", self.scenarios), ("learners", self.learners)):
            if given is not None and (not given or len(set(given)) < len(given)):
                raise UserError(f"--{name} must name one or more, each once")


def main() -> None:
    """Command line; see `Baselines`."""
    options = parse(Baselines, "agent.baselines")
    if not set(NETWORKS).isdisjoint(options.learners):
        from agent.deep import require_learners

        require_learners()
    from agent.baselines.measurement import baselines
    from agent.baselines.table import show
    from cosim.base.progress import resumable_bars

    with resumable_bars(options.out, "results") as progress:
        report = baselines(
            options.out,
            scenarios=options.scenarios or _SCENARIOS[: 2 if options.quick else None],
            learners=options.learners,
            seed=options.seed,
            seeds=options.seeds or (1 if options.quick else 5),
            episodes=options.episodes or (2 if options.quick else 8),
            quick=options.quick,
            budget_minutes=options.budget_minutes,
            jobs=workers(options.jobs),
            progress=progress,
        )
    show(report)
    print(f"table in {options.out}/: baselines.json, baselines.md")
    if options.json:
        print_json(report)


if __name__ == "__main__":
    run_command(main)
