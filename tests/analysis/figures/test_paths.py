"""Figures 9 and 12 and the motor's cycle from short recordings."""

import json

import numpy as np
import pytest

from analysis.figures import motor_cycle, paths
from analysis.figures.fig05 import ROBOT_COLOURS
from analysis.reading.results import recordings
from cosim.base.errors import UserError
from cosim.model.params import STEERING, TABLE_I, TABLE_II
from cosim.recording.reader import read_episode


def test_tracks_are_those_of_the_recordings(results, run_folder):
    figure, caption = paths.fig12(results)
    boards, distances = figure.axes[:6], figure.axes[6:]
    assert [len(axes.lines) for axes in distances] == [3, 3, 3]  # two methods, and contact
    lines = [line for line in boards[3].lines if len(np.asarray(line.get_xdata())) > 100]
    assert [line.get_color() for line in lines] == [*ROBOT_COLOURS[:2]]
    (path,) = recordings("episodes_2_moves", results)
    position = read_episode(path).signals["/sim/r2/position"].values
    np.testing.assert_array_equal(lines[1].get_xydata(), 100.0 * position)
    (result,) = json.loads((run_folder / "summary.json").read_text())["episodes"]
    assert caption.numbers["2 moves"]["outcomes"] == [result["outcome"]] == ["timeout"]
    lengths = [100.0 * length for length in paths.read_track(path).path_length_m]
    assert lengths == pytest.approx(result["path_length_cm_by_robot"], abs=0.05)
    assert "Scenario 2, method moves: 0 of 1 co-simulated episodes end in success" in caption.text()


def test_one_board_holds_all_tracks_of_one_robot(results):
    figure, caption = paths.fig09(results)
    cases = [(name, method) for method in ("paper", "moves") for name in ("1a", "1b")]
    titles = [f"{name}, {method}: 0 of 1 reached" for name, method in cases]
    assert [axes.get_title(loc="left") for axes in figure.axes] == titles
    assert caption.inputs[:2] == ("episodes_1a_paper", "episodes_1b_paper")


def test_missing_recordings_are_named(tmp_path):
    with pytest.raises(UserError, match=r"run `minirobots run --scenario 1a"):
        paths.fig09(tmp_path)
    with pytest.raises(UserError, match=r"run `minirobots run --scenario 2"):
        motor_cycle.make(tmp_path)


@pytest.fixture(scope="module")
def cycle(results):
    (path,) = recordings("episodes_2_moves", results)
    return motor_cycle.find_cycle(read_episode(path))


def test_cycle_is_one_turn(cycle):
    turn = 2.0 * np.pi
    assert abs(cycle.theta[-1, 0] - cycle.theta[0, 0]) == pytest.approx(turn, rel=0.01)
    assert np.abs(cycle.omega).mean() == pytest.approx(STEERING.forward_speed_rad_s, rel=0.1)
    # Eq. (3) at constant speed, φ = ±90°: what the speed changes within the turn is left out.
    sines = cycle.omega**2 * np.sin(cycle.theta)
    expected = TABLE_II.m * TABLE_II.r * (sines[:, 1] - sines[:, 0])
    np.testing.assert_allclose(cycle.driving_n, expected, atol=0.05 * np.abs(expected).max())


def test_forces_of_a_cycle_keep_coulombs_law_and_newtons(cycle):
    assert (np.abs(cycle.friction_n) <= cycle.holds_n * (1.0 + 1e-6)).all()
    # On average over a turn the floor bears the weight.
    weight = (TABLE_I.mass_kg + 2.0 * TABLE_II.m) * TABLE_II.g
    assert cycle.normal_n.sum(axis=1).mean() == pytest.approx(weight, rel=0.1)


def test_cycle_is_described(cycle):
    caption = motor_cycle.caption(cycle)
    assert 0.0 < caption.numbers["sliding_share"] <= 1.0
    assert caption.numbers["step_um"] == pytest.approx(1e6 * cycle.ahead_m[-1])


def test_methods_meet_the_same_starts(results):
    """Two methods are compared from the same starts and with the same noise."""
    paper, moves = (recordings(f"episodes_1a_{method}", results) for method in ("paper", "moves"))
    starts = [[paths.read_track(p).positions_m[0][0].tolist() for p in of] for of in (paper, moves)]
    assert starts[0] == starts[1]
