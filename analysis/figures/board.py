"""Boards drawn from above: cells, zone, starts and targets."""

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from analysis.figures.style import BLUE, GREEN, GREY, PURPLE, VERMILION
from cosim.base.scenario import Scenario

ROBOT_COLOURS = (BLUE, VERMILION, GREEN, PURPLE)


def draw_board(axes: Axes, scenario: Scenario) -> None:
    """The board in cm: zone and obstacles grey, starts and targets in their robots' colours."""
    cell_cm = 100.0 * scenario.cell_m
    width, height = (100.0 * size for size in scenario.size_m)
    left, bottom, right, top = scenario.zone
    axes.add_patch(
        Rectangle(
            (left * cell_cm, bottom * cell_cm),
            (right - left + 1) * cell_cm,
            (top - bottom + 1) * cell_cm,
            facecolor=GREY,
            alpha=0.2,
            linewidth=0,
        )
    )
    for x, y in scenario.obstacles:
        axes.add_patch(_cell(x, y, cell_cm, GREY, 0.8))
    for robot, (target, starts) in enumerate(zip(scenario.targets, scenario.starts, strict=True)):
        colour = robot_colour(robot)
        for x, y in starts:
            axes.add_patch(_cell(x, y, cell_cm, colour, 0.25))
        axes.add_patch(_cell(*target, cell_cm, colour, 1.0))
    axes.set(xlim=(0, width), ylim=(0, height), aspect="equal", xlabel="x in cm")
    axes.grid(visible=False)
    axes.spines[["right", "top"]].set_visible(True)


def robot_colour(robot: int) -> str:
    """Colour of a robot and of what belongs to it."""
    return ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]


def _cell(x: int, y: int, cell_cm: float, colour: str, alpha: float) -> Rectangle:
    return Rectangle(
        (x * cell_cm, y * cell_cm), cell_cm, cell_cm, facecolor=colour, alpha=alpha, linewidth=0
    )
