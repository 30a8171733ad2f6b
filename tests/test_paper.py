"""A sample of the statements in docs/paper.md, computed again.

Those that take minutes are marked slow.
"""

import json
import math
import re
import runpy
from pathlib import Path
from typing import Any

import pytest
from scipy.stats import binomtest

import minirobots as mr
from agent.evaluation.statistics import interval_text, rate
from agent.experiments.run import run_experiment
from agent.experiments.variants import ExperimentOptions, variants_of
from analysis.figures.learning import LEARNT
from analysis.figures.style import verdict, verdicts
from cosim.base.jobs import THREADS
from cosim.calibration.measuring import find_calibration
from cosim.machine.platform.motion import (
    FIG_3_PLATFORM,
    drift_speed,
    net_displacement,
    robot_platform,
    slip_speed,
)
from cosim.model.config import CoSimConfig
from cosim.model.params import FIG_3
from cosim.model.scenario_file import PAPER, find_scenario

ROOT = Path(__file__).parents[1]
PLAIN = runpy.run_path(str(ROOT / ".ci" / "pages.py"))["plain"]
PAGE = " ".join(PLAIN((ROOT / "docs" / "paper.md").read_text("utf-8")).split())
EPISODES = 5_000_000
RUNS = 20


def numbers(pattern: str) -> list[float]:
    """Return the numbers in the one place of the page that matches."""
    (found,) = re.findall(pattern, PAGE)
    return [float(n.replace("−", "-")) for n in ([found] if isinstance(found, str) else found)]


def test_platform():
    robot = robot_platform()
    assert [round(slip_speed(robot), 1)] == numbers(r"slip from ([\d.]+) rad/s")
    assert [round(drift_speed(robot), 1)] == numbers(r"net motion from ([\d.]+)")
    step_um = 1e6 * net_displacement(robot, 900.0)
    assert [round(step_um, 1)] == numbers(r"Table II gives ([\d.]+) µm at 900 rad/s")
    step_mm = 1e3 * net_displacement(FIG_3_PLATFORM, FIG_3.omega)
    assert [round(step_mm, 3)] == numbers(r"another platform gives ([\d.]+) mm")


def test_step_of_a_turn(motor_fmu):
    (step_um, speed_mm_s) = numbers(r", (\d+) µm a turn at ([\d.]+) mm/s")
    omega = find_calibration(CoSimConfig(), motor_fmu).motor_speed("forwards", 1e-3 * speed_mm_s)
    assert step_um == round(1e3 * speed_mm_s / (omega / math.tau))


def test_intervals_of_counts():
    low, high = binomtest(RUNS, RUNS).proportion_ci()
    assert PAGE.count(f"in 20 of 20 runs [{100.0 * low:.1f}, {100.0 * high:.0f}]") == 2
    assert f"{interval_text(rate(100, 100), 1, 100.0)} % of scenario 2" in PAGE


def test_verdicts_follow_from_the_published_numbers():
    fig_10, methods, sequel, said = (
        json.loads((ROOT / "docs" / "results" / f"{name}.json").read_text("utf-8"))
        for name in ("fig10", "methods", "sequel", "claims")
    )
    plain = {name: text.replace("*", "") for name, text in said.items()}
    lows = [
        fig_10[name].replace("−", "-").split("[")[1].split(",")[0] for name in ("c1", "c2", "c5")
    ]
    assert plain["fig-10"] == verdict(all(float(low) > 0.0 for low in lows))
    rates = {name: methods["paper"][name]["success"] for name in "234"}
    reached = {f"in {name}": rate.startswith("100.0 ") for name, rate in rates.items()}
    assert plain["fig-12"] == verdicts(reached)
    rates = [float(sequel[name].split()[0]) for name in ("4-ring", "4-cross")]
    assert plain["the-sequel"] == verdict(min(rates) >= 100.0 * LEARNT)


def test_targets_and_starts():
    listed = re.search(r"Targets are read from Fig. 5: (.*?)\. A centre", PAGE)
    assert listed is not None
    printed = {}
    for part in listed[1].split("; "):
        cells, _, names = part.rpartition(" in ")
        for name in names.split(" and "):
            printed[name] = tuple(
                (int(x), int(y)) for x, y in re.findall(r"\((\d+),(\d+)\)", cells)
            )
    boards = {name: find_scenario(name) for name in PAPER}
    assert {name: board.targets for name, board in boards.items()} == printed
    (starts,) = numbers(r"100 % of (\d+) starts in 20 of 20 runs")
    assert {math.prod(map(len, boards[name].starts)) for name in "234"} == {starts}


def test_interpretations_of_fig_10():
    found = variants_of("factorial").values()
    coefficients = {variant.process.approach_coefficient for variant in found}
    (count,) = numbers(r"under no interpretation of (\d+)")
    assert len(found) / len(coefficients) == count


@pytest.mark.slow
def test_learning(tmp_path):
    """All runs of Fig. 8; and some of Fig. 10, within what its intervals predict for them."""
    how: Any = {"out": tmp_path, "episodes": EPISODES, "where": THREADS}
    found = run_experiment(ExperimentOptions(experiment="fig08", runs=RUNS, **how))
    for variant in found.variants.values():
        assert all(run.success == 1.0 for run in variant.runs)
        assert interval_text(variant.over_runs["ratio_to_bound"], 3) in PAGE
    assert interval_text(found.variants["1b"].over_runs["steps"]) in PAGE
    some = 2
    found = run_experiment(ExperimentOptions(experiment="fig10", runs=some, **how))
    pattern = r"([−\d.]+) \[([−\d.]+), ([−\d.]+)\]"
    printed = numbers(f"differ by {pattern}, {pattern} and {pattern} cm")
    for k, measures in enumerate(found.differences.values()):
        mean, low, high = printed[3 * k : 3 * k + 3]
        assert low < 0.0 < high  # not confirmed
        half = 0.5 * (high - low) * math.sqrt(1.0 + RUNS / some)
        assert measures["path_length_cm"].mean == pytest.approx(mean, abs=half)


@pytest.mark.slow
def test_driving():
    """The policies of Fig. 9 and 12 without a shield: from all starts of 1a, and 50 of 2."""
    reached, starts = numbers(r"(\d+) of (\d+) starts of 1a")
    percent, pairs = numbers(r"in (\d+) \[[^]]*\] % of (\d+) episodes of scenario 2")
    for scenario, share, some in (("1a", reached / starts, starts), ("2", percent / 100.0, pairs)):
        row = mr.evaluate("paper", scenario, starts=int(some), progress=None)
        assert row.episodes - row.failing_starts == share * some
