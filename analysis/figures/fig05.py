"""Fig. 5: the scenarios, from their definitions."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from analysis.figures.board import draw_board
from analysis.figures.caption import Caption, Drawing
from analysis.figures.style import WIDTH_IN
from cosim.base.scenario import BUILT_IN, Scenario


def draw(scenarios: list[Scenario]) -> Figure:
    """One board per scenario, in a row."""
    size = (WIDTH_IN, 0.35 + WIDTH_IN / len(scenarios))
    figure, grid = plt.subplots(1, len(scenarios), figsize=size, squeeze=False)
    for axes, scenario in zip(grid[0], scenarios, strict=True):
        draw_board(axes, scenario)
        axes.set_title(scenario.name, loc="left")
    grid[0, 0].set_ylabel("y in cm")
    return figure


def caption(scenarios: list[Scenario]) -> Caption:
    """The caption of some scenarios."""
    width, height = scenarios[0].size_m
    left, bottom, right, top = scenarios[0].zone
    starts = {s.name: [len(cells) for cells in s.starts] for s in scenarios}
    listed = ", ".join(f"{name}: {' and '.join(map(str, n))}" for name, n in starts.items())
    cell_cm = 100.0 * scenarios[0].cell_m
    return Caption(
        "fig05",
        "Scenarios with start cells (light), targets (full colour) and the central zone (grey)",
        "30 × 30 cm, a zone of 7 × 7 cm at the centre, targets in single cells on its border, "
        "starts on the sides of the board.",
        (
            f"{100 * width:.0f} × {100 * height:.0f} cm in cells of {cell_cm:g} cm, a zone of "
            f"{(right - left + 1) * cell_cm:g} × {(top - bottom + 1) * cell_cm:g} cm.",
            f"Start cells of each robot, by scenario: {listed}.",
        ),
        {"size_cm": [100.0 * width, 100.0 * height], "cell_cm": cell_cm, "start_cells": starts},
    )


def make(results: Path) -> Drawing:
    """Draw the built-in scenarios; no result is needed."""
    scenarios = list(BUILT_IN.values())
    return Drawing(draw(scenarios), caption(scenarios))
