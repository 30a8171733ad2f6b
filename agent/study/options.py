"""Options of studies: arguments of `minirobots.study` and `evaluate`, and of the command lines."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from cosim.base.command import BudgetMinutes, Checked, Folder, Seed
from cosim.base.jobs import THREADS, Where


@dataclass(frozen=True, kw_only=True)
class Sampling(Checked):
    """Which episodes are simulated, where, and where they are kept."""

    claim: str | None = None
    """Claim to certify or refuse, such as 'collision < 1e-2': RATE < p or RATE > p with the rate of
    collision, out_of_board, timeout, failure or success. A row ends with the episode that decides
    it."""
    confidence: Annotated[float | None, tyro.conf.arg(metavar="P")] = None
    """Least probability that the verdict is right, by default 0.999."""
    seed: Seed = 0
    out: Folder | None = None
    """Folder of results and tables, from which the same study resumes; by default nothing is
    kept."""
    budget_minutes: BudgetMinutes = None
    where: Where = THREADS
