"""Measures of rows: over one axis, a panel each and a colour for every series, or a map over two.

A series with a name that ends in ", shield" has the colour of the one without, and open squares.
"""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from agent.evaluation.rows import Row
from cosim.base.colours import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from cosim.base.plotting import styled
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
Panels = Mapping[str, Sequence[Row]]  # rows of each panel, by its title
_COLUMNS = 3
_GROUP = 0.7  # of points side by side, the share of the distance between values
_ASIDE = 0.25  # of points on an axis of numbers, the share of the least distance between values
_SHIELD = ", shield"
_COLOURS = (BLUE, GREEN, PURPLE, VERMILION, ORANGE, SKY, BLACK)
_LETTERS = 90  # of the values of an axis that stand beside each other
_LEGEND = 7  # size of its font in points; a letter is about half as wide
_LETTER_IN, _HANDLE_IN, _LINE_IN = 0.55 * _LEGEND / 72, 0.55, 1.6 * _LEGEND / 72


def _measured(rows: Sequence[Row], quantity: str) -> np.ndarray:
    """Return a quantity of n rows and the ends of its interval, (3, n); NaN where there is none."""
    names = (quantity, f"{quantity}_low", f"{quantity}_high")
    values = [[getattr(row, name, None) for name in names] for row in rows]
    return QUANTITIES[quantity][1] * np.array(values, dtype=float).reshape(-1, 3).T


def _are_numbers(values: Sequence[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


@styled
def draw_measure(
    panels: Panels,
    value: Callable[[Row], Any],
    series: Callable[[Row], str],
    *,
    quantity: str = "success",
    axis: str = "",
    title: str = "",
    columns: int = _COLUMNS,
) -> Figure:
    """Draw a quantity of rows over an axis; rows without it are left out.

    Args:
        value: of a row: numbers are places on the axis; other values get a place each, in which
            series are next to each other.
        series: of a row, the name of what has a colour of its own.
        columns: most panels in a row.
    """
    known = {n: [r for r in rows if getattr(r, quantity) is not None] for n, rows in panels.items()}
    known = {name: rows for name, rows in known.items() if rows}
    columns = min(columns, max(1, len(known)))
    lines = max(1, -(-len(known) // columns))
    width = max(2.8 * columns, 5.0)
    letters = int((width - _HANDLE_IN) / _LETTER_IN)
    names = dict.fromkeys(series(row) for rows in known.values() for row in rows)
    labels = {name: textwrap.fill(name, letters) for name in names}
    longest = max((len(line) for text in labels.values() for line in text.split("\n")), default=1)
    fit = max(1, min(4, int(width / (_HANDLE_IN + _LETTER_IN * longest))))
    below = _LINE_IN * sum(text.count("\n") + 1 for text in labels.values()) / fit
    high = 2.3 + max((_turned_in(list(map(value, rows))) for rows in known.values()), default=0.0)
    figure = Figure(figsize=(width, high * lines + 0.4 + below), layout="constrained")
    for number, (name, rows) in enumerate(known.items(), 1):
        panel = figure.add_subplot(lines, columns, number)
        _draw_panel(panel, rows, value, series, labels, quantity)
        panel.set_title(name, loc="left")
        panel.set(ylabel=QUANTITIES[quantity][0], xlabel=axis)
        if quantity in ENDS:
            panel.set_ylim(-4.0, 104.0)
        if number == 1:  # below, where it covers nothing
            legend = panel.get_legend_handles_labels()
            figure.legend(*legend, loc="outside lower center", ncols=fit, fontsize=_LEGEND)
    figure.suptitle(title)
    return _plain(figure)


def _turned_in(values: Sequence[Any]) -> float:
    """Return how high the values of an axis stand when turned, in inches; 0 if they lie."""
    texts = [] if _are_numbers(values) else list(map(str, dict.fromkeys(values)))
    turned = sum(map(len, texts)) > _LETTERS
    return turned * _LETTER_IN * max(map(len, texts), default=0)


def _plain(figure: Figure) -> Figure:
    """Have names of policies stand in a figure as they are: `$` begins no formula."""
    for text in figure.findobj(Text):
        text.set_parse_math(False)
    return figure


def _draw_panel(
    panel: Axes,
    rows: Sequence[Row],
    value: Callable[[Row], Any],
    series: Callable[[Row], str],
    labels: Mapping[str, str],
    quantity: str,
) -> None:
    values = list(dict.fromkeys(map(value, rows)))
    numbers = _are_numbers(values)
    width = _GROUP
    if numbers:  # on an axis of numbers points stand close to theirs
        gaps = np.diff(sorted(values))
        width = _ASIDE * float(gaps.min()) if len(gaps) else 0.0
    of_colours = list(dict.fromkeys(name.removesuffix(_SHIELD) for name in labels))
    for k, (name, label) in enumerate(labels.items()):
        own = [row for row in rows if series(row) == name]
        shift = width * ((k + 0.5) / len(labels) - 0.5)
        places = [(value(row) if numbers else values.index(value(row))) + shift for row in own]
        colour = _COLOURS[of_colours.index(name.removesuffix(_SHIELD)) % len(_COLOURS)]
        marker, fill = ("s", "white") if name.endswith(_SHIELD) else ("o", colour)
        middle, low, high = _measured(own, quantity)
        bars = np.nan_to_num(np.maximum([middle - low, high - middle], 0.0))
        panel.errorbar(
            places, middle, bars, fmt=marker, mfc=fill, markersize=4, color=colour, label=label,
            linestyle="-" if numbers else "",
        )  # fmt: skip
    if not numbers:
        turned = 90 if _turned_in(values) else 0
        panel.set_xticks(range(len(values)), list(map(str, values)), fontsize=7, rotation=turned)


@styled
def draw_map(
    panels: Panels, axes: Sequence[str], *, quantity: str = "success", title: str = ""
) -> Figure:
    """Draw a quantity of rows over two axes as colours, with its value in each cell.

    Args:
        axes: names, among the labels of rows, of the one to the right and of the one upwards.
    """
    rows = [row for each in panels.values() for row in each]
    places = [list(dict.fromkeys(row.labels()[axis] for row in rows)) for axis in axes]
    across, up = (sorted(v) if _are_numbers(v) else v for v in places)
    measured = _measured(rows, quantity)[0]
    known = measured[np.isfinite(measured)]
    whole = quantity in ENDS or not len(known)
    limits = (0.0, 100.0) if whole else (known.min(), known.max())
    columns = min(_COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    size = (1.0 + columns * max(2.8, 0.5 * len(across)), 0.6 + lines * (1.0 + 0.4 * len(up)))
    figure = Figure(figsize=size, layout="constrained")
    for number, (name, own) in enumerate(panels.items(), 1):
        panel = figure.add_subplot(lines, columns, number)
        grid = np.full((len(up), len(across)), np.nan)
        for row, value in zip(own, _measured(own, quantity)[0], strict=True):
            line, column = up.index(row.labels()[axes[1]]), across.index(row.labels()[axes[0]])
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
    return _plain(figure)
