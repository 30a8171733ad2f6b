"""Draw the paper's figures from a folder of results."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tyro

from analysis.reading.results import FIGURES
from cosim.base.errors import UserError
from cosim.base.progress import Progress
from minirobots.options import CommandOptions, Folder

ALL = "all"


class Figures(CommandOptions):
    """Draw figures of the paper, and some that it lacks, from a folder of results.

    Each figure becomes a PNG and a PDF of the same name, and a .json with its caption: the paper's
    claim and our numbers. fig02 platform and fig03 its motion, fig04 robot, fig05 scenarios, fig06
    speed loop and fig07 its response, fig08 learning of one robot, fig09 its paths, fig10
    coefficient c, fig11 learning of pairs, fig12 their paths, motor_cycle forces over a turn,
    obstacles and groups scenarios of this project, path_ratio paths compared with the optimum,
    sequel learning of groups, transfer success in co-simulation by training method. A figure
    without results is left out, and the command that makes them is printed.
    """

    figures: tyro.conf.Positional[tuple[str, ...]] = (ALL,)
    """Figures to draw by name, or all."""
    results: Folder = Path("runs/reproduction/results")
    """Folder of results, as `minirobots reproduce` fills it."""
    out: Folder = Path("figures")
    """Folder to write to."""
    small: bool = False
    """Write only PNGs of 900 pixels, for the docs."""
    strict: bool = False
    """Fail if any figure is not drawn, not only if none is."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.figures:
            if name != ALL and name not in FIGURES:
                known = ", ".join((ALL, *FIGURES))
                raise UserError(f"no figure is called {name}; choose from {known}")


def run(options: Figures, progress: Progress) -> Iterator[Any]:
    """Draw the figures, and print their files and why others are not drawn.

    Raises:
        UserError: none could be drawn, or not all that had to be.
    """
    from analysis.figures.draw import draw_figures

    names = FIGURES if ALL in options.figures else options.figures
    drawn, lacking = draw_figures(
        names, options.results, options.out, small=options.small, progress=progress
    )
    files = {name: [str(file) for file in written] for name, written in drawn.items()}
    yield {"drawn": files, "lacking": lacking}
    for written in files.values():
        print("figure: " + ", ".join(written))
    for name, reason in lacking.items():
        print(f"not drawn: {name}: {reason}")
    if not drawn:
        raise UserError("no figure could be drawn; run the commands above to make results")
    if options.strict and lacking:
        raise UserError(f"not drawn: {', '.join(lacking)}; leave out --strict to accept that")
