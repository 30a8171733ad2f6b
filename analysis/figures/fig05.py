"""Fig. 5 and its like with obstacles and groups; boards as other figures draw them too."""

import math
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from analysis.figures.style import WIDTH_IN, Drawing
from cosim.base.colours import GREY, robot_colour
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import AMONG_OBSTACLES, IN_GROUPS, PAPER, find_scenario


def draw_board(axes: Axes, scenario: Scenario) -> None:
    """The board in cm: zone and obstacles grey, starts and targets in their robots' colours."""
    cell_cm = 100.0 * scenario.cell_m

    def fill(x: int, y: int, colour: str, alpha: float, cells: tuple[int, int] = (1, 1)) -> None:
        size_cm = (cells[0] * cell_cm, cells[1] * cell_cm)
        style = {"facecolor": colour, "alpha": alpha, "linewidth": 0}
        axes.add_patch(Rectangle((x * cell_cm, y * cell_cm), *size_cm, **style))

    left, bottom, right, top = scenario.zone
    fill(left, bottom, GREY, 0.2, (right - left + 1, top - bottom + 1))
    for x, y in scenario.obstacles:
        fill(x, y, GREY, 0.8)
    for robot, (target, starts) in enumerate(zip(scenario.targets, scenario.starts, strict=True)):
        for x, y in starts:
            fill(x, y, robot_colour(robot), 0.25)
        fill(*target, robot_colour(robot), 1.0)
    width, height = (100.0 * size for size in scenario.size_m)
    axes.set(xlim=(0, width), ylim=(0, height), aspect="equal", xlabel="x in cm")
    axes.grid(visible=False)
    axes.spines[["right", "top"]].set_visible(True)


def _draw(scenarios: list[Scenario]) -> Figure:
    """Draw one board per scenario, in a row."""
    size = (WIDTH_IN, 0.35 + WIDTH_IN / len(scenarios))
    figure, grid = plt.subplots(1, len(scenarios), figsize=size, squeeze=False)
    for axes, scenario in zip(grid[0], scenarios, strict=True):
        draw_board(axes, scenario)
        axes.set_title(scenario.name, loc="left")
    grid[0, 0].set_ylabel("y in cm")
    return figure


def make(results: Path) -> Drawing:
    """Draw the paper's scenarios; no result is needed."""
    scenarios = [find_scenario(name) for name in PAPER]
    width, height = (100.0 * size for size in scenarios[0].size_m)
    left, bottom, right, top = scenarios[0].zone
    starts = {s.name: [len(cells) for cells in s.starts] for s in scenarios}
    listed = ", ".join(f"{name}: {' and '.join(map(str, n))}" for name, n in starts.items())
    cell_cm = 100.0 * scenarios[0].cell_m
    return Drawing(
        _draw(scenarios),
        (
            f"{width:.0f} × {height:.0f} cm in cells of {cell_cm:g} cm, a zone of "
            f"{(right - left + 1) * cell_cm:g} × {(top - bottom + 1) * cell_cm:g} cm.",
            f"Start cells of each robot, by scenario: {listed}.",
        ),
        {"size_cm": [width, height], "cell_cm": cell_cm, "start_cells": starts},
    )


def among_obstacles(results: Path) -> Drawing:
    """Draw the built-in scenarios with obstacles; no result is needed."""
    scenarios = [find_scenario(name) for name in AMONG_OBSTACLES]
    closed = {s.name: len(s.obstacles) for s in scenarios}
    ours = tuple(f"{s.name}: {s.title}, obstacles on {closed[s.name]} cells." for s in scenarios)
    return Drawing(_draw(scenarios), ours, {"closed_cells": closed})


def in_groups(results: Path) -> Drawing:
    """Draw the built-in scenarios of four and six robots; no result is needed."""
    scenarios = [find_scenario(name) for name in IN_GROUPS]
    starts = {s.name: math.prod(map(len, s.starts)) for s in scenarios}
    ours = tuple(
        f"{s.name}: {s.title}, {starts[s.name]:,} combinations of starts." for s in scenarios
    )
    return Drawing(_draw(scenarios), ours, {"combinations_of_starts": starts})
