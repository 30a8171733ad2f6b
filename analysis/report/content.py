"""Contents of a report except for tables: figures and recordings, placed in the report's folder.

Finds what a results folder has; how it looks is the business of `analysis/templates`.
"""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from analysis.figures.style import FORMATS, Caption, FigureError, read_caption
from analysis.reading.results import DRIVEN_BY, FIGURES, RESULTS, Result, episodes_of, missing
from analysis.reading.written import read_run
from analysis.timings import TimingsFile
from cosim.base.errors import UserError
from cosim.base.storage import replacing
from cosim.model.built_in import PAPER
from cosim.simulation.result import EpisodeResult


class Picture(NamedTuple):
    """A figure on the page.

    Attributes:
        label: its number in the paper, or its name.
        caption: the paper's claim and our numbers.
        png, pdf: relative to the page.
    """

    label: str
    caption: Caption
    png: str
    pdf: str


class ReportError(UserError):
    """Error in making a report. The message names the fix."""


class Watchable(NamedTuple):
    """A recorded episode on the page.

    Attributes:
        name: scenario and number, as `--episode` takes it.
        file: recording, relative to the page.
        megabytes: size of the recording.
        robots: their number.
        result: of the episode.
    """

    name: str
    file: str
    megabytes: float
    robots: int
    result: EpisodeResult


def place(source: Path, target: Path) -> Path:
    """Have a file under another name too; a second name of the same file where that is possible."""
    with replacing(target) as temporary:
        temporary.unlink()
        try:
            os.link(source, temporary)
        except OSError:  # another file system, or one without hard links
            shutil.copyfile(source, temporary)
    return target


def pictures(figures: Path, out: Path) -> Iterator[Picture]:
    """Figures that have been drawn, in the paper's order."""
    for name in FIGURES:
        try:
            caption = read_caption(figures, name)
        except FigureError:
            continue
        files = [f"figures/{name}{ending}" for ending in FORMATS]
        for file in files:
            place(figures / Path(file).name, out / file)
        number = name.removeprefix("fig")
        label = f"Fig. {int(number)}" if number.isdecimal() else name.replace("_", " ").capitalize()
        yield Picture(label, caption, *files)


def not_drawn(figures: Path, results: Path, timings: TimingsFile | None) -> dict[str, list[str]]:
    """Figures that have not been drawn, with the commands (of a reproduction: its own) for them."""
    commands = {}
    for name in FIGURES:
        if not (figures / f"{name}.json").is_file():
            needed = [result.command(Path("results")) for result in missing(name, results)]
            if needed and timings:
                quick = " --quick" if timings.profile.get("name") == "quick" else ""
                needed = [f"python -m analysis.reproduce --out . --seed {timings.seed}{quick}"]
            drawing = f"python -m analysis.figures {name} --results results --out figures"
            commands[name] = [*needed, drawing]
    return commands


def episodes(results: Path, out: Path) -> Iterator[Watchable]:
    """Recorded episodes in the order of the scenarios.

    Raises:
        ResultError: a summary is damaged.
    """
    for run, result in _runs():
        for number, episode in enumerate(read_run(result.name, results)):
            recording = result.location(results) / (episode.recording or "")
            if not recording.is_file():
                continue
            file = f"recordings/{run}-{number}.rrd"
            place(recording, out / file)
            megabytes, robots = recording.stat().st_size / 1e6, PAPER[result.of].robots
            yield Watchable(f"{run}/{number}", file, megabytes, robots, episode)


def _runs() -> Iterator[tuple[str, Result]]:
    """Runs of the main command by scenario and method, such as 2-moves."""
    for name in PAPER:
        for method in DRIVEN_BY:
            yield f"{name}-{method}", RESULTS[episodes_of(name, method)]


def trainings(results: Path, out: Path) -> Iterator[tuple[str, str]]:
    """Recorded trainings of the policies that drove the episodes: the run, and the file."""
    for name, result in _runs():
        recording = result.location(results) / "training.rrd"
        if recording.is_file():
            file = f"recordings/{name}-training.rrd"
            place(recording, out / file)
            yield name, file


def chosen(found: list[Watchable], name: str | None) -> Watchable | None:
    """The episode to open first: a success of a pair rather than another; None if there is none.

    Raises:
        ReportError: there is no episode of that name.
    """
    if name is None:
        return max(found, key=lambda e: (e.result.outcome == "success", e.robots), default=None)
    for episode in found:
        if episode.name == name:
            return episode
    known = ", ".join(episode.name for episode in found) or "none"
    raise ReportError(f"--episode {name}: no such recording; choose one of: {known}")
