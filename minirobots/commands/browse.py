"""The episodes of a run as a table, each to be opened from it."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from cosim.base.errors import in_shell
from cosim.base.progress import Progress
from minirobots.options import CommandOptions

if TYPE_CHECKING:
    from analysis.browse.catalog import Dataset

_SHOWN = ("outcome", "path_length_cm", "sim_time_s", "method", "mu", "scenario", "seed", "episode")


class Browse(CommandOptions):
    """Serve all recorded episodes below a folder to the Rerun viewer, until Ctrl-C.

    The viewer shows a table with outcome, method, friction, path length and a preview of every
    episode, which can be sorted and filtered; a click opens the episode. Needs the extra catalog.
    """

    folder: tyro.conf.Positional[Path]
    """Folder of a run, or of several: recordings are found below it."""
    port: int = 51234
    """Port to listen on; 0 takes a free one."""
    spawn: bool = False
    """Open a viewer too."""
    check: bool = False
    """Print the server's table instead, and exit."""


def run(options: Browse, _: Progress) -> Iterator[Any]:
    """Serve until Ctrl-C, or print the table; yield the served table."""
    from analysis.browse.catalog import serving

    with serving(options.folder, 0 if options.check else options.port) as datasets:
        if options.check:
            _show(datasets)
        for dataset in datasets:
            print(f"{dataset.name}: {len(dataset.episodes)} episodes")
            for file in dataset.left_out:
                print(f"left out: {file} is damaged, or a recording of the same episode is there")
        if not options.check:
            _wait(datasets, options.spawn)
    yield {"datasets": datasets}


def _show(datasets: "list[Dataset]") -> None:
    from cosim.base.table import show_texts

    for dataset in datasets:
        rows = [
            (str(row["recording"]), *(_text(row[name]) for name in _SHOWN))
            for row in dataset.episodes
        ]
        show_texts(("recording", *_SHOWN), rows, title=dataset.name)


def _text(value: object) -> str:
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _wait(datasets: "list[Dataset]", spawn: bool) -> None:
    """Serve until Ctrl-C."""
    import subprocess
    import threading

    from cosim.recording.live import viewer_executable

    for dataset in datasets:
        print(f"open with: {in_shell('rerun')} {dataset.address}", flush=True)
    viewer = None
    try:
        if spawn:
            viewer = subprocess.Popen([viewer_executable() or "rerun", datasets[0].address])
        threading.Event().wait()
    except KeyboardInterrupt:
        print()  # the intended end, after the terminal's ^C
    finally:
        if viewer is not None:
            viewer.terminate()
