"""Reproduce the whole paper: every experiment, every figure and the report."""

import sys
from pathlib import Path

from cosim.base.progress import Progress
from minirobots.options import Folder, Jobs, Resumable, Seed


class Reproduce(Resumable):
    """Run every experiment of the paper, draw every figure, and write the report.

    Results go to DIR/results, figures to DIR/figures, the page to DIR/report; open it with
    `python -m analysis.serve DIR/report`. The same command continues after an interrupt: stages
    that the same code has finished are kept, an interrupted sweep continues with its next run.
    The time of each stage is in DIR/results/timings.json.
    """

    out: Folder = Path("runs/reproduction")
    """Folder to write to."""
    quick: bool = False
    """Short version of a few minutes: few runs, training episodes and co-simulated episodes."""
    seed: Seed = 0
    jobs: Jobs = -1


def run(options: Reproduce, progress: Progress) -> dict[str, str]:
    """Run all unfinished stages."""
    from analysis.profiles import FULL, QUICK
    from cosim.base.command import workers
    from minirobots.reproduction import reproduce

    page = reproduce(
        options.out,
        QUICK if options.quick else FULL,
        seed=options.seed,
        jobs=workers(options.jobs),
        progress=progress,
        say=lambda text: print(text, file=sys.stderr),
    )
    return {"page": str(page), "open_it_with": f"python -m analysis.serve {page.parent}"}
