"""Fig. 7: the motor in open and closed loop, from a recording of `minirobots motor-test`."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.style import WIDTH_IN, Caption, Drawing
from analysis.reading.findings import intervals
from analysis.reading.motor_test import LOOPS, Response, read, rise
from analysis.reading.results import FIGURES, RESULTS
from cosim.base.plotting import BLACK, BLUE, GREY, VERMILION
from cosim.model.params import TABLE_II

COLOURS = {"open_loop": VERMILION, "closed_loop": BLUE}
# What the right column shows larger: the start, in which the closed loop is at its limit.
START_S = 0.12


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
    for first, last in intervals(saturated):
        for each in axes:
            span = float(time_s[first]), float(time_s[min(last + 1, len(time_s) - 1)])
            each.axvspan(*span, color=GREY, alpha=0.25, linewidth=0)


def draw(responses: dict[str, Response]) -> Figure:
    """The figure of a motor test, by loop as `analysis.reading.motor_test.read` gives it."""
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


_TIMES = {
    "to_63_percent_s": "63 %",
    "to_90_percent_s": "90 %",
    "to_98_percent_s": "98 %",
    "within_2_percent_s": "within ±2 %",
}
EARLY_S = 0.05
# A tenth of a second holds many turns: the ripple averages out.
_AVERAGED = 100


def caption(responses: dict[str, Response]) -> Caption:
    """Response times, speeds before and under the disturbance, and saturation."""
    numbers: dict[str, Any] = {}
    for loop in LOOPS:
        response = responses[loop]
        undisturbed = response.disturbance == 0.0
        risen = rise(
            response.time_s[undisturbed], response.omega[undisturbed], response.omega_des[0]
        )
        numbers |= {f"{loop}_{name}": value for name, value in risen._asdict().items()}
        early = int(np.searchsorted(response.time_s, EARLY_S))
        numbers[f"{loop}_early_rad_s"] = float(response.omega[early])
        numbers[f"{loop}_speeds_rad_s"] = [
            float(third[-_AVERAGED:].mean()) for third in np.array_split(response.omega, 3)
        ]
    closed = responses["closed_loop"]
    saturated_s = closed.time_s[np.abs(closed.voltage) >= TABLE_II.V_s_max].max(initial=0.0)
    numbers["closed_loop_highest_v"] = float(np.abs(closed.voltage).max())
    numbers["closed_loop_saturated_until_s"] = float(saturated_s)

    def speeds(loop: str) -> str:
        return ", ".join(f"{value:.1f}" for value in numbers[f"{loop}_speeds_rad_s"])

    times = "; ".join(
        f"{text}: "
        + ", ".join(
            f"{loop.replace('_', ' ')} {numbers[key]:.3f} s"
            for loop in LOOPS
            if numbers[key := f"{loop}_{name}"] is not None
        )
        for name, text in _TIMES.items()
    )
    return Caption(
        "fig07",
        "Speed, voltage and disturbance torque d of the motor in open and closed loop; grey: the "
        "closed loop asks for more than the motor may have",
        "in closed loop the desired speed is achieved despite the disturbance and the limited "
        "voltage, and the response is significantly faster than in open loop.",
        (
            f"Speeds without, with and against d: open loop {speeds('open_loop')} rad/s, closed "
            f"loop {speeds('closed_loop')} rad/s, set point {closed.omega_des[-1]:g} rad/s.",
            f"Time until the speed reaches a share of the set point, or stays near it: {times}.",
            "The response is faster to 90 % and not to the end: K_i / K_p = "
            f"{TABLE_II.K_i / TABLE_II.K_p:.2f} 1/s leaves a slow pole.",
            f"Speed after {1e3 * EARLY_S:g} ms: open loop {numbers['open_loop_early_rad_s']:.0f} "
            f"rad/s, closed loop {numbers['closed_loop_early_rad_s']:.0f} rad/s.",
            f"The closed loop's voltage is at its limit of {TABLE_II.V_s_max:g} V until "
            f"{saturated_s:.3f} s.",
        ),
        numbers,
        FIGURES["fig07"],
    )


def make(results: Path) -> Drawing:
    """Draw the figure of a results folder.

    Raises:
        MotorTestError: see `analysis.reading.motor_test.read`.
    """
    responses = read(RESULTS["motor_test"].location(results))
    return Drawing(draw(responses), caption(responses))
