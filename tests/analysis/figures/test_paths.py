"""Paths and the motor's cycle from short recordings, and learning curves from short trainings."""

import json

import numpy as np
import pytest

from analysis.figures import learning, motor_cycle, paths
from analysis.reading.results import RESULTS, read_experiment, recordings
from cosim.base.colours import ROBOT_COLOURS
from cosim.model.params import STEERING, TABLE_I, TABLE_II
from cosim.recording.reader import read_episode


def test_curves_are_those_of_the_runs(results):
    content = read_experiment("fig11", results)
    variants = learning.load_variants(RESULTS["fig11"].location(results), content)
    assert list(variants) == ["2", "3", "4"]
    for name, variant in variants.items():
        assert variant.logs[0].episode.tolist() == [1000, 2000, 3000]
        final = [run.success or 0.0 for run in content.variants[name].runs]
        np.testing.assert_allclose(variant.curves("greedy_success")[:, -1], final)


def test_tracks_are_those_of_the_recordings(results, run_folder):
    drawing = paths.fig12(results)
    boards, distances = drawing.figure.axes[:6], drawing.figure.axes[6:]
    assert [len(axes.lines) for axes in distances] == [3, 3, 3]  # two methods, and contact
    lines = [line for line in boards[3].lines if len(np.asarray(line.get_xdata())) > 100]
    assert [line.get_color() for line in lines] == [*ROBOT_COLOURS[:2]]
    (path,) = recordings("episodes_2_moves", results)
    position = read_episode(path).signals["/sim/r2/position"].values
    np.testing.assert_array_equal(lines[1].get_xydata(), 100.0 * position)
    (result,) = json.loads((run_folder / "summary.json").read_text())["episodes"]
    assert drawing.numbers["2 moves"]["outcomes"] == [result["outcome"]] == ["timeout"]
    lengths = [100.0 * length for length in paths.read_track(path).path_length_m]
    assert lengths == pytest.approx(result["path_length_cm_by_robot"], abs=0.05)
    text = " ".join(drawing.ours)
    assert "Scenario 2, method moves: 0 of 1 co-simulated episodes end in success" in text


def test_one_board_holds_all_tracks_of_one_robot(results):
    """Methods are compared from the same starts and with the same noise."""
    figure = paths.fig09(results).figure
    cases = [(name, method) for method in ("paper", "moves") for name in ("1a", "1b")]
    titles = [f"{name}, {method}: 0 of 1 reached" for name, method in cases]
    assert [axes.get_title(loc="left") for axes in figure.axes] == titles
    paper, moves = (recordings(f"episodes_1a_{method}", results) for method in ("paper", "moves"))
    starts = [[paths.read_track(p).positions_m[0][0].tolist() for p in of] for of in (paper, moves)]
    # The first rows are 25 ms old.
    np.testing.assert_allclose(starts[0], starts[1], atol=1e-4)


@pytest.fixture(scope="module")
def cycle(results):
    (path,) = recordings("episodes_2_moves", results)
    return motor_cycle.find_cycle(read_episode(path))


def test_friction_of_a_cycle_is_along_the_body(results, cycle):
    (path,) = recordings("episodes_2_moves", results)
    raw = read_episode(path).signals[f"/raw/{cycle.robot}/friction"]
    along = [k for k, name in enumerate(raw.names) if name.endswith("x")]
    assert len(along) == 3
    every_tick = raw.values[np.searchsorted(raw.time_s, cycle.time_s)][:, along].sum(axis=1)
    whole = np.convolve(every_tick, np.ones(10) / 10, "same")[10:-10]
    np.testing.assert_allclose(cycle.friction_n[10:-10], whole, atol=1e-9)


def test_cycle_is_one_turn(cycle):
    turn = 2.0 * np.pi
    assert abs(cycle.theta[-1, 0] - cycle.theta[0, 0]) == pytest.approx(turn, rel=0.01)
    assert np.abs(cycle.omega).mean() == pytest.approx(STEERING.forward_speed_rad_s, rel=0.1)
    # Eq. (3) at constant speed, φ = ±90°: what the speed changes within the turn is left out.
    sines = cycle.omega**2 * np.sin(cycle.theta)
    expected = TABLE_II.m * TABLE_II.r * (sines[:, 1] - sines[:, 0])
    np.testing.assert_allclose(cycle.driving_n, expected, atol=0.05 * np.abs(expected).max())
    numbers = motor_cycle.drawing_of(cycle).numbers
    assert 0.0 < numbers["sliding_share"] <= 1.0
    assert numbers["step_um"] == pytest.approx(1e6 * cycle.ahead_m[-1])


def test_forces_of_a_cycle_keep_coulombs_law_and_newtons(cycle):
    assert (np.abs(cycle.friction_n) <= cycle.holds_n * (1.0 + 1e-6)).all()
    # On average over a turn the floor bears the weight.
    weight = (TABLE_I.mass_kg + 2.0 * TABLE_II.m) * TABLE_II.g
    assert cycle.normal_n.sum(axis=1).mean() == pytest.approx(weight, rel=0.1)
