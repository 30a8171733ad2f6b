"""Success with its 95 % Wilson interval, a panel for every axis and a colour for every series.

A series with a name that ends in ", shield" has the colour of the one without, and open squares.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.base.plotting import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, styled

_COLUMNS = 3
_GROUP = 0.7  # of points side by side, the share of the distance between values
_SHIELD = ", shield"
_COLOURS = (BLUE, GREEN, PURPLE, VERMILION, ORANGE, SKY, BLACK)


@styled
def draw_success(
    panels: Mapping[str, Sequence[Any]],
    value: Callable[[Any], str],
    series: Callable[[Any], str],
    title: str = "",
    columns: int = _COLUMNS,
) -> Figure:
    """Draw the success of rows; those without episodes are left out.

    Args:
        panels: rows of each panel, by its title.
        value: of a row, the text below its place on the panel's axis.
        series: of a row, the name of what has a colour of its own.
        title: of the figure.
        columns: most panels in a row.
    """
    known = {name: [r for r in rows if r.success is not None] for name, rows in panels.items()}
    known = {name: rows for name, rows in known.items() if rows}
    columns = min(columns, max(1, len(known)))
    lines = max(1, -(-len(known) // columns))
    size = (max(2.8 * columns, 5.0), 2.1 * lines + 0.6 * (lines == 1))
    figure = Figure(figsize=size, layout="constrained")
    names = list(dict.fromkeys(series(row) for rows in known.values() for row in rows))
    for number, (name, rows) in enumerate(known.items()):
        panel = figure.add_subplot(lines, columns, number + 1)
        _draw_panel(panel, rows, value, series, names)
        panel.set_title(name, loc="left")
        panel.set(ylim=(-4.0, 104.0), ylabel="success in %")
        if number == 0:  # below, where it covers nothing
            legend = panel.get_legend_handles_labels()
            figure.legend(*legend, loc="outside lower center", ncols=4, fontsize=7)
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
    of_colours = list(dict.fromkeys(name.removesuffix(_SHIELD) for name in names))
    for k, name in enumerate(names):
        own = [row for row in rows if series(row) == name]
        shift = _GROUP * ((k + 0.5) / len(names) - 0.5)
        colour = _COLOURS[of_colours.index(name.removesuffix(_SHIELD)) % len(_COLOURS)]
        marker, fill = ("s", "white") if name.endswith(_SHIELD) else ("o", colour)
        shares = np.array([(r.success, r.success_low, r.success_high) for r in own]).reshape(-1, 3)
        rate, low, high = 100.0 * shares.T
        panel.errorbar(
            [values.index(value(row)) + shift for row in own],
            rate,
            np.maximum([rate - low, high - rate], 0.0),
            fmt=marker,
            mfc=fill,
            markersize=4,
            color=colour,
            label=name,
        )
    panel.set_xticks(range(len(values)), values, fontsize=7)
