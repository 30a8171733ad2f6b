"""Where many jobs are computed, and until when another one may begin."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from cosim.base.arguments import validate_argument
from cosim.base.command import BudgetMinutes, Checked, Jobs, workers
from cosim.base.errors import UserError

Backend = Literal["threads", "loky", "dask"]
_CLUSTER = 64  # workers that a cluster at an address is taken to have


@dataclass(frozen=True, kw_only=True)
class Workers(Checked):
    """Place where jobs are computed; the results do not depend on it."""

    jobs: Jobs = -1
    backend: Backend = "threads"
    """Where it is computed: threads or processes (loky) of this machine, or a Dask cluster
    (an extra); see docs/studies.md."""
    address: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Address of the cluster's head; without it Dask starts on this machine."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.jobs != -1:  # counting the cores is slow to import
            workers(self.jobs)
        if self.address is not None and self.backend != "dask":
            raise UserError(f"--address has no effect with --backend {self.backend}; name dask")
        if self.address is not None and self.jobs != -1:
            raise UserError(
                "--jobs has no effect on a Dask cluster with an --address; leave it out"
            )

    @property
    def count(self) -> int:
        """Return the number of jobs at the same time."""
        return _CLUSTER if self.address is not None else workers(self.jobs)


Where = Annotated[Workers, tyro.conf.OmitArgPrefixes]  # as an option
THREADS, PROCESSES = Workers(), Workers(backend="loky")


def always() -> bool:
    """Let every job begin."""
    return True


def until(budget_minutes: float | None) -> Callable[[], bool]:
    """Return whether another job may begin: until a budget of time from now on is used up."""
    budget_minutes = validate_argument("budget_minutes", budget_minutes, BudgetMinutes)
    end = math.inf if budget_minutes is None else time.monotonic() + 60.0 * budget_minutes
    return lambda: time.monotonic() < end
