"""The plot of docs/robustness.md: success with its interval, a panel for every axis."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.robustness.table import RobustnessReport, RobustnessRow

PLOT_FILE = "robustness.png"
_COLUMNS = 4
# Colours told apart in any kind of colour vision (Okabe and Ito).
_COLOURS = {"moves": "#0072b2", "robust": "#d55e00", "paper": "#009e73", "slip": "#cc79a7"}


def draw(report: RobustnessReport) -> Figure:
    """Success of every method without the shield, in worlds by what is not ideal."""
    rows = [row for row in report.rows if not row.shield and row.success is not None]
    axes = list(dict.fromkeys(row.axis for row in rows))
    lines = max(1, -(-len(axes) // _COLUMNS))
    figure = Figure(figsize=(3.0 * _COLUMNS, 2.6 * lines), layout="constrained")
    for number, axis in enumerate(axes):
        panel = figure.add_subplot(lines, _COLUMNS, number + 1)
        _draw_axis(panel, [row for row in rows if row.axis == axis])
        panel.set(title=axis, ylim=(-4.0, 104.0), ylabel="success, %")
        if number == 0:
            panel.legend(fontsize=7)
    figure.suptitle(f"scenario {report.scenario}, without the shield; bars: 95 %, Wilson")
    return figure


def _draw_axis(panel: Axes, rows: list[RobustnessRow]) -> None:
    values = list(dict.fromkeys(row.value for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    for k, method in enumerate(methods):
        own = [row for row in rows if row.method == method]
        places = [values.index(row.value) + 0.15 * (k - (len(methods) - 1) / 2) for row in own]
        shares = np.array([(r.success, r.success_low, r.success_high) for r in own], dtype=float)
        rate, low, high = 100.0 * shares.T
        panel.errorbar(
            places,
            rate,
            [rate - low, high - rate],
            fmt="o",
            markersize=4,
            color=_COLOURS[method],
            label=method,
        )
    panel.set_xticks(range(len(values)), values, fontsize=7)
