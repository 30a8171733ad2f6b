"""The benchmark of an exchange: it runs, compares equal work, and the driver is as fast as said."""

import json

import pytest

from benchmarks import __main__ as benchmarks
from tests.alone import python


def test_all_drivers_give_the_same_bits_and_are_timed(command):
    done = command(benchmarks, "fmu-step", "--json", "--rounds", 1)
    assert done.returncode == 0
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["ratio_compiled_to_inlined"] == result["ns_compiled"] / result["ns_inlined"]
    assert result["ratio_fmpy_to_compiled"] == result["ns_fmpy"] / result["ns_compiled"]


@pytest.mark.slow
def test_the_calls_cost_little_more_than_inlined_equations_and_far_less_than_python():
    done = python("-m", "benchmarks", "fmu-step", "--json", check=True)
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["ratio_compiled_to_inlined"] <= 2.2
    assert result["ratio_fmpy_to_compiled"] >= 80.0
