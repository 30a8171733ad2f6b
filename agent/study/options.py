"""Options of studies: arguments of `minirobots.study` and `evaluate`, and of the command lines."""

from dataclasses import dataclass
from typing import Annotated

import tyro
from msgspec import Meta

from cosim.base.command import BudgetMinutes, Checked, Count, Folder, Seed
from cosim.base.jobs import THREADS, Where


@dataclass(frozen=True, kw_only=True)
class Sampling(Checked):
    """Which episodes are simulated, where, for how long, and where they are kept."""

    seed: Seed = 0
    budget_minutes: BudgetMinutes = None
    where: Where = THREADS
    claim: str | None = None
    """Claim to certify or refuse, such as 'collision < 1e-2': RATE < p or RATE > p with the rate of
    collision, out_of_board, timeout, failure or success. A row ends with the episode that decides
    it."""
    confidence: Annotated[Annotated[float, Meta(gt=0, lt=1)] | None, tyro.conf.arg(metavar="P")] = (
        None
    )
    """Least probability that the verdict is right, by default 0.999."""
    trainings: Count = 1
    """Trainings of each method that learns, with the seeds seed, seed + 1, ...; all are driven from
    the same starts with the same noise."""
    out: Folder | None = None
    """Folder of results and tables, from which the same study resumes; by default nothing is
    kept."""
