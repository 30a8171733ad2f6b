"""Reproduce the whole paper: every experiment, every figure and the report."""

import sys
from contextlib import AbstractContextManager
from pathlib import Path

from cosim.base.errors import UserError
from cosim.base.progress import Progress
from cosim.base.storage import lock_folder
from minirobots.options import Folder, Jobs, Resumable, Seed


class Reproduce(Resumable):
    """Run every experiment of the paper, draw every figure, and write the report.

    Results go to DIR/results, figures to DIR/figures. DIR/report/index.html is the report, a page
    with every figure next to the paper's claim and with all tables, which opens from disk. The same
    command continues after an interrupt: stages that this version has finished are kept, an
    interrupted sweep continues with its next run. The time of each stage is in
    DIR/results/timings.json.
    """

    out: Folder = Path("runs/reproduction")
    """Folder to write to."""
    quick: bool = False
    """Short version of a few minutes: few runs, training episodes and co-simulated episodes."""
    report_only: bool = False
    """Only draw the figures and write the report, from the results that DIR/results has. The report
    names missing results with the commands that make them."""
    seed: Seed = 0
    jobs: Jobs = -1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.report_only and (self.quick or self.seed or self.jobs != -1):
            raise UserError(
                "--quick, --seed and --jobs have no effect with --report-only, which runs no "
                "experiment; leave them out"
            )

    def alone(self) -> AbstractContextManager[None]:
        """Keep other runs out of the output folder."""
        return lock_folder(self.out)


def run(options: Reproduce, progress: Progress) -> dict[str, str]:
    """Run all unfinished stages, or only draw what they gave."""
    from analysis.profiles import FULL, QUICK
    from cosim.base.command import workers
    from minirobots.reproduction import redraw, reproduce

    def say(text: str) -> None:
        print(text, file=sys.stderr)

    if options.report_only:
        page = redraw(options.out, progress, say)
    else:
        page = reproduce(
            options.out,
            QUICK if options.quick else FULL,
            seed=options.seed,
            jobs=workers(options.jobs),
            progress=progress,
            say=say,
        )
    return {"page": str(page)}
