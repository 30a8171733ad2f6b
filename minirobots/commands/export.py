"""Write a recording for other programs."""

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from cosim.base.progress import Progress, under_way
from minirobots.options import CommandOptions, File


class Export(CommandOptions):
    """Write a recorded episode for programs without Rerun.

    Every signal and state is written with its unit and time as a table with a row per value.
    Parquet has the configuration too.
    """

    recording: tyro.conf.Positional[Path]
    """Recording of an episode (.rrd or .rrd.part)."""
    to: Literal["parquet", "csv"]
    """Format to write."""
    out: File | None = None
    """File to write; by default next to the recording, with its name."""
    signals: tuple[str, ...] = ()
    """Signals and states to write, by name or pattern, such as r1/motors/omega or 'r1/*'; all by
    default. An episode of 76 s with all of them takes some 100 MB as csv."""
    rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Samples to write per second of a signal: the first one of every period of 1/HZ s, as it was
    recorded and not filtered, so that faster oscillations are aliased. All by default."""


def run(options: Export, progress: Progress) -> dict[str, Any]:
    """Read the recording and write the selected signals."""
    from analysis.export import chosen, export
    from cosim.base.storage import require_suffix
    from cosim.recording.reader import read_episode

    suffix = f".{options.to}"
    out = require_suffix(options.out or options.recording.with_suffix(suffix), suffix)
    with under_way(progress, "reading"):
        episode = read_episode(options.recording)
    episode = chosen(episode, options.signals, options.rate)
    export(episode, options.to, out, progress)
    return {"file": str(out), "signals": len(episode.signals), "bytes": out.stat().st_size}
