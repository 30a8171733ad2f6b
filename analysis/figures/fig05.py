"""Fig. 5 and its like with obstacles and groups; boards as other figures draw them too."""

import math
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from analysis.figures.style import WIDTH_IN, Drawing, figure
from cosim.base.colours import GREY, robot_colour
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import AMONG_OBSTACLES, IN_GROUPS, PAPER, find_scenario

_IN_A_ROW = 3  # boards
_LABEL = 2.6  # cells, half the width of a target's label


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
    """Draw boards with cell numbers, three in a row, with every robot at one of its starts."""
    rows = -(-len(scenarios) // _IN_A_ROW)
    size = (WIDTH_IN, rows * (0.35 + WIDTH_IN / _IN_A_ROW))
    figure, grid = plt.subplots(rows, _IN_A_ROW, figsize=size, squeeze=False)
    for axes in grid.flat[len(scenarios) :]:
        axes.set_axis_off()
    for axes, scenario in zip(grid.flat, scenarios, strict=False):
        draw_board(axes, scenario)
        _draw_robots(axes, scenario)
        for axis, cells in ((axes.xaxis, scenario.columns), (axes.yaxis, scenario.rows)):
            numbers = range(0, cells, 5)
            places = [100.0 * scenario.cell_m * (number + 0.5) for number in numbers]
            axis.set_ticks(places, map(str, numbers), fontsize=7)
        axes.set(xlabel="column", ylabel="row")
        axes.set_title(scenario.name, loc="left")
    return figure


def _draw_robots(axes: Axes, scenario: Scenario) -> None:
    """Draw robots, each whole and at a start of its own, and the cells of their targets."""
    radius_cm, cell_cm = 50.0 * scenario.diameter_m, 100.0 * scenario.cell_m
    for robot, (target, cells) in enumerate(zip(scenario.targets, scenario.starts, strict=True)):
        colour = robot_colour(robot)
        column, row = cells[len(cells) * (robot + 1) // (scenario.robots + 1)]
        place = (column + 0.5) * cell_cm, (row + 0.5) * cell_cm
        axes.add_patch(Circle(place, radius_cm, color=colour, alpha=0.4))
        axes.text(*place, str(robot + 1), ha="center", va="center", fontsize=8)
        middle = min(max(target[0] + 0.5, _LABEL), scenario.columns - _LABEL)  # within the rim
        above = middle * cell_cm, (target[1] + 1.5) * cell_cm
        axes.text(*above, "{}, {}".format(*target), color=colour, ha="center", fontsize=6)
    width, height = (100.0 * size for size in scenario.size_m)
    axes.add_patch(Rectangle((0.0, 0.0), width, height, fill=False))
    axes.spines[:].set_visible(False)
    axes.set(xlim=(-radius_cm, width + radius_cm), ylim=(-radius_cm, height + radius_cm))


@figure(
    "fig05",
    "Scenarios by columns and rows of cells: start cells (light), each robot at one of them, "
    "targets with their cells (full colour) and the central zone (grey)",
    claim=(
        "30 × 30 cm, a zone of 7 × 7 cm at the centre, targets in single cells on its border, "
        "starts on the sides of the board."
    ),
)
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


@figure(
    "obstacles",
    "Scenarios with obstacles (dark), start cells (light), targets (full colour)",
)
def among_obstacles(results: Path) -> Drawing:
    """Draw the built-in scenarios with obstacles; no result is needed."""
    scenarios = [find_scenario(name) for name in AMONG_OBSTACLES]
    closed = {s.name: len(s.obstacles) for s in scenarios}
    ours = tuple(f"{s.name}: {s.title}, obstacles on {closed[s.name]} cells." for s in scenarios)
    return Drawing(_draw(scenarios), ours, {"closed_cells": closed})


@figure(
    "groups",
    "Scenarios of groups: start cells (light) and target (full colour) of each robot",
)
def in_groups(results: Path) -> Drawing:
    """Draw the built-in scenarios of four and six robots; no result is needed."""
    scenarios = [find_scenario(name) for name in IN_GROUPS]
    starts = {s.name: math.prod(map(len, s.starts)) for s in scenarios}
    ours = tuple(
        f"{s.name}: {s.title}, {starts[s.name]:,} combinations of starts." for s in scenarios
    )
    return Drawing(_draw(scenarios), ours, {"combinations_of_starts": starts})
