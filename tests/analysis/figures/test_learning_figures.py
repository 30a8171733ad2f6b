"""Figures 5, 8, 10 and 11 from small experiments, and what is said of other folders."""

import json
import shutil
import sys
from types import SimpleNamespace
from typing import get_args

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Rectangle

from agent.experiments.results import show
from agent.experiments.variants import Name, variants_of
from analysis.figures import fig05
from analysis.figures.learning import (
    POINTS,
    VariantCurves,
    draw_learning_curves,
    fig10,
    learned,
    load_variants,
    path_ratio,
    plot_band,
    settled_after,
    thinned,
)
from analysis.reading.results import RESULTS, read_experiment
from cosim.base.errors import UserError
from cosim.model.scenario_file import BUILT_IN, find_scenario
from minirobots.runner import execute


def test_curves_are_those_of_the_runs(results):
    folder = RESULTS["fig11"].location(results)
    content = read_experiment("fig11", results)
    variants = load_variants(folder, content)
    assert list(variants) == ["2", "3", "4"]
    figure = draw_learning_curves(variants)
    behaviour, _, greedy, greedy_path = figure.axes
    means = [
        [line for line in axes.lines if not str(line.get_label()).startswith("_")]
        for axes in (behaviour, greedy)
    ]
    for own, greedy_mean, variant in zip(*means, variants.values(), strict=True):
        log = variant.logs[0]
        assert log.episode.tolist() == [1000, 2000, 3000]
        drawn = np.asarray(own.get_ydata())
        np.testing.assert_allclose(drawn, 100.0 * variant.curves("success").mean(axis=0))
        final = [100.0 * (run.success or 0.0) for run in content.variants[variant.scenario].runs]
        assert np.asarray(greedy_mean.get_ydata())[-1] == pytest.approx(np.mean(final))
    assert greedy_path.get_ylabel() == "path length in cm"


def test_thinning_takes_means_without_missing_points():
    curves = np.arange(2.0 * 10 * POINTS).reshape(2, -1)
    curves[0, 3] = np.nan
    episodes, thin = thinned(np.arange(10.0 * POINTS), curves)
    assert thin.shape == (2, POINTS)
    assert thin[0, 0] == pytest.approx(np.mean([0, 1, 2, 4, 5, 6, 7, 8, 9]))
    assert episodes[0] == 4.5
    short = np.ones((2, 5))
    assert np.array_equal(thinned(np.arange(5.0), short)[1], short)


def test_band_leaves_out_points_that_no_run_has():
    axes = plt.figure().add_subplot()
    curves = np.array([[1.0, np.nan, 3.0], [3.0, np.nan, np.nan]])
    plot_band(axes, np.array([0.0, 1e6, 2e6]), curves, "x")
    assert np.array_equal(axes.lines[0].get_xdata(), [0.0, 2.0])
    assert np.array_equal(axes.lines[0].get_ydata(), [2.0, 3.0])


def test_captions_state_the_numbers_of_the_results(results):
    content = read_experiment("fig10", results)
    caption = fig10(results).caption
    over_runs = content.variants["c2"].over_runs
    assert caption.numbers["c2"]["success"] == over_runs["success"]
    difference = content.differences["c5"]["path_length_cm"]
    assert caption.numbers["c5_path_length_cm_difference"] == difference
    assert len(caption.ours) == len(content.variants) + 1
    drawing, content = path_ratio(results), read_experiment("fig08", results).variants["1a"]
    assert drawing.caption.numbers["1a"]["path_length"] == content.over_runs["ratio_to_bound"]


@pytest.mark.parametrize(
    ("low", "verdict"),
    [(0.1, "confirmed"), (-0.1, "not confirmed"), (None, "cannot be tested")],
)
def test_c_is_better_where_no_interval_of_the_others_reaches_zero(results, tmp_path, low, verdict):
    folder = RESULTS["fig10"].location(tmp_path)
    shutil.copytree(RESULTS["fig10"].location(results), folder)
    content = json.loads((folder / "results.json").read_text())
    for difference in content["differences"].values():
        difference["path_length_cm"] |= {"mean": 0.5, "low": low, "high": 0.9}
    (folder / "results.json").write_text(json.dumps(content))
    (claim,) = fig10(tmp_path).caption.claims
    assert claim.verdict == verdict


@pytest.mark.parametrize(
    ("figure", "verdict"),
    [
        ("fig08", "confirmed in moves, not confirmed in centimetres"),
        ("fig11", "confirmed on the grid"),
    ],
)
def test_learning_is_confirmed_where_every_run_succeeds(results, tmp_path, figure, verdict):
    folder = RESULTS[figure].location(tmp_path)
    shutil.copytree(RESULTS[figure].location(results), folder)
    content = json.loads((folder / "results.json").read_text())
    for variant in content["variants"].values():
        for run in variant["runs"]:
            run["success"] = 1.0
        variant["over_runs"]["steps_ratio_to_bound"]["mean"] = 1.0
        variant["over_runs"]["ratio_to_bound"]["mean"] = 1.1
    (folder / "results.json").write_text(json.dumps(content))
    (claim,) = learned(figure, tmp_path).caption.claims
    assert claim.verdict == verdict
    next(iter(content["variants"].values()))["runs"][0]["success"] = 0.9
    (folder / "results.json").write_text(json.dumps(content))
    (claim,) = learned(figure, tmp_path).caption.claims
    assert claim.verdict.startswith("not confirmed")


def test_learnt_is_where_success_stays_high():
    def variant(rates):
        log = SimpleNamespace(
            greedy_success=np.array(rates), greedy_episode=1000 * np.arange(1, 1 + len(rates))
        )
        return VariantCurves("x", "2", (log,))  # pyright: ignore[reportArgumentType]

    assert settled_after(variant([0.2, 1.0, 0.9, 1.0, 1.0]), 0.99) == 4000
    assert settled_after(variant([1.0, 1.0]), 0.99) == 1000
    assert settled_after(variant([1.0, 0.5]), 0.99) is None


def test_fig05_draws_every_scenario():
    scenarios = [find_scenario(name) for name in BUILT_IN]
    figure = fig05.draw(scenarios)
    for axes, scenario in zip(figure.axes, scenarios, strict=True):
        cells = 1 + sum(len(starts) + 1 for starts in scenario.starts)
        assert len(axes.patches) == cells + len(scenario.obstacles)
        squares = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        dark = {square.get_xy() for square in squares if square.get_alpha() == 0.8}
        assert dark == set(scenario.obstacles)


def test_other_folders_are_refused(results, tmp_path):
    with pytest.raises(UserError, match=r"run `minirobots experiments fig08"):
        read_experiment("fig08", tmp_path)
    copy = RESULTS["fig08"].location(tmp_path)
    shutil.copytree(RESULTS["fig11"].location(results), copy)
    with pytest.raises(UserError, match="not a result of fig08"):
        read_experiment("fig08", tmp_path)
    shutil.copytree(RESULTS["fig08"].location(results), copy, dirs_exist_ok=True)
    (copy / "1a" / "run_001" / "policy.npz").unlink()
    with pytest.raises(UserError, match="runs are missing"):
        load_variants(copy, read_experiment("fig08", tmp_path))


def test_experiments_go_on_and_print_json(results, monkeypatch, capsys):
    folder = RESULTS["fig08"].location(results)
    arguments = ("fig08", "--runs", "2", "--episodes", "3000", "--jobs", "1", "--json")
    monkeypatch.setattr(sys, "argv", ["x", *arguments, "--out", str(folder)])
    before = json.loads((folder / "results.json").read_text())
    execute("experiments")
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert content["variants"] == before["variants"]
    assert content["variants"]["1b"]["over_runs"]["success"]["runs"] == 2


def test_variants_are_compared_run_by_run(results, capsys):
    content = read_experiment("fig10", results)
    runs = {name: variant.runs for name, variant in content.variants.items()}
    pairs = zip(runs["c5"], runs["c1.5"], strict=True)
    expected = np.mean([(a.success or 0.0) - (b.success or 0.0) for a, b in pairs])
    assert content.differences["c5"]["success"].mean == pytest.approx(expected)
    assert "c1.5" not in content.differences
    show(content)
    assert "c = 5 minus c = 1.5" in capsys.readouterr().out


def test_every_experiment_changes_one_thing_of_the_default():
    for name in get_args(Name):
        variants = variants_of(name)
        distinct = {(v.scenario, v.process, v.learning) for v in variants.values()}
        assert {v.reference for v in variants.values()} <= {None, *variants}
        assert len(distinct) == len(variants)
