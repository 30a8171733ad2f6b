"""Fig. 7: the motor in open and closed loop, from a recording of `minirobots motor-test`."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.style import WIDTH_IN, Caption, Claim, Drawing, verdicts
from analysis.reading.findings import intervals
from analysis.reading.motor_test import LOOPS, Response, read, rise
from analysis.reading.results import FIGURES, RESULTS
from cosim.base.plotting import BLACK, BLUE, GREY, VERMILION
from cosim.model.params import TABLE_II, describe, motor_time_constant
from cosim.recording.reader import read_rrd

COLOURS = {"open_loop": VERMILION, "closed_loop": BLUE}
# What the right column shows larger: the start, in which the closed loop is at its limit.
START_S = 0.12


def _draw(axes: np.ndarray, responses: dict[str, Response], until_s: float, limit_v: float) -> None:
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
    _mark_saturation([speed, voltage], time_s, np.abs(closed.voltage[shown]) >= limit_v)
    for sign in (1, -1):
        voltage.axhline(sign * limit_v, color=BLACK, linestyle=":", linewidth=0.8)
    torque.step(time_s, 1e6 * closed.disturbance[shown], color=BLACK, where="post")
    torque.set_xlabel("time in s")


def _mark_saturation(axes: list[Axes], time_s: np.ndarray, saturated: np.ndarray) -> None:
    for first, last in intervals(saturated):
        for each in axes:
            span = float(time_s[first]), float(time_s[min(last + 1, len(time_s) - 1)])
            each.axvspan(*span, color=GREY, alpha=0.25, linewidth=0)


def others(motor: Mapping[str, float]) -> str:
    """Return the parameters that differ from Table II as text, empty if none does."""
    units = {name: quantity.unit for name, (_, quantity) in describe(TABLE_II).items()}
    return ", ".join(
        f"{name} = {value:.4g} {units.get(name, '')}".strip()
        for name, value in motor.items()
        if value != TABLE_II._asdict().get(name)
    )


def draw(responses: dict[str, Response], motor: Mapping[str, float] = TABLE_II._asdict()) -> Figure:
    """The figure of a motor test; the motor's parameters are given as far as they are known."""
    limit_v = motor.get("V_s_max", TABLE_II.V_s_max)
    figure, grid = plt.subplots(
        3, 2, figsize=(WIDTH_IN, 5.0), sharex="col", sharey="row", height_ratios=[3, 2, 1]
    )
    _draw(grid[:, 0], responses, responses["closed_loop"].time_s[-1], limit_v)
    _draw(grid[:, 1], responses, START_S, limit_v)
    figure.suptitle(others(motor), fontsize=8)
    grid[0, 0].set_ylabel("speed ω in rad/s")
    grid[1, 0].set_ylabel("voltage $V_s$ in V")
    grid[2, 0].set_ylabel("d in µN m")
    grid[0, 0].set_title("whole test", loc="left")
    grid[0, 1].set_title(f"first {START_S:g} s; grey: voltage saturated", loc="left")
    grid[0, 0].legend(loc="lower right")
    grid[1, 0].set_ylim(-0.3, 1.12 * limit_v)
    grid[1, 0].text(0.99, 0.84, "$V_{s,max}$", transform=grid[1, 0].transAxes, ha="right", va="top")
    return figure


_TIMES = {
    "to_63_percent_s": "63 %",
    "to_90_percent_s": "90 %",
    "to_98_percent_s": "98 %",
    "within_2_percent_s": "within ±2 %",
}
EARLY_S = 0.05
FASTER = 0.9  # of the other loop's time, to be called faster
# A tenth of a second holds many turns: the ripple averages out.
_AVERAGED = 100


def caption(
    responses: dict[str, Response], motor: Mapping[str, float] = TABLE_II._asdict()
) -> Caption:
    """Response times, speeds before and under the disturbance, and saturation; see `draw`."""
    limit_v = motor.get("V_s_max", TABLE_II.V_s_max)
    numbers: dict[str, Any] = {"motor": dict(motor)}
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
    saturated_s = closed.time_s[np.abs(closed.voltage) >= limit_v].max(initial=0.0)
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
            f"{_comparison(numbers)} {_gains(motor)}".strip(),
            f"Speed after {1e3 * EARLY_S:g} ms: open loop {numbers['open_loop_early_rad_s']:.0f} "
            f"rad/s, closed loop {numbers['closed_loop_early_rad_s']:.0f} rad/s.",
            f"The closed loop's voltage is at its limit of {limit_v:g} V until "
            f"{saturated_s:.3f} s.",
            *([f"Parameters other than Table II's: {others(motor)}."] if others(motor) else []),
        ),
        numbers,
        FIGURES["fig07"],
        (_claim(numbers),),
    )


def _claim(numbers: Mapping[str, Any]) -> Claim:
    ours, holds = [], {}
    for name in ("to_90_percent_s", "to_98_percent_s"):
        opened, closed = (_seconds(numbers[f"{loop}_{name}"]) for loop in LOOPS)
        ours.append(f"to {_TIMES[name]}: {closed} instead of {opened}")
        holds[f"to {_TIMES[name]}"] = _faster(numbers, name)
    return Claim(
        "Fig. 7: with the PI loop “response time is significantly reduced”",
        "; ".join(ours),
        verdicts(holds),
    )


def _seconds(time_s: float | None) -> str:
    return "never" if time_s is None else f"{time_s:.3f} s"


def _faster(numbers: Mapping[str, Any], name: str) -> bool | None:
    """Return whether the closed loop is faster in a time; None if no loop gets there."""
    opened, closed = (numbers[f"{loop}_{name}"] for loop in LOOPS)
    if opened is None and closed is None:
        return None
    return closed is not None and closed < (math.inf if opened is None else FASTER * opened)


def _comparison(numbers: Mapping[str, Any]) -> str:
    """Return the times to which the closed loop is the faster one, as a sentence."""
    faster: dict[bool, list[str]] = {True: [], False: []}
    for name, text in _TIMES.items():
        if (than := _faster(numbers, name)) is not None:
            faster[than].append(text)
    said = {True: f"at least {1.0 - FASTER:.0%} faster to", False: "not so to"}
    parts = [f"{said[which]}: {', '.join(texts)}" for which, texts in faster.items() if texts]
    return f"The closed loop is {'; '.join(parts)}." if parts else "No loop reaches the set point."


def _gains(motor: Mapping[str, float]) -> str:
    """Return what the ratio of the gains leaves, as a sentence; empty for unknown parameters."""
    if not {"K_T", "J", "R", "b", "K_p", "K_i"} <= motor.keys() or not motor["K_p"]:
        return ""
    ratio = motor["K_i"] / motor["K_p"]
    pole = 1.0 / motor_time_constant(TABLE_II._replace(**motor))
    slow = "leaves a slow pole" if ratio < 0.99 * pole else "leaves no slow pole"
    return f"K_i / K_p = {ratio:.2f} 1/s, with the motor's pole at −{pole:.2f} 1/s, {slow}."


def make(results: Path) -> Drawing:
    """Draw the figure of a results folder."""
    path = RESULTS["motor_test"].location(results)
    responses = read(path)
    facts = read_rrd(path).properties.get("motor_test", {})
    motor = json.loads(facts.get("parameters", "null")) or TABLE_II._asdict()
    return Drawing(draw(responses, motor), caption(responses, motor))
