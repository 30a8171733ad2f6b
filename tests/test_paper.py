"""A sample of the numbers in docs/paper.md, computed again.

The quick ones are always compared; those that take minutes are marked slow.
"""

import math
import re
import runpy
from pathlib import Path

import pytest

from agent.evaluation.statistics import interval_text
from agent.experiments.run import run_experiment
from cosim.base.jobs import THREADS
from cosim.machine.platform.motion import (
    FIG_3_PLATFORM,
    drift_speed,
    net_displacement,
    robot_platform,
    slip_speed,
)
from cosim.model.params import FIG_3

ROOT = Path(__file__).parents[1]
NUMBERS = runpy.run_path(str(ROOT / ".ci" / "numbers.py"))
PAGE = " ".join((ROOT / "docs" / "paper.md").read_text("utf-8").split())
PAGE = NUMBERS["on_page_markdown"](PAGE)
EPISODES = 5_000_000


def number(pattern: str) -> float:
    (found,) = re.findall(pattern, PAGE)
    return float(found.replace("−", "-"))


def test_platform():
    robot = robot_platform()
    assert round(slip_speed(robot), 1) == number(r"slip from ([\d.]+) rad/s")
    assert round(drift_speed(robot), 1) == number(r"net motion from ([\d.]+)")
    step_um = 1e6 * net_displacement(robot, 900.0)
    assert round(step_um, 1) == number(r"Table II gives ([\d.]+) µm at 900 rad/s")
    step_mm = 1e3 * net_displacement(FIG_3_PLATFORM, FIG_3.omega)
    assert round(step_mm, 3) == number(r"another platform gives ([\d.]+) mm")
    assert number(r", (\d+) µm a turn") == round(3900.0 / (992.1 / math.tau))


@pytest.mark.slow
def test_single_robots(tmp_path):
    found = run_experiment("fig08", tmp_path, runs=20, episodes=EPISODES, seed=0, where=THREADS)
    for variant in found.variants.values():
        assert all(run.success == 1.0 for run in variant.runs)
        assert interval_text(variant.over_runs["ratio_to_bound"], 3) in PAGE
    assert interval_text(found.variants["1b"].over_runs["steps"]) in PAGE


@pytest.mark.slow
def test_the_coefficient_c(tmp_path):
    found = run_experiment("fig10", tmp_path, runs=20, episodes=EPISODES, seed=0, where=THREADS)
    for difference in found.differences.values():
        statistics = difference["path_length_cm"]
        assert interval_text(statistics) in PAGE
        assert statistics.low is not None and statistics.high is not None
        assert statistics.low < 0.0 < statistics.high  # not confirmed
