"""Machines from above and from the side, and what their motion primitives do."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Rectangle

from analysis.figures.style import Drawing, figure
from cosim.base.colours import BLACK, BLUE, GREEN, GREY, VERMILION
from cosim.base.plotting import styled
from cosim.calibration.primitives import Primitive, able
from cosim.model.params import TABLE_I, RobotParams, feet_names, motor_names
from cosim.physics.contact.elastic import axis_of

ABOVE, SIDE = (0, 1), (0, 2)  # axes of the body that a view shows
_SHAFT = 0.3  # of the body's radius: length of the arrow along it
_NAMED = 0.78  # of its place: where a foot's name stands
_AROUND, _SHOWN = 1.18, 1.35  # of the radius: where the front is marked, and what is shown
_MOTOR = "#b3d1e6"  # colour of a motor's body
DRIVEN_S = 10.0  # time of the paths of primitives


@styled
def draw_machines(machines: Mapping[str, RobotParams]) -> Figure:
    """Draw machines by name, a column each: from above, and from their right side."""
    columns = max(len(machines), 3)
    figure, grid = plt.subplots(
        2,
        len(machines),
        figsize=(2.4 * columns, 4.2),
        sharex="col",
        squeeze=False,
        height_ratios=(3, 2),
    )
    for axes, (name, robot) in zip(grid.T, machines.items(), strict=True):
        draw_view(axes[0], robot, ABOVE)
        draw_view(axes[1], robot, SIDE)
        axes[0].set_title(name, loc="left", parse_math=False)
        axes[1].set_xlabel("x ahead in mm")
    grid[0, 0].set_ylabel("y to the left in mm")
    grid[1, 0].set_ylabel("height in mm")
    figure.legend(*_labelled(grid[0, 0]), loc="outside lower center", ncols=5)
    return figure


def _labelled(axes: Axes) -> tuple[list, list]:
    handles, labels = axes.get_legend_handles_labels()
    found = dict(zip(labels, handles, strict=True))
    return [*found.values()], [*found]


def draw_view(axes: Axes, robot: RobotParams, view: Sequence[int]) -> None:
    """Draw a machine in mm, in a view: body, motors with their shafts, feet, centre of mass."""
    radius, shown = 500.0 * robot.diameter_m, list(view)
    if shown == [*ABOVE]:
        axes.add_patch(Circle((0.0, 0.0), radius, facecolor=GREY, alpha=0.2))
        axes.plot(_AROUND * radius, 0.0, ">", color=BLACK, markersize=5, label="front")
    else:
        size = 2.0 * radius, 1e3 * robot.height_m
        axes.add_patch(Rectangle((-radius, 0.0), *size, facecolor=GREY, alpha=0.2))
        axes.axhline(0.0, color=BLACK, linewidth=0.8)
    for mount, name in zip(robot.motors, motor_names(len(robot.motors)), strict=True):
        place, axis = 1e3 * np.array(mount.place_m)[shown], np.array(mount.axis)[shown]
        _motor(axes, robot, place, axis)
        axes.plot(*place, "s", color=BLUE, markersize=4, label="motor, at its mass")
        shaft = place + _SHAFT * radius * axis
        axes.plot(*np.array([place, shaft]).T, color=VERMILION, label="shaft")
        if shown == [*ABOVE]:
            axes.annotate(
                name, (place[0], place[1]), (4, 4), textcoords="offset points", color=BLUE
            )
    for foot, name in zip(robot.feet, feet_names(len(robot.feet)), strict=True):
        place = 1e3 * np.array([foot.x_m, foot.y_m, 0.0])[shown]
        axes.plot(*place, "o", color=GREEN, markersize=5, label="foot")
        if foot.leg:
            root = place - 1e3 * foot.leg.length_m * np.array(axis_of(foot.leg))[shown]
            axes.plot(*np.array([place, root]).T, color=GREEN, linewidth=1.2, label="leg")
        if shown == [*ABOVE]:
            axes.text(
                _NAMED * place[0], _NAMED * place[1], name, color=GREEN, ha="center", va="center"
            )
    centre = 1e3 * np.array([robot.com_x_m, robot.com_y_m, robot.com_height_m])[shown]
    axes.plot(*centre, "x", color=BLACK, label="centre of mass")
    axes.set(aspect="equal", xlim=(-_SHOWN * radius, _SHOWN * radius))


def _motor(axes: Axes, robot: RobotParams, place: np.ndarray, axis: np.ndarray) -> None:
    """Draw a motor's cylinder behind its mass: its side and both ends, as they are seen."""
    length, width = 1e3 * robot.motor_length_m, 1e3 * robot.motor_diameter_m
    seen = float(np.hypot(*axis))  # share of the shaft: 0 where it points at the reader
    turn = np.rad2deg(np.arctan2(-axis[1], -axis[0]))
    corner, pivot = (place[0], place[1] - width / 2.0), (place[0], place[1])
    shape: Any = {"angle": turn, "rotation_point": pivot, "color": _MOTOR}
    axes.add_patch(Rectangle(corner, seen * length, width, **shape))
    for x, y in (place, place - length * axis):
        thickness = width * np.sqrt(max(0.0, 1.0 - seen**2))
        axes.add_patch(Ellipse((x, y), thickness, width, angle=turn, color=_MOTOR))


@styled
def draw_primitives(found: Mapping[str, Primitive], robot: RobotParams) -> Figure:
    """Draw a machine from above and where its primitives take it in `DRIVEN_S` without noise."""
    figure, axes = plt.subplots(figsize=(6.4, 5.4))
    draw_view(axes, robot, ABOVE)
    reach_m = 0.5 * robot.diameter_m
    for name, primitive in found.items():
        if able(primitive, name, reach_m):
            path = 1e3 * _path(primitive, reach_m)
            axes.plot(*path.T, linewidth=2.0, label=name.replace("_", " "))
    axes.autoscale(axis="x")
    axes.set_title(f"where primitives take the front in {DRIVEN_S:g} s", loc="left")
    axes.set(xlabel="x ahead in mm", ylabel="y to the left in mm")
    figure.legend(*_labelled(axes), loc="outside right upper")
    width, height = (abs(high - low) for low, high in (axes.get_xlim(), axes.get_ylim()))
    figure.set_figheight(np.clip(1.0 + 4.4 * height / width, 2.6, 5.4))
    return figure


def _path(primitive: Primitive, reach_m: float) -> np.ndarray:
    """Return places of the body's front in m, (n, 2), in which turns are seen too."""
    ahead, left, rate = primitive.mean
    times_s = np.linspace(0.0, DRIVEN_S, 100)
    turned = 0.5 * rate * times_s  # half of the angle: on a circle the chord's direction
    chord = times_s * np.sinc(turned / np.pi) * np.exp(1j * turned)
    front = (ahead + 1j * left) * chord + reach_m * np.exp(2j * turned)
    return np.column_stack([front.real, front.imag])


@figure(
    "fig04",
    "The robot from above and from its right side, to scale: feet A, B, C and motors D, E",
    claim="three contact points and two vibration motors, at φ = 90° and −90°.",
)
def fig04(results: Path) -> Drawing:
    """Draw the paper's robot; no result is needed."""
    robot = TABLE_I
    motor_radius_m = robot.motors[0].place_m[1]
    ours = (
        f"Feet on a circle of {1e3 * robot.foot_radius_m:g} mm and eccentric masses "
        f"{1e3 * motor_radius_m:g} mm from the centre (both assumed; the layout is that of "
        "Fig. 4b); diameter and size of the motors are those of Table I. The robot drives forwards "
        "at (ω_D, ω_E) = (−, +)."
    )
    radii = {"foot_radius_m": robot.foot_radius_m, "motor_radius_m": motor_radius_m}
    return Drawing(draw_machines({"": robot}), (ours,), radii)
