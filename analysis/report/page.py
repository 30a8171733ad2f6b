"""The report: one page that shows what there is, from result files only.

The page stands in a folder with its figures and opens from disk.
"""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jinja2

from analysis.figures.style import FORMATS, Caption, read_caption
from analysis.reading.results import FIGURES, missing
from analysis.report.tables import (
    episode_table,
    learning_tables,
    parameter_table,
    timing_table,
    transfer_tables,
)
from analysis.timings import TimingsFile, read_timings
from cosim.base.errors import FileError, UserError
from cosim.base.provenance import versions
from cosim.base.storage import replacing, write_whole
from cosim.model.built_in import PAPER
from cosim.model.params import SPEED_NOISE, TABLE_I, TIMING

PAGE = "index.html"


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


def write_report(results: Path, figures: Path, out: Path) -> Path:
    """Write the page and what it needs.

    Args:
        results: folder of results.
        figures: folder of figures.
        out: folder to write to.

    Returns:
        The page.

    Raises:
        UserError: there is no results folder.
        FileError: a result is damaged.
    """
    if not results.is_dir():
        raise UserError(f"{results}: no such folder; make results with `minirobots reproduce`")
    timings = read_timings(results)
    content = {
        "pictures": list(_pictures(figures, out)),
        "missing": not_drawn(figures, results, timings),
        "tables": [*learning_tables(results), *transfer_tables(results), *episode_table(results)],
        "profile": timings and timings.profile,
        "timing": timings and timing_table(timings),
        "parameters": parameter_table(),
        "versions": versions(),
        "facts": _facts(),
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("analysis.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    write_whole(out / PAGE, environment.get_template("report.html.j2").render(content) + "\n")
    return out / PAGE


def _pictures(figures: Path, out: Path) -> Iterator[Picture]:
    """Copy the figures that have been drawn next to the page, in the paper's order."""
    for name in FIGURES:
        try:
            caption = read_caption(figures, name)
        except FileError:
            continue
        files = [f"figures/{name}{ending}" for ending in FORMATS]
        for file in files:
            with replacing(out / file) as temporary:
                shutil.copyfile(figures / Path(file).name, temporary)
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
                needed = [f"minirobots reproduce --out . --seed {timings.seed}{quick}"]
            drawing = f"minirobots figures {name} --results results --out figures"
            commands[name] = [*needed, drawing]
    return commands


def _facts() -> dict[str, str]:
    """Numbers in the text and the diagram."""
    scenario = PAPER["2"]
    numbers = {
        "diameter_cm": 100.0 * TABLE_I.diameter_m,
        "board_cm": 100.0 * scenario.columns * scenario.cell_m,
        "rl_step_s": TIMING.rl_step_s,
        "control_ms": 1e3 * TIMING.control_period_s,
        "dt_us": 1e6 * TIMING.dt_s,
        "noise_percent": 100.0 * SPEED_NOISE.relative_amplitude,
    }
    return {name: f"{number:g}" for name, number in numbers.items()}
