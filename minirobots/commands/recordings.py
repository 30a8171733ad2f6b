"""Commands that read recordings."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from cosim.base import command as opt
from cosim.base.progress import Progress, under_way
from cosim.base.storage import PICTURE, require_suffix
from cosim.base.table import Column, field, format_value, show, show_texts
from minirobots.runner import Command, Output

if TYPE_CHECKING:
    from analysis.reading.inspection import Inspection


@dataclass(frozen=True, kw_only=True)
class Inspect(Command):
    """Print the content of a recorded episode, and its anomalies.

    Prints what was run, the outcome, every robot's path and moves, statistics of every signal, and
    findings with the time at which to look. What looks wrong: no success, an episode four times as
    long as straight lines take, a recording that was cut off, robots that touch, moves given up,
    voltages at their limit for long. What robots that reach
    their targets also do: feet slide and lift off, robots pass closely. Also reads what a killed
    run left (.rrd.part).
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording of an episode (.rrd or .rrd.part)."""
    parameters: bool = False
    """Also list every parameter with its unit and source."""

    def run(self, progress: Progress) -> Output:
        from analysis.reading.inspection import inspect_episode
        from cosim.recording.reader import read_episode

        with under_way(progress, f"reading {self.recording}"):
            found = inspect_episode(read_episode(self.recording, without=("/world/**",)))
        return Output(found, *_lines(found), partial(_show_tables, found, self.parameters))


def _lines(found: "Inspection") -> Iterator[str]:
    ending = found.outcome or "not recorded: the recording ends before the episode"
    yield f"{found.recording}\noutcome {ending}, {found.time_s:.2f} s simulated"
    if not found.complete:
        yield "its writer was stopped; this is what it had written"
    first = ("scenario", "title", "episode", "seed", "starts")
    for key in sorted(found.facts, key=lambda key: first.index(key) if key in first else 9):
        yield f"  {key}: {found.facts[key]}"
    for robot, row in found.robots.items():
        length = row.path_length_m
        path = f"{100.0 * length:.1f} cm, " if length is not None else ""
        moves = f"{row.moves} moves, {row.moves_ended} ended, {row.moves_timed_out} timed out"
        yield f"  {robot}: {path}{moves}"


def _show_tables(found: "Inspection", parameters: bool) -> None:
    if parameters:
        header = ("parameter", "value", "unit", "meaning", "source")
        rows = [(name, *map(str, row.values())) for name, row in found.parameters.items()]
        show_texts(header, rows, names=5, title="parameters")
    _show_signals(found)
    if not any(finding.wrong for finding in found.findings):
        print("nothing looks wrong")
    at = Column("at", lambda row: f"{row.time_s:.2f} s" if row.time_s is not None else "–")
    for wrong, title in ((True, "what looks wrong"), (False, "what successful robots also do")):
        rows = [finding for finding in found.findings if finding.wrong == wrong]
        if rows:
            columns = field("kind", heading=title), field("where"), at, field("text", heading="")
            show(columns, rows, names=4)


def _show_signals(found: "Inspection") -> None:
    """Print each signal with its unit and rate, and a line for each of its components."""
    measures = ("minimum", "mean", "maximum", "deviation")
    print(f"{'signals':<24}", *(f"{name:>12}" for name in measures))
    for path, rows in groupby(found.signals, key=lambda row: row.signal):
        components = list(rows)
        first = components[0]
        every = f" every {first.period_s:g} s" if first.period_s else ""
        unit = "" if first.unit == "1" else f" in {first.unit}"
        print(f"{path}{unit}, {first.samples} samples{every}")
        for row in components:
            values = (format_value(getattr(row, name), "{:.4g}") for name in measures)
            print(f"  {row.component:<22}", *(f"{value:>12}" for value in values))


@dataclass(frozen=True, kw_only=True)
class Screenshot(Command):
    """Draw a recording as the Rerun viewer shows it and save the picture.

    The viewer draws with software Vulkan, which on Debian needs the packages mesa-vulkan-drivers,
    libvulkan1 and libegl1.
    """

    recording: tyro.conf.Positional[Path]
    """Recording to open (.rrd)."""
    out: opt.File = Path("screenshot.png")
    """Picture to write (.png)."""
    width: Annotated[opt.Count, tyro.conf.arg(metavar="PX")] = 1280
    """Width of the picture in pixels."""
    time: Annotated[float | None, tyro.conf.arg(metavar="S", aliases=["--time-s"])] = None
    """Simulated time in s at which the recording is shown; by default as the viewer opens it."""
    tab: str | None = None
    """Tab to show, such as contact or policies; by default the first."""

    def run(self, progress: Progress) -> Output:
        from analysis.viewer import screenshot, shrink

        out = require_suffix(self.out, ".png")
        with under_way(progress, "drawing in the viewer"):
            report = screenshot(self.recording, out, self.time, self.tab)
            shrink(out, self.width)
        return Output(
            asdict(report) | {"out": str(out)},
            *(f"view {name}: {fault}" for name, faults in report.views for fault in faults),
            *(f"viewer: {warning}" for warning in report.warnings),
            f"loaded in {report.load_s:.1f} s, picture in {out}",
        )


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Write a recorded episode for programs without Rerun.

    Every signal and state is written with its unit and time as a table with a row per value.
    Parquet has the configuration too.
    """

    recording: tyro.conf.Positional[Path]
    """Recording of an episode (.rrd or .rrd.part)."""
    to: Literal["parquet", "csv"]
    """Format to write."""
    out: opt.OptionalFile = None
    """File to write; by default next to the recording, with its name."""
    signals: tuple[str, ...] = ()
    """Signals and states to write, by name or pattern, such as r1/motors/omega or 'r1/*'; all by
    default. An episode of 76 s with all of them takes some 100 MB as csv."""
    rate: Annotated[float | None, tyro.conf.arg(metavar="HZ")] = None
    """Samples to write per second of a signal: the first one of every period of 1/HZ s, as it was
    recorded and not filtered, so that faster oscillations are aliased. All by default."""

    def run(self, progress: Progress) -> Output:
        from analysis.export import chosen, export
        from cosim.recording.reader import read_episode

        suffix = f".{self.to}"
        out = require_suffix(self.out or self.recording.with_suffix(suffix), suffix)
        with under_way(progress, "reading"):
            episode = read_episode(self.recording)
        episode = chosen(episode, self.signals, self.rate)
        export(episode, self.to, out, progress)
        return Output(
            {"file": str(out), "signals": len(episode.signals), "bytes": out.stat().st_size}
        )


@dataclass(frozen=True, kw_only=True)
class Compare(Command):
    """Compare two recorded episodes: where they part, and why.

    Prints what differs in configuration and outcome, and every signal and state that differs, with
    the simulated time of its first difference, the earliest first. The picture has both paths and
    the first signals that part. Exits with status 1 if anything differs.
    """

    first: Annotated[Path, tyro.conf.Positional]
    """Recording of an episode (.rrd or .rrd.part)."""
    second: Annotated[Path, tyro.conf.Positional]
    """Another one."""
    out: opt.OptionalFile = None
    """Picture to write (.png, .pdf or .svg); by default none."""

    def run(self, progress: Progress) -> Output:
        from analysis.compare import compare, differing, draw
        from cosim.base.plotting import save_figure
        from cosim.recording.reader import read_episode

        out = self.out and require_suffix(self.out, *PICTURE)
        with under_way(progress, "comparing"):
            a, b = map(read_episode, (self.first, self.second))
            found = compare(a, b)
        if out:
            save_figure(draw(a, b, found), out, dpi=150)
        rows = {"outcome": found.outcomes, "simulated s": found.times_s}
        rows |= found.facts | found.parameters
        changed = {name: pair for name, pair in rows.items() if pair[0] != pair[1]}
        return Output(
            found,
            *(f"{name}: {one} and {other}" for name, (one, other) in changed.items()),
            *(differing(*each) for each in found.differences.items()),
            f"{found.signals - len(found.differences)} of {found.signals} signals are equal in "
            "every bit",
            *([f"picture in {out}"] if out else []),
            failed=bool(found.differences),
        )


@dataclass(frozen=True, kw_only=True)
class Video(Command):
    """Make a video of a recorded episode: the board from above, with robots, trails and a clock.

    It needs no viewer. GIFs need nothing else; MP4 needs the extra video.
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording of an episode (.rrd or .rrd.part)."""
    out: opt.File = Path("episode.gif")
    """Video to write (.mp4 or .gif)."""
    speed: opt.Positive = 10.0
    """Simulated seconds per second of the video."""

    def run(self, progress: Progress) -> Output:
        from analysis.video import write_video
        from cosim.recording.reader import read_episode

        frames = write_video(read_episode(self.recording), self.out, self.speed, progress)
        return Output({"video": str(self.out), "frames": frames})
