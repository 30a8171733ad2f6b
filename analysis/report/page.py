"""The report: one page that shows what there is, from result files only.

The page stands in a folder with all it needs: figures, recordings, the Rerun viewer. It asks no
other machine for anything. `analysis.serve` opens it.
"""

from pathlib import Path
from typing import Any

import jinja2

from analysis.report.content import (
    ReportError,
    chosen,
    episodes,
    not_drawn,
    pictures,
    place,
    trainings,
)
from analysis.report.server import PAGE
from analysis.report.tables import learning_tables, parameter_table, timing_table, transfer_tables
from analysis.report.web_viewer import web_viewer_files
from analysis.timings import read_timings
from cosim.base.provenance import versions
from cosim.base.storage import write_whole
from cosim.model.built_in import PAPER
from cosim.model.params import SPEED_NOISE, TABLE_I, TIMING


def write_report(
    results: Path, out: Path, figures: Path | None = None, episode: str | None = None
) -> Path:
    """Write the page and what it needs.

    Args:
        results: folder of results.
        out: folder to write to.
        figures: folder of figures; by default `figures` next to the results.
        episode: that the viewer opens first, such as 4/0; by default the success of a pair.

    Returns:
        The page.

    Raises:
        ReportError: there is no results folder, or no such episode.
        ResultError, TimingsError: a result is damaged.
        WebViewerError: the viewer's files are not available.
    """
    if not results.is_dir():
        raise ReportError(
            f"{results}: no such folder; make results with `python -m analysis.reproduce`"
        )
    figures = figures or results.parent / "figures"
    found = list(episodes(results, out))
    timings = read_timings(results)
    content = {
        "pictures": list(pictures(figures, out)),
        "missing": not_drawn(figures, results, timings),
        "tables": [*learning_tables(results), *transfer_tables(results)],
        "episodes": found,
        "trainings": list(trainings(results, out)),
        "chosen": chosen(found, episode),
        "profile": timings and timings.profile,
        "timing": timings and timing_table(timings),
        "parameters": parameter_table(),
        "versions": versions(),
        "facts": _facts(),
    }
    script, wasm = web_viewer_files()
    for file in (script, wasm):
        place(file, out / "viewer" / file.name)
    viewer = {
        "script": script.name,
        "wasm": wasm.name,
        "megabytes": round(wasm.stat().st_size / 1e6),
    }
    _render("viewer.html.j2", viewer, out / "viewer" / PAGE)
    _render("report.html.j2", content, out / PAGE)
    return out / PAGE


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


def _render(template: str, content: dict[str, Any], path: Path) -> None:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("analysis.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    text = environment.get_template(template).render(content)
    write_whole(path, text + "\n")
