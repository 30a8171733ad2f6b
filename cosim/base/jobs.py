"""Many jobs that each give a row: those that are missing are computed, and each is kept as it ends.

What a job is, is the caller's: an episode, a branch of one, a measurement. What travels to another
process or machine is a group of jobs that can share a batch.
"""

import math
import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, NamedTuple, Protocol, TypeVar

import tyro

from cosim.base.arguments import validate_argument
from cosim.base.command import BudgetMinutes, Checked, Jobs, workers
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent, under_way

Backend = Literal["threads", "loky", "dask"]
_GROUP = 32  # jobs, at most, that travel together
_GROUPS = 4  # at least, for each worker, so that none waits long for the last one
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


SomeJob = TypeVar("SomeJob", bound=Any)  # a frozen, picklable record with the attribute `key`
Row = TypeVar("Row")


class JobStore(Protocol[Row]):
    """Store of rows."""

    def find(self, job: Any) -> Row | None:
        """Return the row of a job, None if it is missing."""
        ...

    def keep(self, job: Any, row: Row) -> None:
        """Keep the row of a job that has ended."""
        ...


def always() -> bool:
    """Let every job begin."""
    return True


class JobKind(NamedTuple, Generic[SomeJob, Row]):
    """Kind of jobs: how they are computed."""

    # Yields jobs and their rows as they end; of the jobs, the number of threads, and whether
    # another job may begin. A function that other processes can import.
    compute: Callable[[Sequence[SomeJob], int, Callable[[], bool]], Iterator[tuple[SomeJob, Row]]]
    batch: Callable[[SomeJob], Hashable]  # equal for jobs that can share a batch
    # Whether a row is a success, for the progress; None if that has no meaning
    succeeded: Callable[[Row], bool] | None = None
    # Compiles what the jobs need, of the jobs and the number of threads
    prepare: Callable[[Sequence[SomeJob], int], None] | None = None


def until(budget_minutes: float | None) -> Callable[[], bool]:
    """Return whether another job may begin: until a budget of time from now on is used up."""
    budget_minutes = validate_argument("budget_minutes", budget_minutes, BudgetMinutes)
    end = math.inf if budget_minutes is None else time.monotonic() + 60.0 * budget_minutes
    return lambda: time.monotonic() < end


def run(
    jobs: Iterable[SomeJob],
    store: JobStore[Row],
    kind: JobKind[SomeJob, Row],
    where: Workers = Workers(),
    *,
    may_begin: Callable[[], bool] = always,
    progress: Progress = silent,
    task: str = "episodes",
) -> Iterator[tuple[SomeJob, Row]]:
    """Compute the jobs without rows, and keep each row at once.

    Args:
        jobs: wanted, the most important ones first; those of one `key` are computed once.

    Yields:
        The jobs that were missing and their rows, as they end.
    """
    missing = {job.key: job for job in jobs if store.find(job) is None}
    todo, total = list(missing.values()), len(missing)
    if not todo:
        return
    if where.backend != "threads":
        ended = _elsewhere(todo, kind, where, may_begin)
    else:
        if kind.prepare is not None and may_begin():
            with under_way(progress, "preparing the kernels"):
                kind.prepare(todo, where.count)
        ended = kind.compute(todo, where.count, may_begin)
    successes = 0
    for count, (job, row) in enumerate(ended, 1):
        store.keep(missing[job.key], row)
        yield missing[job.key], row
        state = f"{count}/{total}"
        if kind.succeeded is not None:
            successes += kind.succeeded(row)
            state += f"  success {successes / count:.1%}"
        progress(task, count, total, state)


def _elsewhere(
    jobs: Sequence[SomeJob],
    kind: JobKind[SomeJob, Row],
    where: Workers,
    may_begin: Callable[[], bool],
) -> Iterator[tuple[Any, Row]]:
    """Compute groups of jobs in other processes or on other machines."""
    from cosim.base.backends import sweep  # noqa: PLC0415 - joblib is slow to import

    together: dict[Hashable, list[Any]] = {}
    for job in jobs:
        together.setdefault(kind.batch(job), []).append(job)
    size = max(1, min(_GROUP, -(-len(jobs) // (_GROUPS * where.count))))
    groups = [
        some[first : first + size]
        for some in together.values()
        for first in range(0, len(some), size)
    ]
    tasks = [(kind.compute, group) for group in groups]
    for number, rows in sweep(_rows, tasks, where, may_begin):
        for place, row in rows:
            yield groups[number][place], row


def _rows(task: tuple[Callable[..., Iterator[tuple[Any, Any]]], list[Any]]) -> list[Any]:
    """Rows of a group of jobs by their places in it; in a worker."""
    compute, group = task
    places = {job.key: place for place, job in enumerate(group)}
    return [(places[job.key], row) for job, row in compute(group, 1, always)]
