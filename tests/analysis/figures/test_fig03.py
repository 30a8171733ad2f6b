"""Fig. 3 from a result file of `minirobots platform`, and what is said of other files."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from analysis.figures import fig03
from analysis.figures.style import save
from analysis.reading.results import RESULTS
from cosim.base.errors import UserError
from cosim.machine.platform.motion import PlatformResult


def test_files_that_are_no_results_are_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.npz: no such result of `minirobots"):
        PlatformResult.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("not a result")
    with pytest.raises(UserError, match=r"not a result of `minirobots platform`"):
        PlatformResult.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(UserError, match="not a result"):
        PlatformResult.load(tmp_path / "other.npz")
    with pytest.raises(UserError, match=r"name a \.png or \.pdf file"):
        save(plt.figure(), tmp_path / "figure.svg")


def test_caption_states_the_numbers_of_the_file(results):
    result = PlatformResult.load(RESULTS["platform"].location(results))
    caption = fig03.caption(result)
    step_um = 1e6 * float(result.table_ii.net_displacement_m)
    assert caption.numbers["table_ii_step_um"] == step_um
    assert f"{step_um:.1f} µm a turn" in caption.text()
    assert caption.numbers["slip_speed_rad_s"] < caption.numbers["drift_speed_rad_s"]
