"""The figure of `cosim.transfer` from a small table, and what is said of other files."""

from typing import Any

import msgspec
import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer

from analysis.figures import transfer as transfer_figure
from analysis.figures.style import FigureError
from analysis.reading.results import RESULTS
from analysis.reading.written import ResultError, TransferRow
from cosim.base.storage import write_json


def row(scenario, method, success, margin_m=0.0, mu=0.15):
    unknown: dict[str, Any] = dict.fromkeys(TransferRow.__struct_fields__)
    known = {
        "scenario": scenario,
        "method": method,
        "mu": mu,
        "safety_margin_m": margin_m,
        "episodes": 50,
        "success": success,
        "success_low": max(success - 0.1, 0.0),
        "success_high": min(success + 0.1, 1.0),
    }
    return TransferRow(**unknown | known)


ROWS = [
    row("1a", "paper", 0.8),
    row("2", "paper", 0.6),
    row("1a", "slip", 1.0),
    row("2", "slip", 0.9),
    row("2", "slip", 1.0, margin_m=0.01),
    row("2", "slip", 0.5, mu=0.1),
]


def points(axes):
    """Heights of the points of every series."""
    return {
        container.get_label(): np.asarray(container.lines[0].get_ydata()).tolist()
        for container in axes.containers
        if isinstance(container, ErrorbarContainer)
    }


def test_points_are_those_of_the_table():
    figure = transfer_figure.draw(ROWS)
    low_friction, default = figure.axes
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["µ = 0.1", "µ = 0.15"]
    assert points(default) == {
        "paper": [80.0, 60.0],
        "slip": [100.0, 90.0],
        "slip, safety layer 10 mm": [100.0],
    }
    assert points(low_friction) == {"paper": [], "slip": [50.0], "slip, safety layer 10 mm": []}


def test_caption_names_the_worst_scenario():
    caption = transfer_figure.caption(ROWS)
    assert "paper at least 60.0% [50.0, 70.0] (scenario 2, 100 episodes in all)" in caption.text()
    worst = {(s["mu"], s["series"]): s["worst_success"] for s in caption.numbers["series"]}
    assert worst[0.15, "slip"] == 0.9
    assert worst[0.1, "slip"] == 0.5


@pytest.fixture
def write(tmp_path):
    """Writes a transfer table and returns the results folder."""

    def write(content):
        write_json(RESULTS["transfer"].proof_in(tmp_path), content)
        return tmp_path

    return write


def test_rows_without_episodes_are_left_out(write):
    unknown = msgspec.structs.replace(ROWS[0], success=None)
    numbers = transfer_figure.make(write({"rows": [*ROWS, unknown]})).caption.numbers
    assert numbers == transfer_figure.caption(ROWS).numbers
    with pytest.raises(FigureError, match="no rows with episodes"):
        transfer_figure.make(write({"rows": [unknown]}))


def test_other_files_are_refused(write, tmp_path):
    with pytest.raises(ResultError, match=r"no such result of `python -m cosim\.transfer`"):
        transfer_figure.make(tmp_path)
    for content in ("no table", [], {}, {"rows": [{"success": 1.0}]}):
        with pytest.raises(ResultError, match="not a result of"):
            transfer_figure.make(write(content))
