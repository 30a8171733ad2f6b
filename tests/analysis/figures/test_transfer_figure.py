"""The figure of `minirobots transfer` from a small table, and what is said of other files."""

import msgspec
import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer

from analysis.figures import transfer as transfer_figure
from analysis.reading.results import RESULTS
from cosim.base.errors import UserError
from cosim.base.storage import write_json


@pytest.fixture
def rows(row):
    return [
        row("1a", "paper", 0.8),
        row("2", "paper", 0.6),
        row("1a", "moves", 1.0),
        row("2", "moves", 0.9),
        row("2", "moves", 1.0, shield=True),
        row("2", "moves", 0.5, mu=0.1),
    ]


def points(axes):
    """Heights of the points of every series."""
    return {
        container.get_label(): np.asarray(container.lines[0].get_ydata()).tolist()
        for container in axes.containers
        if isinstance(container, ErrorbarContainer)
    }


def test_points_are_those_of_the_table(rows):
    figure = transfer_figure.draw(rows)
    low_friction, default = figure.axes
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["µ = 0.1", "µ = 0.15"]
    assert points(default) == {
        "paper": [80.0, 60.0],
        "moves": [100.0, 90.0],
        "moves, shield": [100.0],
    }
    assert points(low_friction) == {"paper": [], "moves": [50.0], "moves, shield": []}


def test_caption_names_the_worst_scenario(rows):
    caption = transfer_figure.caption(rows)
    assert "paper at least 60.0% [50.0, 70.0] (scenario 2, 100 episodes in all)" in caption.text()
    worst = {(s["mu"], s["series"]): s["worst_success"] for s in caption.numbers["series"]}
    assert worst[0.15, "moves"] == 0.9
    assert worst[0.1, "moves"] == 0.5


def test_rows_without_episodes_are_left_out(rows, write_transfer):
    unknown = msgspec.structs.replace(rows[0], success=None)
    numbers = transfer_figure.make(write_transfer(*rows, unknown)).caption.numbers
    assert numbers == transfer_figure.caption(rows).numbers
    with pytest.raises(UserError, match="no rows with episodes"):
        transfer_figure.make(write_transfer(unknown))


def test_other_files_are_refused(tmp_path):
    with pytest.raises(UserError, match=r"no such result of `minirobots transfer`"):
        transfer_figure.make(tmp_path)
    for content in ("no table", [], {}, {"rows": [{"success": 1.0}]}):
        write_json(RESULTS["transfer"].proof_in(tmp_path), content)
        with pytest.raises(UserError, match="not a result of"):
            transfer_figure.make(tmp_path)
