"""`python -m analysis.fig05`: Fig. 5, the scenarios."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import tyro
from matplotlib.figure import Figure

from analysis.board import draw_board
from analysis.style import WIDTH_IN, save, use_style
from cosim.errors import run_command
from cosim.scenario import BUILT_IN, Scenario, find_scenario


@dataclass(frozen=True)
class Fig05:
    """Draw Fig. 5: boards with start cells (light), targets (full colour) and the central zone."""

    scenarios: tuple[str, ...] = tuple(BUILT_IN)
    """Built-in scenarios or scenario files (.toml), one board each."""
    out: Path = Path("figures/fig05.png")
    """Figure to write; PNG and PDF are written beside each other."""


def draw(scenarios: list[Scenario]) -> Figure:
    """One board per scenario, in a row."""
    size = (WIDTH_IN, 0.35 + WIDTH_IN / len(scenarios))
    figure, grid = plt.subplots(1, len(scenarios), figsize=size, squeeze=False)
    for axes, scenario in zip(grid[0], scenarios, strict=True):
        draw_board(axes, scenario)
        axes.set_title(scenario.name, loc="left")
    grid[0, 0].set_ylabel("y in cm")
    return figure


def main() -> None:
    """Command line."""
    options = tyro.cli(Fig05, prog="python -m analysis.fig05")
    use_style()
    figure = draw([find_scenario(name) for name in options.scenarios])
    print("figure: " + ", ".join(str(path) for path in save(figure, options.out)))


if __name__ == "__main__":
    run_command(main)
