"""Options of studies: arguments of `minirobots.study` and `evaluate`, and of the command lines."""

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import tyro
from msgspec import Meta

from cosim.base.command import BudgetMinutes, Checked, Folder, Seed
from cosim.base.jobs import THREADS, Where

# What is not ideal in rows of the robustness table, the most important ones first.
Axis = Literal[
    "everything", "nothing", "friction", "patches", "motors", "rate", "delay", "noise", "dropout",
    "restitution", "payload", "tilt",
]  # fmt: skip
AXES: tuple[Axis, ...] = get_args(Axis)


@dataclass(frozen=True, kw_only=True)
class Work(Checked):
    """What a study draws from, for how long it runs, and where."""

    seed: Seed = 0
    budget_minutes: BudgetMinutes = None
    where: Where = THREADS


@dataclass(frozen=True, kw_only=True)
class Sampling(Work):
    """Which episodes are simulated, where, and where they are kept."""

    claim: str | None = None
    """Claim to certify or refuse, such as 'collision < 1e-2': RATE < p or RATE > p with the rate of
    collision, out_of_board, timeout, failure or success. A row ends with the episode that decides
    it."""
    confidence: Annotated[Annotated[float, Meta(gt=0, lt=1)] | None, tyro.conf.arg(metavar="P")] = (
        None
    )
    """Least probability that the verdict is right, by default 0.999."""
    out: Folder | None = None
    """Folder of results and tables, from which the same study resumes; by default nothing is
    kept."""
