"""`python -m analysis.report`: write one page with figures, tables and recordings."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cosim.base.command import Json, parse, print_json
from cosim.base.errors import run_command


@dataclass(frozen=True)
class Report:
    """Write a page with every figure beside the paper's claim, tables, and recordings to watch.

    Results are those of `python -m analysis.reproduce`, or of single commands with the same
    folders; what is missing is named on the page with the command that makes it. Open the page
    with `python -m analysis.serve DIR`.
    """

    results: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/reproduction/results")
    """Folder of results."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/reproduction/report")
    """Folder to write the page to."""
    figures: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of `python -m analysis.figures`; by default `figures` beside the results."""
    episode: Annotated[str | None, tyro.conf.arg(metavar="SCENARIO/N")] = None
    """Episode that the viewer opens first, such as 4/0; by default the success of a pair."""
    json: Json = False


def main() -> None:
    """Command line; see `Report`."""
    options = parse(Report, "analysis.report")
    from analysis.report.page import write_report

    page = write_report(options.results, options.out, options.figures, options.episode)
    print(f"report: {page}")
    print(f"open it with: python -m analysis.serve {options.out}")
    if options.json:
        print_json({"page": str(page)})


if __name__ == "__main__":
    run_command(main)
