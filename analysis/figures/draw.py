"""`python -m analysis.figures`: every figure of the project, drawn from a results folder.

Figures are drawn by their own modules, `DRAWN_BY` says which; where results lie, and which command
makes them, is said in `analysis.reading.results`. Nothing is simulated here.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import tyro

from analysis.figures import fig03, fig05, fig07, learning_figures, motor_cycle, paths
from analysis.figures import transfer as transfer_figure
from analysis.figures.style import Drawing, FigureError, save, use_style, write_caption
from analysis.reading.results import FIGURES, missing
from analysis.screenshot import shrink
from cosim.base.errors import UserError, run_command
from cosim.base.storage import replacing

DRAWN_BY: dict[str, Callable[[Path], Drawing]] = {
    "fig03": fig03.make,
    "fig05": fig05.make,
    "fig07": fig07.make,
    "fig08": learning_figures.fig08,
    "fig09": paths.fig09,
    "fig10": learning_figures.fig10,
    "fig11": learning_figures.fig11,
    "fig12": paths.fig12,
    "motor_cycle": motor_cycle.make,
    "path_ratio": learning_figures.path_ratio,
    "transfer": transfer_figure.make,
}
ALL = "all"
# Of a page of the docs; such a picture takes well under 150 kB.
SMALL_WIDTH_PX = 900


@dataclass(frozen=True)
class Figures:
    """Draw figures of the paper, and three that it lacks, from a folder of results.

    Each figure becomes a PNG and a PDF of the same name, and a .json with its caption: the paper's
    claim and our numbers. fig03 platform, fig05 scenarios, fig07 motor, fig08 learning of one
    robot, fig09 its paths, fig10 coefficient c, fig11 learning of pairs, fig12 their paths,
    motor_cycle forces over a turn, path_ratio paths beside the optimum, transfer success in
    co-simulation by training method. A figure whose results are missing is left out, with the
    command that makes them.
    """

    figures: Annotated[tuple[str, ...], tyro.conf.Positional] = (ALL,)
    """Figures to draw by name, or all."""
    results: Path = Path("results")
    """Folder of results, as `python -m analysis.reproduce` fills it."""
    out: Path = Path("figures")
    """Folder to write to."""
    small: bool = False
    """Write only PNGs of some 900 pixels with few colours, for the docs."""
    strict: bool = False
    """Fail if any figure cannot be drawn, not only if all cannot."""
    json: bool = False
    """Print a JSON object as the last line of output."""

    def __post_init__(self) -> None:
        for name in self.figures:
            if name != ALL and name not in FIGURES:
                known = ", ".join((ALL, *FIGURES))
                raise FigureError(f"no figure is called {name}; choose from {known}")

    def names(self) -> list[str]:
        """The figures asked for, each once."""
        asked = FIGURES if ALL in self.figures else self.figures
        return list(dict.fromkeys(asked))


def draw_figures(options: Figures) -> tuple[dict[str, list[Path]], dict[str, str]]:
    """Draw what can be drawn.

    Returns:
        Files written, by figure, and why the other figures could not be drawn.

    Raises:
        OSError: the folder cannot be written.
    """
    use_style()
    drawn: dict[str, list[Path]] = {}
    lacking: dict[str, str] = {}
    for name in options.names():
        needed = missing(name, options.results)
        if needed:
            commands = "; ".join(f"`{result.command(options.results)}`" for result in needed)
            lacking[name] = f"run {commands} first"
            continue
        try:
            drawing = DRAWN_BY[name](options.results)
        except UserError as error:
            lacking[name] = str(error)
            continue
        drawn[name] = _write(name, drawing, options)
        plt.close(drawing.figure)
    return drawn, lacking


def _write(name: str, drawing: Drawing, options: Figures) -> list[Path]:
    picture = options.out / f"{name}.png"
    if options.small:
        with replacing(picture) as temporary:
            drawing.figure.savefig(temporary)
        shrink(picture, SMALL_WIDTH_PX)
        return [picture]
    return [*save(drawing.figure, picture), write_caption(drawing.caption, options.out)]


def main() -> None:
    """Command line; see `Figures`."""
    options = tyro.cli(
        Figures, prog="python -m analysis.figures", config=(tyro.conf.FlagCreatePairsOff,)
    )
    drawn, lacking = draw_figures(options)
    for files in drawn.values():
        print("figure: " + ", ".join(map(str, files)))
    for name, reason in lacking.items():
        print(f"not drawn: {name}: {reason}")
    if options.json:
        content: dict[str, Any] = {
            "drawn": {name: list(map(str, files)) for name, files in drawn.items()},
            "lacking": lacking,
        }
        print(json.dumps(content))
    if not drawn:
        raise FigureError("no figure could be drawn; the commands that make results stand above")
    if options.strict and lacking:
        raise FigureError(f"not drawn: {', '.join(lacking)}; leave out --strict to accept that")


if __name__ == "__main__":
    run_command(main)
