"""Progress of long work: library code calls back, commands draw bars."""

import contextlib
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.console import Console


class Progress(Protocol):
    """Is told how far long work is; may be called from several threads."""

    def __call__(self, task: str, done: float, total: float | None, state: str = "") -> None:
        """Take a report.

        Args:
            task: what is done, such as "training".
            done: so far, in the task's own unit.
            total: in all, None while nobody knows; the task is over when `done` has reached it.
            state: further words.
        """
        ...


def silent(task: str, done: float, total: float | None, state: str = "") -> None:
    """Progress that nobody watches."""


@contextlib.contextmanager
def under_way(progress: Progress, task: str) -> Iterator[None]:
    """Report a task that has no measure of its own: begun, and over."""
    progress(task, 0, None)
    yield
    progress(task, 1, 1)


@contextlib.contextmanager
def progress_bars(console: "Console | None" = None) -> Iterator[Progress]:
    """Bars on the terminal, a bar per task; nothing is drawn where there is no terminal.

    Args:
        console: to draw on, the terminal of stderr by default.
    """
    from rich import console as rich_console  # noqa: PLC0415 - slow to import
    from rich import progress as rich  # noqa: PLC0415

    console = console or rich_console.Console(stderr=True)
    columns = (
        rich.TextColumn("[progress.description]{task.description}"),
        rich.BarColumn(),
        rich.TextColumn("{task.fields[state]}"),
        rich.TimeElapsedColumn(),
        rich.TimeRemainingColumn(),
    )
    tasks: dict[str, rich.TaskID] = {}
    lock = threading.Lock()
    with rich.Progress(*columns, console=console, disable=not console.is_terminal) as bars:

        def progress(task: str, done: float, total: float | None, state: str = "") -> None:
            with lock:
                if task not in tasks:
                    tasks[task] = bars.add_task(task, total=total, state=state)
                bars.update(tasks[task], completed=done, total=total, state=state)

        yield progress


@contextlib.contextmanager
def resumable_bars(folder: Path, kept: str = "episodes") -> Iterator[Progress]:
    """`progress_bars` of a command that goes on where an interrupt ended it, and says so then.

    Args:
        folder: where it goes on.
        kept: what is there.
    """
    try:
        with progress_bars() as progress:
            yield progress
    except KeyboardInterrupt:
        print(f"{kept} so far are in {folder}/; the same command goes on", file=sys.stderr)
        raise
