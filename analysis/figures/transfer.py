"""Success in the full co-simulation by training method, from the table of `cosim.transfer`.

The paper has no such figure: it says of no number whether it was reached on the grid or with the
dynamics.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.study.transfer import TransferRow
from analysis.figures.style import WIDTH_IN, Caption, Drawing, FigureError
from analysis.reading.results import FIGURES
from analysis.reading.written import read_transfer
from cosim.base.plotting import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

_COLOURS = (VERMILION, BLUE, GREEN, ORANGE, PURPLE, SKY)
# Of a group of bars side by side, the share of the distance between scenarios.
_GROUP = 0.7


def series_of(row: TransferRow) -> str:
    """Name of what a row belongs to in the legend: training method, and whether with the shield."""
    return f"{row.method}, shield" if row.shield else row.method


def draw(rows: list[TransferRow]) -> Figure:
    """A panel per friction coefficient: success with 95 % intervals, by scenario and method."""
    coefficients = sorted({row.mu for row in rows})
    names = list(dict.fromkeys(series_of(row) for row in rows))
    size = (WIDTH_IN, 0.9 + 2.0 * len(coefficients))
    figure, grid = plt.subplots(len(coefficients), 1, figsize=size, squeeze=False, sharex=True)
    scenarios = sorted({row.scenario for row in rows})
    methods = list(dict.fromkeys(row.method for row in rows))
    lowest = 100.0 * min(row.success_low or 0.0 for row in rows)
    for axes, mu in zip(grid[:, 0], coefficients, strict=True):
        for place, name in enumerate(names):
            chosen = [r for r in rows if r.mu == mu and series_of(r) == name]
            shift = _GROUP * ((place + 0.5) / len(names) - 0.5)
            # A method has one colour; with the shield its markers are open squares.
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
    rows: list[TransferRow],
    scenarios: list[str],
    shift: float,
    name: str,
    colour: str,
) -> None:
    places = [scenarios.index(row.scenario) + shift for row in rows]
    success, low, high = (
        100.0 * np.array([getattr(row, key) for row in rows])
        for key in ("success", "success_low", "success_high")
    )
    bars = np.maximum([success - low, high - success], 0.0)
    marker, fill = ("s", "white") if "shield" in name else ("o", colour)
    axes.errorbar(
        places, success, bars, fmt=marker, mfc=fill, color=colour, ms=4, capsize=3, label=name
    )


def caption(rows: list[TransferRow]) -> Caption:
    """The caption of the table's rows: over all scenarios, by method, shield and friction."""
    numbers, ours = [], []
    for mu in sorted({row.mu for row in rows}):
        parts = []
        for name in dict.fromkeys(series_of(row) for row in rows):
            chosen = [r for r in rows if r.mu == mu and series_of(r) == name]
            if not chosen:
                continue
            worst = min(chosen, key=lambda row: row.success or 0.0)
            episodes = sum(row.episodes for row in chosen)
            numbers.append(
                {
                    "mu": mu,
                    "series": name,
                    "episodes": episodes,
                    "worst_scenario": worst.scenario,
                    "worst_success": worst.success,
                    "worst_success_low": worst.success_low,
                    "worst_success_high": worst.success_high,
                }
            )
            parts.append(
                f"{name} at least {worst.success:.1%} [{100 * (worst.success_low or 0.0):.1f}, "
                f"{100 * (worst.success_high or 0.0):.1f}] (scenario {worst.scenario}, "
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
        ResultError: there is no such result, or it is damaged.
        FigureError: it has no row with episodes.
    """
    rows = [row for row in read_transfer(results).rows if row.success is not None]
    if not rows:
        raise FigureError("the table of `python -m cosim.transfer` has no rows with episodes")
    return Drawing(draw(rows), caption(rows))
