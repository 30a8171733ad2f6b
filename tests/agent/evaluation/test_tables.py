"""Tables on a terminal of 80 columns: every name and every number is whole."""

import contextlib
import io
import re
from dataclasses import replace
from typing import Any

import msgspec
import pytest

from agent.evaluation.rows import Failure, Row, columns_of
from agent.evaluation.statistics import Statistics, rate
from agent.experiments import results as experiments
from agent.mdp.exact import joint_starts
from agent.study import grid
from agent.study.report import Report
from analysis.report.page import learning_table
from cosim.base.table import show_texts
from cosim.model.outcome import Outcome

SHARES = {"success": 0.9876, "collision": 0.0123, "out_of_board": 0.0001, "timeout": 0.0}
LENGTHS = {"path_length_cm": 43.21, "steps": 39.87}
LENGTHS |= {"ratio_to_bound": 1.012, "steps_ratio_to_bound": 1.034}
STATISTICS = Statistics(mean=0.9876, iqm=0.98, low=0.9, high=0.999, runs=10)
OVER = dict.fromkeys([*SHARES, *LENGTHS], STATISTICS)


def dynamics_row(**others: Any) -> Row:
    """A row of 50 episodes of 200 in which every measure has a value."""
    low = {f"{name}_low": max(0.0, share - 0.0456) for name, share in SHARES.items()}
    high = {f"{name}_high": min(1.0, share + 0.0456) for name, share in SHARES.items()}
    ratio = zip(("", "_low", "_high"), (1.234, 1.111, 1.345), strict=True)
    known = {f"path_ratio_to_grid{end}": value for end, value in ratio}
    known |= {"path_length_cm": 123.4, "rotation_deg": 345.0, "min_distance_cm": 12.34}
    known |= {"sim_time_s": 123.0, "energy_j": 456.7, "mu": 0.15, "wall_s": 120.0}
    counts = {"starts": 900, "episodes": 50, "planned": 200, "failing_starts": 0}
    return Row(**{"scenario": "4", **SHARES, **low, **high, **known, **counts, **others})


def grid_row(**others: Any) -> Row:
    counts = {"scenario": "4", "starts": 900, "episodes": 900, "planned": 900, "failing_starts": 0}
    return Row(**{"policy": "", **counts, **SHARES, **LENGTHS} | others)


def printed(show, content, width=80) -> str:
    """What is printed on a terminal; lines outside of tables may be longer than it is wide."""
    output = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(output):
        patch.setenv("COLUMNS", str(width))
        show(content)
    text = output.getvalue()
    assert max(len(line) for line in text.splitlines() if line[0:1] == "─") <= width
    assert "…" not in text
    return text


def tables(rows: list[tuple[str, ...]], **layout: Any) -> str:
    return printed(lambda rows: show_texts([*"abcd"], rows, title="all", **layout), rows)


def test_a_table_has_what_there_is_room_for():
    text = tables([("first row", "1 1 " * 15, "2 2 " * 15, "3")])  # words go on in further lines
    counts = [text.count(found) for found in ("all", "\n─", "first row", "1", "2")]
    assert counts == [1, 1, 1, 30, 30]
    rows = [("first row", "1" * 30, "2" * 30, "3" * 30)]  # a line for each heading
    text = tables(rows)
    lines = re.findall(r"^(\w)  (\S.*\S) *$", text, re.MULTILINE)
    assert lines == [*zip("abcd", rows[0], strict=True)]
    text = tables([(f"row {k}", *(f"{k}" + digit * 29 for digit in "123")) for k in "456"])
    assert [text.count(found) for found in ("all", "\n─", "row 4")] == [1, 2, 2]  # two tables
    assert all(text.count(digit * 29) == 3 for digit in "123")
    text = tables([(f"row {k}", "1" * 30, f"{k}" * 30, "3" * 30) for k in "456"])  # above the table
    assert f"all rows: b {'1' * 30}, d {'3' * 30}\n" in text
    assert [text.count(found) for found in ("\n─", "row 4", "1" * 30, "4" * 30)] == [1] * 4


def test_columns_are_what_their_headings_say():
    row = dynamics_row(policy="p.npz", out_of_board=0.1, timeout=0.02)
    cells = {column.heading: column.text(row) for column in columns_of([row], ())}
    assert cells["out of board, timeout"] == "5, 1"
    brief = [column.text(row) for column in columns_of([row], (), brief=True)]
    assert brief[-2:] == ["123.4 cm", "123 s"]


@pytest.mark.parametrize("width", [60, 80, 200])
def test_policies_in_the_dynamics(width):
    row = dynamics_row(policy="p.npz", scenario="four-crossing", episodes=200, shield=False)
    text = printed(grid.EvaluationReport.show, grid.EvaluationReport(rows=(row,)), width=width)
    whole = ["four-crossing", "200 of 900", "98.8% [94.2, 100.0]", "1.2% [0.0, 5.8]", "collision"]
    whole += ["123.4 cm", "1.234 [1.111, 1.345]", "12.34 cm", "123 s", "456.7 J", "min distance"]
    assert [word for word in whole if word not in text] == []


def test_policies_on_the_grid():
    failure = Failure(starts=((1, 2), (3, 4)), outcome=Outcome.COLLISION)
    name = "runs/fig11/c1/run_003/policy.npz"
    row = grid_row(policy=name, failing_starts=1234, failures=(failure,) * 12)
    text = printed(grid.GridReport.show, grid.GridReport(rows=(row,), over_policies={"4": OVER}))
    assert text.count(f"{name}: collision from (1, 2) (3, 4)") == 10
    assert f"{name}: 1224 more failing starts" in text
    whole = ["scenario", "98.76%", "1.23%", "43.21", "39.87", "1.012", "1.034", "out of board"]
    assert [word for word in whole if word not in text] == []


def test_many_policies_on_the_grid_are_a_line_each():
    names = [f"runs/t4/run_{k:03d}/policy.npz" for k in range(12)]
    shares = [{end: share / (k + 1) for end, share in SHARES.items()} for k in range(12)]
    lengths = [{name: value - 0.01 * k for name, value in LENGTHS.items()} for k in range(12)]
    parts = zip(names, shares, lengths, strict=True)
    rows = tuple(grid_row(policy=name, **share | length) for name, share, length in parts)
    text = printed(grid.GridReport.show, grid.GridReport(rows=rows, over_policies={}))
    lines = re.findall(r"^runs/t4/run_\d{3} .*$", text, re.MULTILINE)
    assert len(lines) == len(names)
    assert all(len(line.split()) == 8 for line in lines)
    assert "all rows: scenario 4, starts 900" in text


def test_many_rows_of_a_study_are_a_line_each():
    rows = tuple(
        dynamics_row(policy=name, options={"mu": mu}, collision=mu, timeout=0.1, success=0.9 - mu)
        for name in ("greedy", "learnt", "moves")
        for mu in (0.1, 0.2)
    )
    text = printed(Report.show, Report(rows=rows, axes=("mu",)))
    assert text.count("\n─") == 1
    assert len(re.findall(r"^(?:greedy|learnt|moves) +0\.[12] ", text, re.MULTILINE)) == len(rows)
    assert "5 collision, 5 timeout" in " ".join(text.split())


def test_a_sample_of_the_starts_is_not_called_exact(near_policy, monkeypatch):
    """As of planned policies, which evaluate some of their starts only."""
    whole = grid.grid_row("whole", near_policy)
    assert (whole.starts, whole.success_low, whole.success_high) == (4, None, None)
    sample = near_policy.evaluate_on_grid(joint_starts(near_policy.process)[:2])
    monkeypatch.setattr(type(near_policy), "evaluate_on_grid", lambda _: sample)
    some = grid.grid_row("some", near_policy)
    assert (some.starts, some.success_low, some.success_high) == (2, *rate(2, 2)[1:])
    text = printed(grid.GridReport.show, grid.GridReport(rows=(whole, some), over_policies={}))
    assert "sample of 2: 34.24% to 100.00%" in text


def test_differences_are_those_of_the_runs_from_their_reference():
    def variant(reference, *successes):
        lengths = [{"success": s, "path_length_cm": 10.0 + 2.0 * s, "steps": s} for s in successes]
        runs = tuple(grid_row(**of) for of in lengths)
        return experiments.VariantResult("", "4", reference, runs, {})

    of = {"new": variant("old", 0.9, 0.8), "old": variant(None, 0.5, 0.2)}
    (found,) = experiments.differences(of).values()
    means = {measure: statistics.mean for measure, statistics in found.items()}
    assert means == pytest.approx({"success": 0.5, "path_length_cm": 1.0, "steps": 0.5})
    of = {"a": variant("b", 0.1, 0.9), "b": variant(None, 0.9, 0.7)}
    found = experiments.differences(of)["a"]
    assert (found["success"].low, found["success"].high) == (-1.0, 1.0)  # it is a share
    assert (found["steps"].low or 0.0) < -1.0


def test_experiments():
    variant = experiments.VariantResult("scenario 4, as the paper has it", "4", None, (), OVER)
    known = {"experiment": "fig11", "seed": 0, "episodes": 1, "seconds": 1.0, "out": "runs/x"}
    result = experiments.ExperimentResult(**known, variants={"4": variant}, differences={})
    text = printed(experiments.show, result)
    assert "98.76 %" in text
    assert "[90.00, 99.90]" in text
    assert "optimum" in text


def test_effects_of_a_factorial_are_means_over_the_combinations_that_share_a_level():
    variants, found = {}, {}
    for name, levels, success in (("a", "open cell", -0.2), ("b", "zone cell", 0.4)):
        variants[name] = experiments.VariantResult(f"{levels} c2", "4", None, (), {})
        of = Statistics(success, 0.9, None, None, runs=2)  # the interquartile mean is not asked
        found[name] = {"success": of, "path_length_cm": of, "steps": of}
    effects = experiments.effects(variants, found)
    assert set(effects) == {"all c2", "open c2", "zone c2", "cell c2"}
    assert effects["all c2"] == effects["cell c2"]
    assert effects["all c2"]["success"].mean == pytest.approx(0.1)
    assert effects["all c2"]["success"].runs == 2
    assert effects["zone c2"]["success"].mean == pytest.approx(0.4)


def test_paths_on_the_grid_are_in_centimetres_whatever_cells_measure(near_policy):
    config = near_policy.config
    board = replace(config.scenario, cell_m=0.02, robot_diameter_m=2.0 * config.scenario.diameter_m)
    wide = replace(near_policy, config=msgspec.structs.replace(config, scenario=board))
    usual, other = (grid.grid_row("", policy).path_length_cm for policy in (near_policy, wide))
    assert usual is not None
    assert other == pytest.approx(2.0 * usual)


def test_the_report_has_each_measure_under_its_heading():
    over = {
        name: Statistics(mean=value, iqm=value, low=None, high=None, runs=2)
        for name, value in {"success": 0.9, **LENGTHS}.items()
    }
    variant = experiments.VariantResult("as it is", "4", None, (), over)
    known = {"experiment": "fig11", "seed": 0, "episodes": 1, "seconds": 1.0, "out": "runs/x"}
    result = experiments.ExperimentResult(**known, variants={"4": variant}, differences={})
    table = learning_table("", result)
    row = dict(zip(table.header, table.rows[0], strict=True))
    expected = ("90.0 % [–]", "43.21 [–]", "39.87 [–]", "1.012 [–]")
    names = ("success", "path length, cm", "moves", "path over shortest")
    assert tuple(row[name] for name in names) == expected


def test_means_over_policies_are_printed_under_their_headings(capsys):
    over = {"2": {"success": STATISTICS, "steps": STATISTICS}}
    grid.GridReport(rows=(), over_policies=over).show()
    lines = capsys.readouterr().out.splitlines()
    (header,) = (line.split() for line in lines if line.startswith("scenario 2"))
    (row,) = (line.split() for line in lines if line.startswith("success  ") and "98.76%" in line)
    assert header[-5:] == ["mean", "IQM", "95", "%", "interval"]
    assert row == ["success", "98.76%", "98.00%", "90.00%", "to", "99.90%"]
