"""`python -m analysis.fig07`: Fig. 7, the motor in open and closed loop, from a recording."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.motor_test import LOOPS, Response, read
from analysis.style import BLACK, BLUE, GREY, VERMILION, WIDTH_IN, save, use_style
from cosim.errors import run_command
from cosim.params import TABLE_II

COLOURS = {"open_loop": VERMILION, "closed_loop": BLUE}
# What the right column shows larger: the start, in which the closed loop is at its limit.
START_S = 0.12


@dataclass(frozen=True)
class Fig07:
    """Draw Fig. 7: speed, voltage and disturbance torque of the motor in open and closed loop.

    The left column shows the whole test, the right one its start. Grey marks where the closed loop
    asks for more than the motor may have, and gets the limit.
    """

    recording: Path = Path("runs/motor_test.rrd")
    """Recording made by `python -m analysis.motor_test`."""
    out: Path = Path("figures/fig07.png")
    """Figure to write; PNG and PDF are written beside each other."""


def _draw(axes: np.ndarray, responses: dict[str, Response], until_s: float) -> None:
    speed, voltage, torque = axes
    for loop in LOOPS:
        response = responses[loop]
        shown = response.time_s <= until_s
        time_s, label = response.time_s[shown], loop.replace("_", " ")
        speed.plot(time_s, response.omega[shown], color=COLOURS[loop], label=label)
        voltage.plot(time_s, response.voltage[shown], color=COLOURS[loop], label=label)
    closed = responses["closed_loop"]
    shown = closed.time_s <= until_s
    time_s = closed.time_s[shown]
    set_point = closed.omega_des[shown]
    speed.plot(time_s, set_point, color=BLACK, linestyle="--", linewidth=0.8, label="set point")
    _mark_saturation([speed, voltage], time_s, closed.voltage[shown])
    for sign in (1, -1):
        voltage.axhline(sign * TABLE_II.V_s_max, color=BLACK, linestyle=":", linewidth=0.8)
    torque.step(time_s, 1e6 * closed.disturbance[shown], color=BLACK, where="post")
    torque.set_xlabel("time in s")


def _mark_saturation(axes: list[Axes], time_s: np.ndarray, voltage: np.ndarray) -> None:
    saturated = np.abs(voltage) >= TABLE_II.V_s_max
    edges = np.flatnonzero(np.diff(np.concatenate([[False], saturated, [False]]).astype(int)))
    for first, end in edges.reshape(-1, 2):
        for each in axes:
            span = float(time_s[first]), float(time_s[min(end, len(time_s) - 1)])
            each.axvspan(*span, color=GREY, alpha=0.25, linewidth=0)


def draw(responses: dict[str, Response]) -> Figure:
    """The figure of a motor test, by loop as `analysis.motor_test.read` gives it."""
    figure, grid = plt.subplots(
        3, 2, figsize=(WIDTH_IN, 5.0), sharex="col", sharey="row", height_ratios=[3, 2, 1]
    )
    _draw(grid[:, 0], responses, responses["closed_loop"].time_s[-1])
    _draw(grid[:, 1], responses, START_S)
    grid[0, 0].set_ylabel("speed ω in rad/s")
    grid[1, 0].set_ylabel("voltage $V_s$ in V")
    grid[2, 0].set_ylabel("d in µN m")
    grid[0, 0].set_title("whole test", loc="left")
    grid[0, 1].set_title(f"first {START_S:g} s; grey: voltage saturated", loc="left")
    grid[0, 0].legend(loc="lower right")
    grid[1, 0].set_ylim(-0.3, 1.12 * TABLE_II.V_s_max)
    grid[1, 0].text(0.99, 0.84, "$V_{s,max}$", transform=grid[1, 0].transAxes, ha="right", va="top")
    return figure


def summary(responses: dict[str, Response]) -> list[str]:
    """Rise times, speeds before and under the disturbance, and saturation, in words."""
    lines = []
    for loop, share in (("open_loop", 0.632), ("closed_loop", 0.9), ("closed_loop", 0.98)):
        response = responses[loop]
        after_s = response.time_s[np.argmax(response.omega > share * response.omega_des)]
        lines.append(
            f"{loop.replace('_', ' ')}: {100 * share:g} % of the set point {after_s:.3f} s"
        )
    for loop in LOOPS:
        # A tenth of a second holds many turns: the ripple averages out.
        ends = [third[-100:].mean() for third in np.array_split(responses[loop].omega, 3)]
        speeds = ", ".join(f"{end:.1f}" for end in ends)
        lines.append(f"{loop.replace('_', ' ')}: {speeds} rad/s without, with and against d")
    closed = responses["closed_loop"]
    saturated_s = closed.time_s[np.abs(closed.voltage) >= TABLE_II.V_s_max].max(initial=0.0)
    highest = np.abs(closed.voltage).max()
    lines.append(f"closed loop: at most {highest:g} V, saturated until {saturated_s:.3f} s")
    return lines


def main() -> None:
    """Command line."""
    options = tyro.cli(Fig07, prog="python -m analysis.fig07")
    use_style()
    responses = read(options.recording)
    figure = draw(responses)
    print("\n".join(summary(responses)))
    print("figure: " + ", ".join(str(path) for path in save(figure, options.out)))


if __name__ == "__main__":
    run_command(main)
