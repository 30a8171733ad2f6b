"""Tables on a terminal of 80 columns: every name and every number is whole."""

import contextlib
import io
from dataclasses import fields

import pytest

from agent.evaluation import grid as evaluate
from agent.evaluation.statistics import Statistics, rate
from agent.experiments import results as experiments
from agent.mdp.exact import joint_starts
from agent.study import evaluate as evaluation
from agent.study import transfer
from agent.training.policy import Policy
from cosim.base.table import show_texts
from cosim.model.outcome import Outcome
from cosim.model.world import IDEAL

SHARES = {
    "success": 0.9876,
    "collision": 0.0123,
    "out_of_board": 0.0001,
    "timeout": 0.0,
}
OUTCOMES = {
    **SHARES,
    **{f"{name}_low": max(0.0, share - 0.0456) for name, share in SHARES.items()},
    **{f"{name}_high": min(1.0, share + 0.0456) for name, share in SHARES.items()},
    "path_length_cm": 123.4,
    "rotation_deg": 345.0,
    "path_ratio_to_grid": 1.234,
    "path_ratio_to_grid_low": 1.111,
    "path_ratio_to_grid_high": 1.345,
    "min_distance_cm": 12.34,
    "sim_time_s": 123.0,
    "energy_j": 456.7,
    "mu": 0.15,
    "drive_speed_m_s": 0.0039,
    "starts": 900,
    "digest": "",
    "failing_starts": 0,
    "failures": (),
}
GRID = {
    **SHARES,
    "path_length_cm": 43.21,
    "steps": 39.87,
    "ratio_to_bound": 1.012,
    "steps_ratio_to_bound": 1.034,
}
STATISTICS = Statistics(mean=0.9876, iqm=0.98, low=0.9, high=0.999, runs=10)


def printed(show, content, width=80) -> str:
    """What is printed on a terminal; lines outside of tables may be longer than it is wide."""
    output = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(output):
        patch.setenv("COLUMNS", str(width))
        show(content)
    text = output.getvalue()
    assert max(len(line) for line in text.splitlines() if "│" in line) <= width
    assert "…" not in text
    return text


def test_one_table_if_there_is_room():
    text = printed(lambda rows: show_texts("ab", rows, title="both"), [("1", "2")], width=40)
    assert text.count("both") == 1
    assert text.count("┏") == 1


def test_further_tables_repeat_the_names():
    rows = [("first row", "1" * 30, "2" * 30, "3" * 30)]
    text = printed(lambda rows: show_texts(("name", "a", "b", "c"), rows, title="t"), rows)
    assert text.count("first row") == 2
    assert all(digit * 30 in text for digit in "123")


@pytest.mark.parametrize("width", [60, 80, 200])
def test_policies_in_co_simulation(width):
    row = evaluation.PolicyRow(
        policy="runs/fig11/c1/run_003/policy.npz",
        scenario="four-crossing",
        episodes=200,
        planned=200,
        shield=False,
        **OUTCOMES,
        wall_s=1.0,
        results="",
    )
    report = evaluation.EvaluationReport(
        seed=0, mu=0.15, shield=False, world=IDEAL, policies=(row,)
    )
    text = printed(evaluation.show, report, width=width)
    whole = ["four-crossing", "200 of 900", "98.8% [94.2, 100.0]", "1.2% [0.0, 5.8]", "collision"]
    whole += ["123.4 cm", "1.234 [1.111, 1.345]", "12.34 cm", "123 s", "456.7 J", "min distance"]
    assert [word for word in whole if word not in text] == []


def test_policies_on_the_grid():
    row = evaluate.PolicyReport(
        policy="runs/fig11/c1/run_003/policy.npz",
        scenario="4",
        starts=900,
        **GRID,
        failing_starts=11,
        failures=(evaluate.GridFailure(((1, 2), (3, 4)), Outcome.COLLISION),),
    )
    over = dict.fromkeys(GRID, STATISTICS)
    report = evaluate.GridReport(policies=(row,), over_policies={"4": over})
    text = printed(evaluate.show, report)
    assert f"{row.policy}: collision from (1, 2) (3, 4)" in text
    assert "1 more failing starts" in text
    whole = ["scenario", "98.76%", "1.23%", "43.21", "39.87", "1.012", "1.034", "out of board"]
    assert [word for word in whole if word not in text] == []


def test_a_sample_of_the_starts_is_not_called_exact(near_policy):
    """As of planned policies, which evaluate some of their starts only."""

    class Sampled(Policy):
        def evaluate(self, starts=None):
            return super().evaluate(joint_starts(self.process)[:2] if starts is None else starts)

    whole = evaluate.measure("whole", near_policy)
    assert (whole.starts, whole.success_low, whole.success_high) == (4, None, None)
    part = evaluate.measure("part", Sampled(**vars_of(near_policy)))
    assert (part.starts, part.success_low, part.success_high) == (2, *rate(2, 2)[1:])
    text = printed(evaluate.show, evaluate.GridReport(policies=(whole, part), over_policies={}))
    assert "sample of 2: 34.24% to 100.00%" in text


def vars_of(policy):
    return {field.name: getattr(policy, field.name) for field in fields(policy)}


def test_differences_are_those_of_the_variant_from_its_reference():
    def variant(*successes):
        runs = [evaluate.PolicyMeasures(policy="", scenario="4", starts=1, **GRID | {
            "success": s, "path_length_cm": 10.0 + 2.0 * s, "steps": 3.0 - s}, failing_starts=0)
            for s in successes]  # fmt: skip
        return experiments.VariantResult("", "4", tuple(runs), {})

    of = {"new": variant(0.9, 0.8), "old": variant(0.5, 0.2)}
    found = experiments.differences(of, {"new": "old"})["new"]
    means = {measure: statistics.mean for measure, statistics in found.items()}
    assert means == pytest.approx({"success": 0.5, "path_length_cm": 1.0, "steps": -0.5})


def test_experiments():
    over = dict.fromkeys(GRID, STATISTICS)
    variant = experiments.VariantResult("scenario 4, as the paper has it", "4", (), over)
    result = experiments.ExperimentResult(
        experiment="fig11",
        seed=0,
        episodes=1,
        seconds=1.0,
        out="runs/x",
        variants={"4": variant},
        differences={},
    )
    text = printed(experiments.show, result)
    assert "98.76 % [90.00, 99.90]" in text
    assert "path over optimum" in text


def test_effects_of_a_factorial_are_means_over_the_combinations_that_share_a_level():
    variants, found = {}, {}
    for name, levels, success in (("a", "open cell", -0.2), ("b", "zone cell", 0.4)):
        variants[name] = experiments.VariantResult(f"{levels} c2", "4", (), {})
        of = Statistics(success, success, None, None, runs=2)
        found[name] = {"success": of, "path_length_cm": of, "steps": of}
    effects = experiments.effects(variants, found)
    assert set(effects) == {"all c2", "open c2", "zone c2", "cell c2"}
    assert effects["all c2"] == effects["cell c2"]
    assert effects["all c2"]["success"].mean == pytest.approx(0.1)
    assert effects["all c2"]["success"].runs == 2
    assert effects["zone c2"]["success"].mean == pytest.approx(0.4)


def test_transfer_has_all_that_its_file_has():
    entry = transfer.TransferRow(
        scenario="4",
        method="moves",
        shield=True,
        episodes=50,
        planned=200,
        **OUTCOMES,
        wall_s=120.0,
    )
    report = transfer.TransferReport(
        seed=0,
        complete=False,
        episode_wall_s=120.0,
        simulated=50,
        goals=(),
        rows=(entry,),
    )
    text = printed(transfer.show, report)
    table, _, findings = transfer.markdown(report).partition("\n\n")
    cells = [c.strip() for line in table.splitlines() for c in line.strip("|").split("|")]
    assert [c for c in cells if c != "---" and c not in text] == []
    assert findings.split()[-2:] == text.split()[-2:]
