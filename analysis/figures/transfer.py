"""Success in the full co-simulation by training method, from the table of `cosim.transfer`.

The paper has no such figure: it says of no number whether it was reached on the grid or with the
dynamics.
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.style import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    WIDTH_IN,
    Caption,
    Drawing,
    FigureError,
)
from analysis.reading.results import FIGURES, RESULTS
from cosim.base.reading import Kind, parsing, read_json

# What a row of the table must hold; shares come with the ends of their 95 % intervals.
_NEEDED = ("scenario", "method", "mu", "episodes", "success", "success_low", "success_high")
_COLOURS = (VERMILION, BLUE, GREEN, ORANGE, PURPLE, SKY)
# Of a group of bars side by side, the share of the distance between scenarios.
_GROUP = 0.7


def load(path: Path) -> list[dict[str, Any]]:
    """Rows of the table that have episodes.

    Raises:
        FigureError: there is no such file, or it is none of `cosim.transfer`.
    """
    kind = Kind(
        f"result of `python -m {RESULTS['transfer'].module}`", "write one with --out", FigureError
    )
    content = read_json(path, kind)
    with parsing(path, kind):
        rows = [row for row in content["rows"] if row["success"] is not None]
        if not rows or not all(name in row for row in rows for name in _NEEDED):
            raise ValueError("no rows with episodes")
    return rows


def series_of(row: dict[str, Any]) -> str:
    """Name of what a row belongs to in the legend: training method, and safety layer if on."""
    margin_mm = 1e3 * float(row.get("safety_margin_m") or 0.0)
    return f"{row['method']}, safety layer {margin_mm:g} mm" if margin_mm else str(row["method"])


def draw(rows: list[dict[str, Any]]) -> Figure:
    """A panel per friction coefficient: success with 95 % intervals, by scenario and method."""
    coefficients = sorted({float(row["mu"]) for row in rows})
    names = list(dict.fromkeys(series_of(row) for row in rows))
    size = (WIDTH_IN, 0.9 + 2.0 * len(coefficients))
    figure, grid = plt.subplots(len(coefficients), 1, figsize=size, squeeze=False, sharex=True)
    scenarios = sorted({str(row["scenario"]) for row in rows})
    methods = list(dict.fromkeys(str(row["method"]) for row in rows))
    lowest = 100.0 * min(float(row["success_low"]) for row in rows)
    for axes, mu in zip(grid[:, 0], coefficients, strict=True):
        for place, name in enumerate(names):
            chosen = [r for r in rows if float(r["mu"]) == mu and series_of(r) == name]
            shift = _GROUP * ((place + 0.5) / len(names) - 0.5)
            # A method has one colour; with the safety layer its markers are open squares.
            colour = _COLOURS[methods.index(name.split(",")[0]) % len(_COLOURS)]
            _draw_series(axes, chosen, scenarios, shift, name, colour)
        axes.axhline(99.0, color="black", linestyle=":", linewidth=0.8)
        axes.set_title(f"µ = {mu:g}", loc="left")
        axes.set(ylabel="success in %", ylim=(lowest - 3.0, 103.0))
        axes.set_xticks(range(len(scenarios)), scenarios)
        axes.set_xlim(-0.5, len(scenarios) - 0.5)
    grid[-1, 0].set_xlabel("scenario; dotted: 99 %")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=min(len(labels), 3))
    return figure


def _draw_series(
    axes: Axes,
    rows: list[dict[str, Any]],
    scenarios: list[str],
    shift: float,
    name: str,
    colour: str,
) -> None:
    places = [scenarios.index(str(row["scenario"])) + shift for row in rows]
    success, low, high = (
        100.0 * np.array([float(row[key]) for row in rows])
        for key in ("success", "success_low", "success_high")
    )
    bars = np.maximum([success - low, high - success], 0.0)
    marker, fill = ("s", "white") if "safety" in name else ("o", colour)
    axes.errorbar(
        places, success, bars, fmt=marker, mfc=fill, color=colour, ms=4, capsize=3, label=name
    )


def caption(rows: list[dict[str, Any]]) -> Caption:
    """The caption of the table's rows: over all scenarios, by method, safety layer and friction."""
    numbers, ours = [], []
    for mu in sorted({float(row["mu"]) for row in rows}):
        parts = []
        for name in dict.fromkeys(series_of(row) for row in rows):
            chosen = [r for r in rows if float(r["mu"]) == mu and series_of(r) == name]
            if not chosen:
                continue
            worst = min(chosen, key=lambda row: row["success"])
            episodes = sum(int(row["episodes"]) for row in chosen)
            numbers.append(
                {
                    "mu": mu,
                    "series": name,
                    "episodes": episodes,
                    "worst_scenario": worst["scenario"],
                    "worst_success": worst["success"],
                    "worst_success_low": worst["success_low"],
                    "worst_success_high": worst["success_high"],
                }
            )
            parts.append(
                f"{name} at least {worst['success']:.1%} [{100 * worst['success_low']:.1f}, "
                f"{100 * worst['success_high']:.1f}] (scenario {worst['scenario']}, "
                f"{episodes} episodes in all)"
            )
        ours.append(f"µ = {mu:g}: {'; '.join(parts)}.")
    return Caption(
        "transfer",
        "Success of trained policies in the full co-simulation by training method and scenario; "
        "bars: 95 % intervals over episodes",
        "all targets are reached without collisions (it does not say whether with the dynamics).",
        tuple(ours),
        {"series": numbers},
        FIGURES["transfer"],
    )


def make(results: Path) -> Drawing:
    """Draw the figure of a results folder.

    Raises:
        FigureError: there is no such result.
    """
    rows = load(RESULTS["transfer"].proof_in(results))
    return Drawing(draw(rows), caption(rows))
