"""Measures of rows: over one axis, a panel each and a colour for every series, or a map over two.

A series with a name that ends in ", shield" has the colour of the one without, and open squares.
"""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.base.plotting import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, styled
from cosim.model.outcome import ENDS

# Quantities of a row that can be drawn: label of the axis, and factor.
QUANTITIES: dict[str, tuple[str, float]] = {
    **{str(outcome): (f"{str(outcome).replace('_', ' ')} in %", 100.0) for outcome in ENDS},
    "path_length_cm": ("path length in cm", 1.0),
    "rotation_deg": ("rotation in degrees", 1.0),
    "path_ratio_to_grid": ("path over that on the grid", 1.0),
    "min_distance_cm": ("least distance of centres in cm", 1.0),
    "sim_time_s": ("simulated time in s", 1.0),
    "energy_j": ("energy in J", 1.0),
}
_COLUMNS = 3
_GROUP = 0.7  # of points side by side, the share of the distance between values
_SHIELD = ", shield"
_COLOURS = (BLUE, GREEN, PURPLE, VERMILION, ORANGE, SKY, BLACK)
_LEGEND = 7  # size of its font in points; a letter is about half as wide
_LETTER_IN, _HANDLE_IN, _LINE_IN = 0.55 * _LEGEND / 72, 0.55, 1.6 * _LEGEND / 72


def _measures(rows: Sequence[Any], quantity: str) -> np.ndarray:
    """Return a quantity of n rows and the ends of its interval, (3, n); NaN where there is none."""
    names = (quantity, f"{quantity}_low", f"{quantity}_high")
    values = [[getattr(row, name, None) for name in names] for row in rows]
    return QUANTITIES[quantity][1] * np.array(values, dtype=float).reshape(-1, 3).T


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


@styled
def draw_measure(
    panels: Mapping[str, Sequence[Any]],
    value: Callable[[Any], Any],
    series: Callable[[Any], str],
    *,
    quantity: str = "success",
    axis: str = "",
    title: str = "",
    columns: int = _COLUMNS,
) -> Figure:
    """Draw a quantity of rows over an axis; rows without it are left out.

    Args:
        panels: rows of each panel, by its title.
        value: of a row: numbers are places on the axis; other values get a place each, in which
            series stand side by side.
        series: of a row, the name of what has a colour of its own.
        quantity: one of QUANTITIES.
        axis: name of the axis.
        title: of the figure.
        columns: most panels in a row.
    """
    known = {n: [r for r in rows if getattr(r, quantity) is not None] for n, rows in panels.items()}
    known = {name: rows for name, rows in known.items() if rows}
    columns = min(columns, max(1, len(known)))
    lines = max(1, -(-len(known) // columns))
    width = max(2.8 * columns, 5.0)
    names = list(dict.fromkeys(series(row) for rows in known.values() for row in rows))
    letters = int((width - _HANDLE_IN) / _LETTER_IN)
    shown = {name: textwrap.fill(name, letters) for name in names}
    longest = max((len(line) for text in shown.values() for line in text.split("\n")), default=1)
    fit = max(1, min(4, int(width / (_HANDLE_IN + _LETTER_IN * longest))))
    below = _LINE_IN * sum(text.count("\n") + 1 for text in shown.values()) / fit
    figure = Figure(figsize=(width, 2.3 * lines + 0.4 + below), layout="constrained")
    for number, (name, rows) in enumerate(known.items()):
        panel = figure.add_subplot(lines, columns, number + 1)
        _draw_panel(panel, rows, value, series, shown, quantity)
        panel.set_title(name, loc="left")
        panel.set(ylabel=QUANTITIES[quantity][0], xlabel=axis)
        if quantity in ENDS:
            panel.set_ylim(-4.0, 104.0)
        if number == 0:  # below, where it covers nothing
            legend = panel.get_legend_handles_labels()
            figure.legend(*legend, loc="outside lower center", ncols=fit, fontsize=_LEGEND)
    figure.suptitle(title)
    return figure


def _draw_panel(
    panel: Axes,
    rows: Sequence[Any],
    value: Callable[[Any], Any],
    series: Callable[[Any], str],
    shown: Mapping[str, str],
    quantity: str,
) -> None:
    values = list(dict.fromkeys(map(value, rows)))
    numbers = all(map(_is_number, values))
    of_colours = list(dict.fromkeys(name.removesuffix(_SHIELD) for name in shown))
    for k, (name, label) in enumerate(shown.items()):
        own = [row for row in rows if series(row) == name]
        shift = _GROUP * ((k + 0.5) / len(shown) - 0.5)
        places = [value(row) if numbers else values.index(value(row)) + shift for row in own]
        colour = _COLOURS[of_colours.index(name.removesuffix(_SHIELD)) % len(_COLOURS)]
        marker, fill = ("s", "white") if name.endswith(_SHIELD) else ("o", colour)
        middle, low, high = _measures(own, quantity)
        bars = np.nan_to_num(np.maximum([middle - low, high - middle], 0.0))
        panel.errorbar(
            places, middle, bars, fmt=marker, mfc=fill, markersize=4, color=colour, label=label,
            linestyle="-" if numbers else "",
        )  # fmt: skip
    if not numbers:
        panel.set_xticks(range(len(values)), list(map(str, values)), fontsize=7)


@styled
def draw_map(
    panels: Mapping[str, Sequence[Any]],
    labels: Callable[[Any], Mapping[str, Any]],
    axes: tuple[str, str],
    *,
    quantity: str = "success",
    title: str = "",
) -> Figure:
    """Draw a quantity of rows over two axes as colours, with its value in each cell.

    Args:
        panels: rows of each panel, by its title.
        labels: of a row, its values by the names of the axes.
        axes: names of the one to the right and of the one upwards.
        quantity: one of QUANTITIES.
        title: of the figure.
    """
    rows = [row for each in panels.values() for row in each]
    places = [list(dict.fromkeys(labels(row)[axis] for row in rows)) for axis in axes]
    across, up = (sorted(v) if all(map(_is_number, v)) else v for v in places)
    measured = _measures(rows, quantity)[0]
    limits = (0.0, 100.0) if quantity in ENDS else (np.nanmin(measured), np.nanmax(measured))
    columns = min(_COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    size = (1.0 + columns * max(2.8, 0.5 * len(across)), 0.6 + lines * (1.0 + 0.4 * len(up)))
    figure = Figure(figsize=size, layout="constrained")
    for number, (name, own) in enumerate(panels.items()):
        panel = figure.add_subplot(lines, columns, number + 1)
        grid = np.full((len(up), len(across)), np.nan)
        for row, value in zip(own, _measures(own, quantity)[0], strict=True):
            column, line = (
                v.index(labels(row)[n]) for v, n in zip((across, up), axes, strict=True)
            )
            grid[line, column] = value
            if np.isfinite(value):
                colour = "white" if value > np.mean(limits) else BLACK
                middle = {"ha": "center", "va": "center", "fontsize": 7}
                panel.text(column, line, f"{value:.3g}", color=colour, **middle)
        image = panel.imshow(
            grid, origin="lower", aspect="auto", cmap="Blues", vmin=limits[0], vmax=limits[1]
        )
        panel.grid(visible=False)
        panel.set_xticks(range(len(across)), list(map(str, across)), fontsize=7)
        panel.set_yticks(range(len(up)), list(map(str, up)), fontsize=7)
        panel.set_title(name, loc="left")
        panel.set(xlabel=axes[0], ylabel=axes[1])
        figure.colorbar(image, ax=panel, label=QUANTITIES[quantity][0])
    figure.suptitle(title)
    return figure
