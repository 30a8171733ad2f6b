"""Success with its 95 % Wilson interval, a panel for every axis and a colour for every series."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.base.plotting import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, styled

_COLUMNS = 3
_COLOURS = (BLUE, GREEN, PURPLE, VERMILION, ORANGE, SKY, BLACK)


@styled
def draw_success(
    panels: Mapping[str, Sequence[Any]],
    value: Callable[[Any], str],
    series: Callable[[Any], str],
    title: str,
) -> Figure:
    """Draw the success of rows; those without episodes are left out.

    Args:
        panels: rows of each panel, by its title.
        value: of a row, the text below its place on the panel's axis.
        series: of a row, the name of what has a colour of its own.
        title: of the figure.
    """
    known = {name: [r for r in rows if r.success is not None] for name, rows in panels.items()}
    known = {name: rows for name, rows in known.items() if rows}
    columns = min(_COLUMNS, max(1, len(known)))
    lines = max(1, -(-len(known) // columns))
    size = (max(2.8 * columns, 5.0), 2.1 * lines + 0.6 * (lines == 1))
    figure = Figure(figsize=size, layout="constrained")
    names = list(dict.fromkeys(series(row) for rows in known.values() for row in rows))
    for number, (name, rows) in enumerate(known.items()):
        panel = figure.add_subplot(lines, columns, number + 1)
        _draw_panel(panel, rows, value, series, names)
        panel.set(title=name, ylim=(-4.0, 104.0), ylabel="success in %")
        if number == 0:
            panel.legend(fontsize=7)
    figure.suptitle(title)
    return figure


def _draw_panel(
    panel: Axes,
    rows: Sequence[Any],
    value: Callable[[Any], str],
    series: Callable[[Any], str],
    names: Sequence[str],
) -> None:
    values = list(dict.fromkeys(map(value, rows)))
    for k, name in enumerate(names):
        own = [row for row in rows if series(row) == name]
        shift = 0.15 * (k - (len(names) - 1) / 2)
        shares = np.array([(r.success, r.success_low, r.success_high) for r in own]).reshape(-1, 3)
        rate, low, high = 100.0 * shares.T
        panel.errorbar(
            [values.index(value(row)) + shift for row in own],
            rate,
            np.maximum([rate - low, high - rate], 0.0),
            fmt="o",
            markersize=4,
            color=_COLOURS[k % len(_COLOURS)],
            label=name,
        )
    panel.set_xticks(range(len(values)), values, fontsize=7)
