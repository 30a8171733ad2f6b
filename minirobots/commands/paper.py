"""Commands that reproduce the paper."""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import tyro

from cosim.base import command as opt
from cosim.base.errors import UserError
from cosim.base.progress import Progress
from minirobots.runner import RESUMES, Command, Output

ALL = "all"


@dataclass(frozen=True, kw_only=True)
class Figures(Command):
    """Draw figures of the paper, and some that it lacks, from a folder of results.

    Each figure becomes a PNG and a PDF of the same name, and a .json with its caption: the paper's
    claim and our numbers. fig02 platform and fig03 its motion, fig04 robot, fig05 scenarios, fig06
    speed loop and fig07 its response, fig08 learning of one robot, fig09 its paths, fig10
    coefficient c, fig11 learning of pairs, fig12 their paths, motor_cycle forces over a turn,
    obstacles and groups scenarios of this project, path_ratio paths compared with the optimum,
    sequel learning of groups, transfer success in co-simulation by training method, values what one
    robot has learnt. A figure
    without results is left out, and the command that makes them is printed.
    """

    figures: tyro.conf.Positional[tuple[str, ...]] = (ALL,)
    """Figures to draw by name, or all."""
    results: opt.Folder = Path("runs/reproduction/results")
    """Folder of results, as `minirobots reproduce` fills it."""
    out: opt.Folder = Path("figures")
    """Folder to write to."""
    small: bool = False
    """Write only PNGs of 900 pixels, for the docs."""
    strict: bool = False
    """Fail if any figure is not drawn, not only if none is."""

    def __post_init__(self) -> None:
        super().__post_init__()
        from analysis.figures.style import figure_entries  # slow to import

        for name in self.figures:
            if name != ALL and name not in figure_entries():
                choice = ", ".join((ALL, *figure_entries()))
                raise UserError(f"no figure is called {name}; choose from {choice}")

    def run(self, progress: Progress) -> Output:
        from analysis.figures.draw import draw_figures
        from analysis.figures.style import figure_entries

        names = figure_entries() if ALL in self.figures else self.figures
        drawn, lacking = draw_figures(
            names, self.results, self.out, small=self.small, progress=progress
        )
        files = {name: [str(file) for file in written] for name, written in drawn.items()}

        def refuse() -> None:
            if not drawn:
                raise UserError("no figure could be drawn; run the commands above to make results")
            if self.strict and lacking:
                raise UserError(
                    f"not drawn: {', '.join(lacking)}; leave out --strict to accept that"
                )

        return Output(
            {"drawn": files, "lacking": lacking},
            *("figure: " + ", ".join(written) for written in files.values()),
            *(f"not drawn: {name}: {reason}" for name, reason in lacking.items()),
            refuse,
        )


@dataclass(frozen=True, kw_only=True)
class Reproduce(Command):
    """Run every experiment of the paper, draw every figure, and write the report.

    Results go to DIR/results, figures to DIR/figures. DIR/report/index.html is the report, a page
    with every figure next to the paper's claim and with all tables, which opens from disk. The same
    command continues after an interrupt: stages that this version has finished are kept, an
    interrupted sweep continues with its next run. The time of each stage is in
    DIR/results/timings.json.
    """

    kept = RESUMES

    out: opt.Folder = Path("runs/reproduction")
    """Folder to write to."""
    quick: bool = False
    """Short version of a few minutes: few runs, training episodes and co-simulated episodes."""
    report_only: bool = False
    """Only draw the figures and write the report, from the results that DIR/results has. The report
    names missing results with the commands that make them."""
    seed: opt.Seed = 0
    jobs: opt.Jobs = -1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.report_only and (self.quick or self.seed or self.jobs != -1):
            raise UserError(
                "--quick, --seed and --jobs have no effect with --report-only, which runs no "
                "experiment; leave them out"
            )

    def subject(self) -> str:
        return "reproduction"

    def run(self, progress: Progress) -> Output:
        from analysis.profiles import FULL, QUICK
        from minirobots.reproduction import redraw, reproduce

        say = partial(print, file=sys.stderr)
        if self.report_only:
            page = redraw(self.out, progress, say)
        else:
            profile, jobs = QUICK if self.quick else FULL, opt.workers(self.jobs)
            page = reproduce(
                self.out, profile, seed=self.seed, jobs=jobs, progress=progress, say=say
            )
        return Output({"page": str(page)})
