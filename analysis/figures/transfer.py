"""Success in the full co-simulation by training method, from the table of `minirobots transfer`.

The paper has no such figure: it says of no number whether it was reached on the grid or with the
dynamics.
"""

from pathlib import Path

from matplotlib.figure import Figure

from agent.study.plot import draw_measure
from agent.study.transfer import TransferReport, TransferRow
from analysis.figures.style import Caption, Drawing
from analysis.reading.results import FIGURES, read_result
from cosim.base.errors import UserError


def series_of(row: TransferRow) -> str:
    """Name of what a row belongs to in the legend: training method, and whether with the shield."""
    return f"{row.method}, shield" if row.shield else row.method


def draw(rows: list[TransferRow]) -> Figure:
    """A panel per friction coefficient: success with 95 % intervals, by scenario and method."""
    coefficients = sorted({row.mu for row in rows})
    panels = {f"µ = {mu:g}": [row for row in rows if row.mu == mu] for mu in coefficients}
    figure = draw_measure(panels, lambda row: row.scenario, series_of, columns=1)
    lowest = 100.0 * min(row.success_low or 0.0 for row in rows)
    for axes in figure.axes:
        axes.set_ylim(lowest - 3.0, 103.0)
        axes.axhline(99.0, color="black", linestyle=":", linewidth=0.8)
    figure.axes[-1].set_xlabel("scenario; dotted: 99 %")
    return figure


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
        UserError: there is no such result, or it is damaged.
        UserError: it has no row with episodes.
    """
    report: TransferReport = read_result("transfer", results, TransferReport)
    rows = [row for row in report.rows if row.success is not None]
    if not rows:
        raise UserError("the table of `minirobots transfer` has no rows with episodes")
    return Drawing(draw(rows), caption(rows))
