"""Progress of long work: library code calls back, commands draw bars."""

import contextlib
import functools
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, ParamSpec, Protocol, TypeVar

from cosim.base.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
_QUIET_S = 2.0  # in which nothing is shown
_REFRESH_S = 0.1


class Progress(Protocol):
    """Receives reports of long work; may be called from several threads."""

    def __call__(self, task: str, done: float, total: float | None, state: str = "") -> None:
        """Take a report.

        Args:
            done: so far, in the task's own unit.
            total: in all, None while unknown; the task is over when `done` has reached it.
        """
        ...


def silent(task: str, done: float, total: float | None, state: str = "") -> None:
    """Ignore all reports."""


@contextlib.contextmanager
def under_way(progress: Progress, task: str) -> Iterator[None]:
    """Report a task that has no measure of its own: begun, and over."""
    progress(task, 0, None)
    yield
    progress(task, 1, 1)


@contextlib.contextmanager
def progress_bars(console: "Console | None" = None) -> Iterator[Progress]:
    """Show work that takes more than two seconds: bars on a terminal or in a notebook.

    Elsewhere, as in a pipe or a log, each task that takes longer is announced on one line.
    """
    reports: dict[str, tuple[float, float | None, str]] = {}
    over = threading.Event()
    thread = threading.Thread(target=_show, args=(reports, over, console), daemon=True)
    thread.start()

    def progress(task: str, done: float, total: float | None, state: str = "") -> None:
        reports[task] = done, total, state

    try:
        yield progress
    finally:
        over.set()
        thread.join()


def _show(
    reports: dict[str, tuple[float, float | None, str]],
    over: threading.Event,
    console: "Console | None",
) -> None:
    while not reports:
        if over.wait(_QUIET_S):
            return
    if over.wait(_QUIET_S):
        return
    from rich import console as rich_console  # noqa: PLC0415 - slow to import
    from rich import progress as rich  # noqa: PLC0415

    console = console or rich_console.Console(stderr=True)
    if not (console.is_terminal or console.is_jupyter):
        announced = set()
        while True:
            for task, (done, total, _) in reports.copy().items():
                if task not in announced and done != total:
                    announced.add(task)
                    console.print(f"{task} …", soft_wrap=True, markup=False, highlight=False)
            if over.wait(_QUIET_S):
                return
    columns = (
        rich.TextColumn("{task.description}", "progress.description", markup=False),
        rich.BarColumn(),
        rich.TextColumn("{task.fields[state]}", markup=False),
        rich.TimeElapsedColumn(),
        rich.TimeRemainingColumn(),
    )
    rows: dict[str, rich.TaskID] = {}
    with rich.Progress(*columns, console=console) as bars:
        ended = False
        while not ended:
            ended = over.wait(_REFRESH_S)
            for task, (done, total, state) in reports.copy().items():
                if task not in rows:
                    rows[task] = bars.add_task(task, total=total, state=state)
                bars.update(rows[task], completed=done, total=total, state=state)


def automatic(task: str, done: float, total: float | None, state: str = "") -> None:
    """Progress of a call in Python that names none: `progress_bars`, see `showing`."""


def showing(call: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return a function that shows its progress by default, and none with `progress=None`."""

    @functools.wraps(call)
    def wrapped(*args: Parameters.args, **options: Parameters.kwargs) -> Result:
        progress = options.get("progress", automatic)
        if progress is not None and not callable(progress):
            raise UserError(f"progress = {progress!r} is no function; give one, or None for none")
        if progress is not automatic:
            options["progress"] = progress or silent
            return call(*args, **options)
        with progress_bars() as options["progress"]:
            return call(*args, **options)

    return wrapped
