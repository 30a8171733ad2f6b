"""Success in the full co-simulation by training method, from the study docs/studies/methods.toml.

The paper has no such figure: it says of no number whether it was reached on the grid or with the
dynamics.
"""

from pathlib import Path

from matplotlib.figure import Figure

from agent.evaluation.rows import Row, rate_column
from agent.study.plot import draw_measure
from agent.study.report import Report
from analysis.figures.style import Drawing, figure
from analysis.reading.results import read_result
from cosim.base.errors import UserError


def series_of(row: Row) -> str:
    """Return what a row belongs to in the legend: its method, and whether with the shield."""
    return f"{row.policy}, shield" if row.shield else row.policy


def by_friction(rows: list[Row]) -> dict[float, list[Row]]:
    """Return rows by their friction coefficient, the least first."""
    return {mu: [r for r in rows if r.mu == mu] for mu in sorted({r.mu or 0.0 for r in rows})}


def draw(rows: list[Row]) -> Figure:
    """Draw success with 95 % intervals by scenario and method, a panel per friction coefficient."""
    panels = {f"µ = {mu:g}": some for mu, some in by_friction(rows).items()}
    figure = draw_measure(panels, lambda row: row.scenario, series_of, columns=1)
    lowest = 100.0 * min(row.success_low or 0.0 for row in rows)
    for axes in figure.axes:
        axes.set_ylim(lowest - 3.0, 103.0)
        axes.axhline(99.0, color="black", linestyle=":", linewidth=0.8)
    figure.axes[-1].set_xlabel("scenario; dotted: 99 %")
    return figure


def drawing_of(rows: list[Row]) -> Drawing:
    """Return the figure, with the worst over all scenarios by method, shield and friction."""
    numbers, ours = [], []
    for mu, some in by_friction(rows).items():
        parts = []
        for name in dict.fromkeys(map(series_of, some)):
            chosen = [row for row in some if series_of(row) == name]
            worst = min(chosen, key=lambda row: row.success or 0.0)
            number = {
                "mu": mu,
                "series": name,
                "episodes": sum(row.episodes for row in chosen),
                "worst_scenario": worst.scenario,
                "worst_success": worst.success,
                "worst_success_low": worst.success_low,
                "worst_success_high": worst.success_high,
            }
            numbers.append(number)
            parts.append(
                f"{name} at least {rate_column('success').text(worst)} (scenario {worst.scenario}, "
                f"{number['episodes']} episodes in all)"
            )
        ours.append(f"µ = {mu:g}: {'; '.join(parts)}.")
    return Drawing(draw(rows), tuple(ours), {"series": numbers})


@figure(
    "transfer",
    "Success of trained policies in the full co-simulation by training method and scenario; "
    "bars: 95 % intervals over trainings and starts",
    claim="all targets are reached without collisions (it does not say whether with the dynamics).",
    inputs=("transfer",),
)
def make(results: Path) -> Drawing:
    """Draw the figure of a results folder."""
    report: Report = read_result("transfer", results, Report)
    rows = [row for row in report.rows if row.success is not None]
    if not rows:
        raise UserError("the study of methods in the dynamics has no rows with episodes")
    return drawing_of(rows)
