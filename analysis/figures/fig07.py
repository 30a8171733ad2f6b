"""Fig. 7: the motor in open and closed loop, from a recording of `minirobots motor-test`."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from analysis.figures.style import WIDTH_IN, Drawing, figure, verdicts
from analysis.reading.findings import intervals
from analysis.reading.motor_test import LOOPS, Response, read, rise
from analysis.reading.results import RESULTS
from cosim.base.colours import BLACK, BLUE, GREY, VERMILION
from cosim.base.errors import UserError
from cosim.model.params import TABLE_II, describe, motor_time_constant

COLOURS = {"open_loop": VERMILION, "closed_loop": BLUE}
# What the right column shows larger: the start, in which the closed loop is at its limit.
START_S = 0.12


def _draw(axes: np.ndarray, responses: dict[str, Response], until_s: float, limit_v: float) -> None:
    speed, voltage, torque = axes
    for loop, response in responses.items():
        early = response.time_s <= until_s
        time_s, style = response.time_s[early], {"color": COLOURS[loop]}
        speed.plot(time_s, response.omega[early], label=loop.replace("_", " "), **style)
        voltage.plot(time_s, response.voltage[early], **style)
    closed = responses["closed_loop"]
    early = closed.time_s <= until_s
    time_s, set_point = closed.time_s[early], closed.omega_des[early]
    speed.plot(time_s, set_point, color=BLACK, linestyle="--", linewidth=0.8, label="set point")
    for first, last in intervals(np.abs(closed.voltage[early]) >= limit_v):
        span = time_s[first], time_s[min(last + 1, len(time_s) - 1)]
        for each in (speed, voltage):
            each.axvspan(*span, color=GREY, alpha=0.25, linewidth=0)
    for sign in (1, -1):
        voltage.axhline(sign * limit_v, color=BLACK, linestyle=":", linewidth=0.8)
    torque.step(time_s, 1e6 * closed.disturbance[early], color=BLACK, where="post")
    torque.set_xlabel("time in s")


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
_CLAIMED = ("90 %", "98 %")
EARLY_S = 0.05
FASTER = 0.9  # of the other loop's time, to be called faster
# A tenth of a second holds many turns: the ripple averages out.
_AVERAGED = 100


def drawing_of(
    responses: dict[str, Response], motor: Mapping[str, float] = TABLE_II._asdict()
) -> Drawing:
    """Return the figure of a motor test with response times, speeds and saturation; see `draw`."""
    if (lasts_s := responses["closed_loop"].time_s[-1]) < EARLY_S:
        raise UserError(f"the motor test lasts {lasts_s:g} s; record one of {EARLY_S:g} s or more")
    limit_v = motor.get("V_s_max", TABLE_II.V_s_max)
    numbers: dict[str, Any] = {"motor": dict(motor)}
    times_s: dict[str, list[float | None]] = {text: [] for text in _TIMES.values()}
    speeds, early = [], []
    for loop, response in responses.items():
        free, words = response.disturbance == 0.0, loop.replace("_", " ")
        risen = rise(response.time_s[free], response.omega[free], response.omega_des[0])
        thirds = [float(t[-_AVERAGED:].mean()) for t in np.array_split(response.omega, 3)]
        at_early = float(response.omega[np.searchsorted(response.time_s, EARLY_S)])
        numbers |= {f"{loop}_{name}": value for name, value in risen._asdict().items()}
        numbers |= {f"{loop}_early_rad_s": at_early, f"{loop}_speeds_rad_s": thirds}
        speeds.append(f"{words} {', '.join(f'{value:.1f}' for value in thirds)} rad/s")
        early.append(f"{words} {at_early:.0f} rad/s")
        for name, text in _TIMES.items():
            times_s[text].append(getattr(risen, name))
    closed = responses["closed_loop"]
    saturated_s = closed.time_s[np.abs(closed.voltage) >= limit_v].max(initial=0.0)
    numbers["closed_loop_highest_v"] = float(np.abs(closed.voltage).max())
    numbers["closed_loop_saturated_until_s"] = float(saturated_s)
    rises = []
    for text, pair in times_s.items():
        reached = [(loop, at) for loop, at in zip(LOOPS, pair, strict=True) if at is not None]
        words = (f"{loop.replace('_', ' ')} {at:.3f} s" for loop, at in reached)
        rises.append(f"{text}: {', '.join(words)}")
    faster = {text: _faster(*pair) for text, pair in times_s.items()}
    claimed = [f"to {t}: {' instead of '.join(map(_seconds, times_s[t][::-1]))}" for t in _CLAIMED]
    return Drawing(
        draw(responses, motor),
        (
            f"Speeds without, with and against d: {', '.join(speeds)}, set point "
            f"{closed.omega_des[-1]:g} rad/s.",
            "Time until the speed reaches a share of the set point, or stays near it: "
            f"{'; '.join(rises)}.",
            f"{_comparison(faster)} {_gains(motor)}".strip(),
            f"Speed after {1e3 * EARLY_S:g} ms: {', '.join(early)}.",
            f"The closed loop's voltage is at its limit of {limit_v:g} V until "
            f"{saturated_s:.3f} s.",
            *([f"Parameters other than Table II's: {others(motor)}."] if others(motor) else []),
        ),
        numbers,
        (("; ".join(claimed), verdicts({f"to {text}": faster[text] for text in _CLAIMED})),),
    )


def _seconds(time_s: float | None) -> str:
    if time_s is None:
        return "never"
    return f"{1e3 * time_s:.0f} ms" if time_s < 0.5 else f"{time_s:.2f} s"


def _faster(opened: float | None, closed: float | None) -> bool | None:
    """Return whether the closed loop is faster; None if no loop gets there."""
    if opened is None and closed is None:
        return None
    return closed is not None and closed < (math.inf if opened is None else FASTER * opened)


def _comparison(faster: Mapping[str, bool | None]) -> str:
    """Return the times to which the closed loop is the faster one, as a sentence."""
    words = {True: f"at least {1.0 - FASTER:.0%} faster to", False: "not so to"}
    parts = [
        f"{words[which]}: {', '.join(texts)}"
        for which in words
        if (texts := [text for text, than in faster.items() if than is which])
    ]
    return f"The closed loop is {'; '.join(parts)}." if parts else "No loop reaches the set point."


def _gains(motor: Mapping[str, float]) -> str:
    """Return what the ratio of the gains leaves, as a sentence; empty for unknown parameters."""
    if not {"K_T", "J", "R", "b", "K_p", "K_i"} <= motor.keys() or not motor["K_p"]:
        return ""
    ratio = motor["K_i"] / motor["K_p"]
    pole = 1.0 / motor_time_constant(TABLE_II._replace(**motor))
    slow = "leaves a slow pole" if ratio < 0.99 * pole else "leaves no slow pole"
    return f"K_i / K_p = {ratio:.2f} 1/s, with the motor's pole at −{pole:.2f} 1/s, {slow}."


@figure(
    "fig07",
    "Speed, voltage and disturbance torque d of the motor in open and closed loop; grey: the "
    "closed loop asks for more than the motor may have",
    claim=(
        "in closed loop the desired speed is achieved despite the disturbance and the limited "
        "voltage, and the response is significantly faster than in open loop."
    ),
    claims=("Fig. 7: with the PI loop “response time is significantly reduced”",),
    inputs=("motor_test",),
)
def make(results: Path) -> Drawing:
    """Draw the figure of a results folder."""
    responses, motor = read(RESULTS["motor_test"].location(results))
    return drawing_of(responses, motor or TABLE_II._asdict())
