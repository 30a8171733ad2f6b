"""Figures 5 and 8 to 12 from experiments run in the small, and what is said of other folders."""

import json
import shutil
import sys

import matplotlib.pyplot as plt
import numpy as np
import pytest
from rich.console import Console

from agent.evaluation import evaluate
from agent.experiments import EXPERIMENTS, Experiments, main, run_experiment, show
from analysis import fig05, fig08, fig09, fig10, fig11, fig12
from analysis.board import ROBOT_COLOURS
from analysis.learning import (
    POINTS,
    draw_learning_curves,
    first_policy,
    load_experiment,
    plot_band,
    summary,
    thinned,
)
from analysis.style import FigureError
from analysis.trajectories import draw_examples, examples
from cosim.errors import run_command
from cosim.scenario import BUILT_IN

EPISODES = 3000


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folders of the three experiments with two short runs each."""
    out = tmp_path_factory.mktemp("experiments")
    for name in ("fig08", "fig10", "fig11"):
        options = Experiments(name, runs=2, episodes=EPISODES, out=out / name, jobs=1)
        run_experiment(options, Console(stderr=True))
    return out


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def run(monkeypatch, module, *arguments):
    monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, arguments)])
    module.main()


@pytest.mark.parametrize(
    ("module", "experiment"),
    [(fig08, "fig08"), (fig09, "fig08"), (fig10, "fig10"), (fig11, "fig11"), (fig12, "fig11")],
)
def test_figures_are_written_and_repeat(module, experiment, results, tmp_path, monkeypatch):
    for name in ("one.png", "two.png"):
        run(monkeypatch, module, "--results", results / experiment, "--out", tmp_path / name)
    for suffix, magic in ((".png", b"\x89PNG"), (".pdf", b"%PDF")):
        first = (tmp_path / f"one{suffix}").read_bytes()
        assert first.startswith(magic)
        assert first == (tmp_path / f"two{suffix}").read_bytes()


def test_curves_are_those_of_the_runs(results):
    variants = load_experiment(results / "fig11", "fig11")
    assert list(variants) == ["2", "3", "4"]
    figure = draw_learning_curves(variants)
    behaviour, _, greedy, greedy_path = figure.axes
    for k, variant in enumerate(variants.values()):
        log = variant.logs[0]
        assert log.episode.tolist() == [1000, 2000, 3000]
        drawn = np.asarray(behaviour.lines[k].get_ydata())
        np.testing.assert_allclose(drawn, 100.0 * variant.curves("success").mean(axis=0))
        final = [
            100.0 * evaluate(p.process, p.values).rate("success")
            for p in (first_policy(variant), type(first_policy(variant)).load(variant.policies[1]))
        ]
        assert np.asarray(greedy.lines[k].get_ydata())[-1] == pytest.approx(np.mean(final))
    assert greedy_path.get_ylabel() == "path length in cm"
    assert len(summary(variants)) == 3


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


def test_ways_are_those_of_the_evaluation(results):
    policy = first_policy(load_experiment(results / "fig11", "fig11")["2"])
    result = evaluate(policy.process, policy.values)
    for example in examples(policy, 5, seed=1):
        k = np.flatnonzero((result.starts == example.cells[0]).all(axis=(1, 2)))[0]
        moves = np.abs(np.diff(example.cells, axis=0)).max(axis=2).sum(axis=0)
        assert moves.tolist() == result.steps[k].tolist()
    figure = draw_examples([[(policy, examples(policy, 2, seed=1))]])
    ways = figure.axes[0].lines
    assert len(ways) == 4
    assert [way.get_color() for way in ways] == [*ROBOT_COLOURS[:2]] * 2


def test_fig05_draws_every_scenario(tmp_path, monkeypatch):
    figure = fig05.draw(list(BUILT_IN.values()))
    for axes, scenario in zip(figure.axes, BUILT_IN.values(), strict=True):
        cells = 1 + sum(len(starts) + 1 for starts in scenario.starts)
        assert len(axes.patches) == cells
    run(monkeypatch, fig05, "--out", tmp_path / "fig05")
    assert (tmp_path / "fig05.pdf").exists()


def test_other_folders_are_refused(results, tmp_path):
    with pytest.raises(FigureError, match=r"run `python -m agent.experiments fig08"):
        load_experiment(tmp_path, "fig08")
    with pytest.raises(FigureError, match="not results of fig08"):
        load_experiment(results / "fig11", "fig08")
    copy = tmp_path / "copy"
    shutil.copytree(results / "fig08", copy)
    (copy / "1a" / "run_001" / "policy.npz").unlink()
    with pytest.raises(FigureError, match="runs are missing"):
        load_experiment(copy, "fig08")


def test_experiments_resume_and_print_json(results, monkeypatch, capsys):
    arguments = ("fig08", "--runs", "2", "--episodes", str(EPISODES), "--jobs", "1", "--json")
    monkeypatch.setattr(sys, "argv", ["x", *arguments, "--out", str(results / "fig08")])
    with pytest.raises(SystemExit):
        run_command(main)
    assert "add --resume" in capsys.readouterr().err
    before = json.loads((results / "fig08" / "results.json").read_text())
    sys.argv.append("--resume")
    main()
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert content["variants"] == before["variants"]
    assert content["variants"]["1b"]["over_runs"]["success"]["runs"] == 2


def test_variants_are_compared_run_by_run(results, capsys):
    content = json.loads((results / "fig10" / "results.json").read_text())
    runs = {name: variant["runs"] for name, variant in content["variants"].items()}
    pairs = zip(runs["c5"], runs["c1.5"], strict=True)
    expected = np.mean([a["success"] - b["success"] for a, b in pairs])
    assert content["differences"]["c5"]["success"]["mean"] == pytest.approx(expected)
    assert "c1.5" not in content["differences"]
    show(content, Console())
    assert "minus c = 1.5, run by run" in capsys.readouterr().out


def test_every_experiment_changes_one_thing_of_the_default():
    for variants in EXPERIMENTS.values():
        distinct = {(v.scenario, v.process, v.learning) for v in variants.values()}
        assert len(distinct) == len(variants)
