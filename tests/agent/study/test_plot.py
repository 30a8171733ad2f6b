"""Plots of a study: every quantity at its values, legends that are whole, maps over two axes."""

from itertools import product
from typing import Any

import msgspec
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from agent.evaluation.rows import Row
from agent.study.plot import QUANTITIES
from agent.study.report import Report
from cosim.base.errors import UserError

LONG = "a policy with a name that is much longer than the others, and longer than a figure is wide"


def row(number: int, policy: str, **options) -> Row:
    """Return a row in which each measure has another value than all others."""
    fields = [f"{name}{end}" for name in QUANTITIES for end in ("", "_low", "_high")]
    values = {name: 0.001 * (1 + k + len(fields) * number) for k, name in enumerate(fields)}
    whole = {"episodes": 9, "planned": 9, "starts": 9, "failing_starts": 0}
    named = {"policy": policy, "scenario": "2", "options": options}
    return msgspec.convert(values | whole | named, Row)


def table_of(policies, **axes) -> Report:
    cases = enumerate(product(policies, *axes.values()))
    rows = [
        row(k, policy, **dict(zip(axes, values, strict=True))) for k, (policy, *values) in cases
    ]
    return Report(rows=tuple(rows), axes=tuple(axes))


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_points_and_bars_are_the_quantity_at_the_value_of_the_axis(quantity):
    table = table_of(["near", "far"], mu=[0.3, 0.1, 0.2])
    figure: Any = table.plot(quantity=quantity)
    (panel,) = figure.axes
    assert panel.get_xlabel() == "mu"
    assert panel.get_ylabel() == QUANTITIES[quantity][0]
    asides = ("near", -0.00625), ("far", 0.00625)  # next to each other, not on each other
    for container, (policy, aside) in zip(panel.containers, asides, strict=True):
        line, _, (bars,) = container.lines
        rows = [row for row in table.rows if row.policy == policy]
        factor = QUANTITIES[quantity][1]
        drawn = [(row.options["mu"] + aside, factor * getattr(row, quantity)) for row in rows]
        np.testing.assert_allclose(line.get_xydata(), drawn)
        ends = [
            (getattr(row, f"{quantity}_low", None), getattr(row, f"{quantity}_high", None))
            for row in rows
        ]
        heights = [segment[:, 1] for segment in bars.get_segments()]
        for (low, high), height, (_, middle) in zip(ends, heights, drawn, strict=True):
            # A lower end above the mean, as here, is drawn at the mean.
            expected = (middle, middle if high is None else factor * high)
            assert low is None or low > middle / factor
            np.testing.assert_allclose(height, expected)


@pytest.mark.parametrize("quantity", ["success", "collision", "path_length_cm"])
def test_two_axes_give_a_map(quantity):
    table = table_of(["near", "far"], mu=[0.3, 0.1], world=["wood", "glass", "ice"])
    figure: Any = table.plot(quantity=quantity)
    panels = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert [axes.get_title(loc="left") for axes in panels] == [
        "near, scenario 2",
        "far, scenario 2",
    ]
    for panel, policy in zip(panels, ("near", "far"), strict=True):
        assert (panel.get_xlabel(), panel.get_ylabel()) == ("mu", "world")
        across = [text.get_text() for text in panel.get_xticklabels()]
        up = [text.get_text() for text in panel.get_yticklabels()]
        assert (across, up) == (["0.1", "0.3"], ["wood", "glass", "ice"])
        (image,) = panel.images
        for row in table.rows:
            if row.policy == policy:
                place = up.index(row.options["world"]), across.index(str(row.options["mu"]))
                expected = QUANTITIES[quantity][1] * getattr(row, quantity)
                assert np.asarray(image.get_array())[place] == pytest.approx(expected)
                (shown,) = (t for t in panel.texts if t.get_position() == place[::-1])
                dark = expected > np.mean(image.get_clim())  # "Blues" ends in dark blue
                assert (shown.get_color() == "white") == dark
    one = table.plot("mu", quantity)
    assert len(one.axes[0].containers) == 6


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.filterwarnings("error")
def test_a_map_of_rows_without_episodes_is_empty(quantity):
    table = table_of(["near"], mu=[0.3, 0.1], world=["wood", "glass"])
    rows = [msgspec.structs.replace(row, **dict.fromkeys(QUANTITIES)) for row in table.rows]
    figure: Any = msgspec.structs.replace(table, rows=tuple(rows)).plot(quantity=quantity)
    FigureCanvasAgg(figure).draw()
    assert np.isnan(np.ma.filled(figure.axes[0].images[0].get_array(), np.nan)).all()


@pytest.mark.parametrize("axes", [{"mu": [0.1, 0.2]}, {"method": ["$x_$", "$^$"]}])
def test_names_that_look_like_formulas_are_drawn_as_they_are(axes):
    figure: Any = table_of(["a$_$b.npz", "${$"], **axes).plot()
    FigureCanvasAgg(figure).draw()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a$_$b.npz", "${$"]


@pytest.mark.parametrize("policies", [["near", LONG], [f"policy number {k}" for k in range(12)]])
def test_legends_titles_and_labels_lie_within_the_figure(policies):
    figure: Any = table_of(policies, mu=[0.1, 0.2]).plot()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    (legend,) = figure.legends
    width, height = canvas.get_width_height()
    texts = [*legend.get_texts(), figure.axes[0].xaxis.label, figure.axes[0].yaxis.label]
    for part in (legend, *texts):
        box = part.get_window_extent()
        assert 0 <= box.x0 < box.x1 <= width, part
        assert 0 <= box.y0 < box.y1 <= height, part
    names = ["".join(text.get_text().split()) for text in legend.get_texts()]
    assert names == ["".join(name.split()) for name in policies]


def test_unknown_quantities_are_refused():
    with pytest.raises(UserError, match="quantity = 'speed' is unknown; choose one of success"):
        table_of(["near"], mu=[0.1]).plot(quantity="speed")
