"""Fig. 2 and 6 as schematics: the platform, and the speed loop.

Signals of the loop have the names of the motor FMU's variables. No result is needed.
"""

import math
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

from analysis.figures.style import WIDTH_IN, Drawing, figure
from cosim.base.colours import BLACK, BLUE, GREY, VERMILION
from cosim.model.params import TABLE_II


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)


def _blank(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.axis("off")


@figure(
    "fig02",
    "Platform of one degree of freedom: an eccentric mass m at a distance r of the axis O",
    claim="the rotating mass gives the forces of Eq. (1).",
)
def fig02(results: Path) -> Drawing:
    """Draw the platform of one degree of freedom, with the signs of Eq. (1)."""
    figure, axes = plt.subplots(figsize=(WIDTH_IN / 2, 2.2))
    _blank(axes, (-3.4, 3.4), (-1.5, 2.7))
    axes.add_patch(Rectangle((-2.4, -1.0), 4.8, 2.4, facecolor=GREY, alpha=0.2))
    axes.axhline(-1.2, color=BLACK, linewidth=0.8)
    for x, name in ((-2.1, "A"), (2.1, "B")):
        axes.add_patch(Circle((x, -1.1), 0.1, color=BLACK))
        axes.text(x, -0.85, name, ha="center")
    angle, arm = math.radians(50.0), 0.9
    mass = arm * math.sin(angle), 0.2 - arm * math.cos(angle)
    axes.plot([0.0, mass[0]], [0.2, mass[1]], color=BLACK, linewidth=1.0)
    axes.plot([0.0, 0.0], [0.2, 0.2 - arm], color=GREY, linestyle=":", linewidth=0.8)
    axes.add_patch(Circle((0.0, 0.2), 0.06, color=BLACK))
    axes.add_patch(Circle(mass, 0.16, color=BLUE))
    axes.text(-0.12, 0.3, "O", ha="right")
    axes.text(0.16, -0.62, "θ")
    axes.text(mass[0] + 0.22, mass[1] - 0.05, "m at r", color=BLUE)
    _arrow(axes, (0.0, 0.2), (1.3, 0.2), VERMILION)
    axes.text(1.35, 0.22, "$f_{OY}$", color=VERMILION)
    _arrow(axes, (0.0, 0.2), (0.0, -0.95), VERMILION)
    axes.text(-0.1, -0.75, "$f_{OZ}$", color=VERMILION, ha="right")
    for end, name in (((-1.9, 1.9), "Y"), ((-2.6, 2.6), "Z")):
        _arrow(axes, (-2.6, 1.9), end, BLACK)
        axes.text(end[0] + 0.08, end[1], name)
    ours = (
        "θ = 0 where the mass hangs straight down; the directions of the forces are those of "
        f"Eq. (1) at the θ drawn. Here m = {1e3 * TABLE_II.m:g} g and r = {1e3 * TABLE_II.r:g} mm "
        "(Table II)."
    )
    return Drawing(figure, (ours,), {"m_kg": TABLE_II.m, "r_m": TABLE_II.r})


# Blocks of Fig. 6: centre and half width, and what stands in them.
_BLOCKS = (
    (3.2, 1.05, "PI, Eq. (14)\n$K_p + K_i/s$"),
    (6.1, 0.85, "limit\n±$V_{s,max}$"),
    (8.9, 0.95, "motor\nEq. (13)"),
)
_SUM, _HEIGHT, _FEEDBACK = 1.2, 0.6, -1.7


@figure(
    "fig06",
    "Speed loop of one motor",
    claim="a PI controller (Eq. 14) with limited voltage.",
)
def fig06(results: Path) -> Drawing:
    """Draw the speed loop of one motor with its signals."""
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.2))
    _blank(axes, (-0.6, 11.6), (-2.3, 1.5))
    axes.add_patch(Circle((_SUM, 0.0), 0.22, facecolor="white", edgecolor=BLACK))
    axes.add_patch(Circle((_SUM, _FEEDBACK), 0.22, facecolor="white", edgecolor=BLACK))
    for x, half, text in _BLOCKS:
        box = FancyBboxPatch(
            (x - half, -_HEIGHT), 2 * half, 2 * _HEIGHT, "round,pad=0.02", facecolor="white"
        )
        axes.add_patch(box)
        axes.text(x, 0.0, text, ha="center", va="center")
    edges = [_SUM + 0.22, *(side for x, half, _ in _BLOCKS for side in (x - half, x + half)), 11.3]
    names = ("e", "u", "$V_s$", "ω")
    for start, end, name in zip(edges[::2], edges[1::2], names, strict=True):
        _arrow(axes, (start, 0.0), (end, 0.0), BLACK)
        axes.text((start + end) / 2, 0.15, name, ha="center", color=BLUE)
    _arrow(axes, (-0.5, 0.0), (_SUM - 0.22, 0.0), BLACK)
    axes.text(-0.5, 0.15, "$ω_{des}$", color=BLUE)
    _arrow(axes, (8.9, 1.4), (8.9, _HEIGHT), BLACK)
    axes.text(9.05, 1.15, "d", color=BLUE)
    axes.plot([10.8, 10.8], [0.0, _FEEDBACK], color=BLACK, linewidth=0.9)
    _arrow(axes, (10.8, _FEEDBACK), (_SUM + 0.22, _FEEDBACK), BLACK)
    _arrow(axes, (_SUM, _FEEDBACK + 0.22), (_SUM, -0.22), BLACK)
    _arrow(axes, (-0.5, _FEEDBACK), (_SUM - 0.22, _FEEDBACK), BLACK)
    axes.text(-0.5, _FEEDBACK + 0.15, "noise ±5 %", color=BLUE)
    axes.text(_SUM - 0.15, -0.5, "−", ha="right", va="center")
    gains = {"K_p": TABLE_II.K_p, "K_i": TABLE_II.K_i, "V_s_max": TABLE_II.V_s_max}
    ours = (
        f"K_p = {TABLE_II.K_p:g} V s/rad, K_i = {TABLE_II.K_i:g} V/rad, V_s_max = "
        f"{TABLE_II.V_s_max:g} V (Table II). The integral holds while u is beyond the limit and e "
        "would push it further out (assumed). All of it is in the motor FMU, with these names."
    )
    return Drawing(figure, (ours,), gains)
