"""The benchmark of an exchange: it runs, compares equal work, and the driver is as fast as said."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "fmu_step.py"
KEYS = {
    "ns_fmpy",
    "ns_compiled",
    "ns_inlined",
    "ratio_fmpy_to_compiled",
    "ratio_compiled_to_inlined",
}


def run(*options: str) -> dict[str, float]:
    command = [sys.executable, str(BENCHMARK), "--json", *options]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return json.loads(output.splitlines()[-1])


def test_compiled_driver_is_far_faster_than_python():
    result = run("--rounds", "20")
    assert result.keys() == KEYS
    assert result["ratio_fmpy_to_compiled"] >= 80.0


@pytest.mark.slow
def test_the_calls_cost_little_more_than_inlined_equations():
    assert run()["ratio_compiled_to_inlined"] <= 2.2
