"""`python -m analysis.figures`: draw figures from a folder of results."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from analysis.reading.results import FIGURES
from cosim.base.command import Json, parse, print_json
from cosim.base.errors import UserError, run_command

ALL = "all"


@dataclass(frozen=True)
class Figures:
    """Draw figures of the paper, and some that it lacks, from a folder of results.

    Each figure becomes a PNG and a PDF of the same name, and a .json with its caption: the paper's
    claim and our numbers. fig02 platform and fig03 its motion, fig04 robot, fig05 scenarios, fig06
    speed loop and fig07 its response, fig08 learning of one robot, fig09 its paths, fig10
    coefficient c, fig11 learning of pairs, fig12 their paths, motor_cycle forces over a turn,
    obstacles and groups scenarios of this project, path_ratio paths compared with the optimum,
    sequel learning of groups, transfer success in co-simulation by training method. A figure whose
    results are missing is left out, with the command that makes them.
    """

    figures: Annotated[tuple[str, ...], tyro.conf.Positional] = (ALL,)
    """Figures to draw by name, or all."""
    results: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/reproduction/results")
    """Folder of results, as `python -m analysis.reproduce` fills it."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("figures")
    """Folder to write to."""
    small: bool = False
    """Write only PNGs of some 900 pixels with few colours, for the docs."""
    strict: bool = False
    """Fail if any figure cannot be drawn, not only if all cannot."""
    json: Json = False

    def __post_init__(self) -> None:
        for name in self.figures:
            if name != ALL and name not in FIGURES:
                known = ", ".join((ALL, *FIGURES))
                raise UserError(f"no figure is called {name}; choose from {known}")


def main() -> None:
    """Command line; see `Figures`."""
    options = parse(Figures, "analysis.figures")
    from analysis.figures.draw import draw_figures
    from cosim.base.progress import progress_bars

    names = FIGURES if ALL in options.figures else options.figures
    with progress_bars() as progress:
        drawn, lacking = draw_figures(
            names, options.results, options.out, small=options.small, progress=progress
        )
    for files in drawn.values():
        print("figure: " + ", ".join(map(str, files)))
    for name, reason in lacking.items():
        print(f"not drawn: {name}: {reason}")
    if options.json:
        files = {name: list(map(str, written)) for name, written in drawn.items()}
        print_json({"drawn": files, "lacking": lacking})
    if not drawn:
        raise UserError("no figure could be drawn; the commands that make results stand above")
    if options.strict and lacking:
        raise UserError(f"not drawn: {', '.join(lacking)}; leave out --strict to accept that")


if __name__ == "__main__":
    run_command(main)
