"""Write one page with figures, tables and recordings."""

from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.progress import Progress
from minirobots.options import CommandOptions, Folder


class Report(CommandOptions):
    """Write a page with every figure next to the paper's claim, tables, and recordings to watch.

    Results are those of `python -m analysis.reproduce`, or of single commands with the same
    folders; the page names missing results with the command that makes them. Open the page with
    `python -m analysis.serve DIR`.
    """

    results: Folder = Path("runs/reproduction/results")
    """Folder of results."""
    out: Folder = Path("runs/reproduction/report")
    """Folder to write the page to."""
    figures: Folder | None = None
    """Folder of `python -m analysis.figures`; by default `figures` next to the results."""
    episode: Annotated[str | None, tyro.conf.arg(metavar="SCENARIO/N")] = None
    """Episode that the viewer opens first, such as 4/0; by default the success of a pair."""


def run(options: Report, _: Progress) -> dict[str, str]:
    """Write the page."""
    from analysis.report.page import write_report

    page = write_report(options.results, options.out, options.figures, options.episode)
    return {"page": str(page), "open_it_with": f"python -m analysis.serve {options.out}"}
