"""Captions and verdicts are those of the results."""

import json
import re
import shutil

import msgspec
import numpy as np
import pytest

from agent.experiments.results import show
from analysis.figures import fig03, learning, paths, transfer
from analysis.reading.results import RESULTS, read_experiment
from analysis.report.page import learning_table
from cosim.base.errors import UserError
from cosim.machine.platform.motion import PlatformResult


def test_platform(results):
    result = PlatformResult.load(RESULTS["platform"].location(results))
    drawing = fig03.make(results)
    step_um = 1e6 * float(result.table_ii.net_displacement_m)
    assert drawing.numbers["table_ii_step_um"] == step_um
    assert f"{step_um:.1f} µm a turn" in drawing.ours[1]
    assert drawing.numbers["slip_speed_rad_s"] < drawing.numbers["drift_speed_rad_s"]
    assert "25 µm a turn at 3.9 mm/s" in drawing.judged[0][0]


def test_learning(results):
    content = read_experiment("fig10", results)
    drawing = learning.fig10(results)
    over_runs = content.variants["c2"].over_runs
    assert drawing.numbers["c2"]["success"] == over_runs["success"]
    difference = content.differences["c5"]["path_length_cm"]
    assert drawing.numbers["c5_path_length_cm_difference"] == difference
    assert len(drawing.ours) == len(content.variants) + 1
    ratios = learning.path_ratio(results).numbers["1a"]
    over_runs = read_experiment("fig08", results).variants["1a"].over_runs
    assert ratios["path_length"] == over_runs["ratio_to_bound"]


def test_variants_are_compared_run_by_run(results, capsys):
    content = read_experiment("fig10", results)
    runs = {name: variant.runs for name, variant in content.variants.items()}
    pairs = zip(runs["c5"], runs["c1.5"], strict=True)
    expected = np.mean([(a.success or 0.0) - (b.success or 0.0) for a, b in pairs])
    assert content.differences["c5"]["success"].mean == pytest.approx(expected)
    assert "c1.5" not in content.differences
    show(content)
    assert "c = 5 minus c = 1.5" in capsys.readouterr().out


@pytest.fixture
def edited(results, tmp_path):
    """Edits the results of an experiment in a copy, and returns its results folder."""

    def edit(figure, change):
        folder = RESULTS[figure].location(tmp_path)
        shutil.copytree(RESULTS[figure].location(results), folder, dirs_exist_ok=True)
        content = json.loads((folder / "results.json").read_text())
        change(content)
        (folder / "results.json").write_text(json.dumps(content))
        return tmp_path

    return edit


def test_tables_have_every_measure_in_its_column(edited, capsys, monkeypatch):
    means = {"success": 0.11, "path_length_cm": 22.0, "steps": 33.0, "ratio_to_bound": 1.44}

    def change(content):
        for variant in content["variants"].values():
            for name, mean in means.items():
                variant["over_runs"][name] |= {"mean": mean}
        for difference in content["differences"].values():
            for name in difference:
                difference[name] |= {"mean": means[name] + 0.02}

    content = read_experiment("fig10", edited("fig10", change))
    monkeypatch.setenv("COLUMNS", "150")
    show(content)
    rows = [
        re.findall(r"(?<![\d.])\d+\.\d+(?= %| \[)", line)
        for line in capsys.readouterr().out.splitlines()
    ]
    numbers, differences = ["11.00", "22.00", "33.00", "1.440"], ["13.00", "22.02", "33.02"]
    count = len(content.variants)
    assert [row for row in rows if row] == [numbers] * count + [differences] * (count - 1)
    shown = [" ".join(row) for row in learning_table("", content).rows]
    assert sum(row.endswith(("22.02 [–]", "22.02 [−]")) for row in shown) == count - 1


@pytest.mark.parametrize(
    ("low", "verdict"),
    [(0.1, "confirmed"), (-0.1, "not confirmed"), (None, "cannot be tested")],
)
def test_c_is_better_where_no_interval_of_the_others_reaches_zero(edited, low, verdict):
    def change(content):
        for difference in content["differences"].values():
            difference["path_length_cm"] |= {"mean": 0.5, "low": low, "high": 0.9}

    ((_, found),) = learning.fig10(edited("fig10", change)).judged
    assert found == verdict


@pytest.mark.parametrize(
    ("figure", "failing", "verdict"),
    [
        ("fig08", 0, "confirmed in moves, not confirmed in centimetres"),
        ("fig11", 0, "confirmed on the grid"),
        ("fig08", 1, "not confirmed in moves and in centimetres"),
        ("fig11", 1, "not confirmed on the grid"),
    ],
)
def test_learning_is_confirmed_where_every_run_succeeds(edited, figure, failing, verdict):
    def change(content):
        runs = [run for variant in content["variants"].values() for run in variant["runs"]]
        for number, run in enumerate(runs):
            run["success"] = 0.9 if number < failing else 1.0
        for variant in content["variants"].values():
            variant["over_runs"]["steps_ratio_to_bound"]["mean"] = 1.0
            variant["over_runs"]["ratio_to_bound"]["mean"] = 1.1

    ((_, found),) = getattr(learning, figure)(edited(figure, change)).judged
    assert found == verdict


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


def test_transfer_names_the_worst_scenario_and_leaves_out_rows_without_episodes(
    rows, write_transfer
):
    unknown = msgspec.structs.replace(rows[0], success=None)
    drawing = transfer.make(write_transfer(*rows, unknown))
    text = " ".join(drawing.ours)
    assert "paper at least 60.0% [50.0, 70.0] (scenario 2, 100 episodes in all)" in text
    worst = {(s["mu"], s["series"]): s["worst_success"] for s in drawing.numbers["series"]}
    assert worst[0.15, "moves"] == 0.9
    assert worst[0.1, "moves"] == 0.5
    with pytest.raises(UserError, match="no rows with episodes"):
        transfer.make(write_transfer(unknown))


def test_paths_are_judged_by_the_transfer_study(results, tmp_path, row, write_transfer):
    """The page's rows are the paper's method without the shield, not the few recorded episodes."""
    (tmp_path / "episodes").symlink_to(results / "episodes")
    figures = (paths.fig09, paths.fig12)
    for figure in figures:
        assert figure(tmp_path).judged == (
            (
                "not evaluated: see `minirobots study docs/studies/methods.toml`",
                "cannot be tested",
            ),
        )
    others = row("2", "moves", 0.5), row("2", "paper", 0.5, shield=True)
    pairs = row("2", "paper", 1.0), row("3", "paper", 0.98)
    write_transfer(row("1a", "paper", 1.0), row("1b", "paper", 1.0), *pairs, *others)
    (single,), (pair,) = (figure(tmp_path).judged for figure in figures)
    assert "1a in 50 of 50 [90.0, 100.0], 1b in 50 of 50" in single[0]
    assert single[1] == "confirmed"
    assert "2 in 50 of 50 [90.0, 100.0], 3 in 49 of 50 [88.0, 100.0] episodes" in pair[0]
    assert pair[1] == "confirmed in 2, not confirmed in 3"
