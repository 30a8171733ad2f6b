"""`python -m analysis.export RECORDING.rrd --to FORMAT`: a recording for other programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from analysis.export.content import Format
from cosim.base.command import Json, parse, print_json
from cosim.base.errors import run_command


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a recorded episode for programs that know no Rerun.

    Every signal and state with its unit and time, and what was run: as a table of rows (parquet,
    csv), as messages in order of time (mcap, which needs the extra export), or as structs (mat).
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording of an episode (.rrd or .rrd.part)."""
    to: Format
    """Format to write."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write; by default next to the recording, with its name."""
    signals: tuple[str, ...] = ()
    """Signals and states to write, by name or pattern, such as r1/motors/omega or 'r1/*'; all by
    default. An episode of 76 s with all of them takes some 100 MB as csv."""
    rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Samples to write per second of a signal: the first one of every period of 1/HZ s, as it was
    recorded and not filtered, so that faster oscillations are aliased. All by default."""
    json: Json = False


def main() -> None:
    """Command line; see `Export`."""
    options = parse(Export, "analysis.export")
    from analysis.export.content import chosen
    from analysis.export.writing import export
    from cosim.base.progress import progress_bars
    from cosim.reading.episode import read_episode

    out = options.out or options.recording.with_suffix(f".{options.to}")
    with progress_bars() as progress:
        progress("reading", 0, None)
        episode = read_episode(options.recording)
        progress("reading", 1, 1)
        episode = chosen(episode, options.signals, options.rate)
        export(episode, options.to, out, progress)
    print(f"wrote {out}")
    if options.json:
        size = out.stat().st_size
        print_json({"file": str(out), "signals": len(episode.signals), "bytes": size})


if __name__ == "__main__":
    run_command(main)
