"""Energy that a coupling adds, against that which the states of the coupled masses tell."""

import math

import numpy as np
import pytest

from cosim.base.errors import UserError
from cosim.fmi.fmu import FmuError
from cosim.system.graph import Component, Connection
from cosim.system.system import System
from tests.references.two_masses import (
    BOND,
    BONDED,
    RESIDUAL,
    STATES,
    bonded_masses,
    error,
    stored,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bonded")


def run_bonded(components, step_s, algorithm, links=BONDED, **options):
    """Return a run of the bonded masses over 1 s, and its system, closed."""
    options |= {"step_s": step_s, "algorithm": algorithm, "power_bonds": [BOND]}
    with System(components, links, record=STATES, **options) as system:
        return system.run(1.0), system


@pytest.mark.parametrize(
    ("algorithm", "gear", "order", "share"),
    [
        ("jacobi", 1.0, 1.0, 1e-3), ("jacobi", -1.0, 1.0, 1e-3), ("jacobi", 2.0, 1.0, 1e-3),
        ("gauss-seidel", 1.0, 1.0, 3e-3), ("gauss-seidel", -1.0, 1.0, 3e-3),
        ("extrapolated", 1.0, 2.0, 0.03), ("implicit", 1.0, 2.0, 0.4),
    ],
)  # fmt: skip
def test_residual_is_the_energy_that_the_coupling_adds(folder, algorithm, gear, order, share):
    links = [link._replace(factor=gear) for link in BONDED]
    components, largest = bonded_masses(folder), []
    for step_s in (2e-3, 1e-3):
        run, _ = run_bonded(components, step_s, algorithm, links)
        added = stored(run) - stored(run)[0]
        largest.append(np.abs(run.signals[RESIDUAL]).max())
        assert np.abs(run.signals[RESIDUAL] - added).max() < share * np.abs(added).max()
    assert math.log2(largest[0] / largest[1]) == pytest.approx(order, abs=0.3)


@pytest.mark.parametrize("algorithm", ["jacobi", "extrapolated", "implicit"])
def test_bonds_change_no_bit(folder, algorithm):
    components = bonded_masses(folder)
    run, _ = run_bonded(components, 1e-3, algorithm)
    with System(components, BONDED, record=STATES, step_s=1e-3, algorithm=algorithm) as system:
        expected = system.run(1.0)
    for name, values in expected.signals.items():
        assert (run.signals[name] == values).all()


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "extrapolated"])
def test_steps_follow_the_residual_power_without_being_taken_back(folder, algorithm):
    components, found = bonded_masses(folder, able=False), []
    for tolerance in (3e-2, 3e-3):
        options = {"tolerance": tolerance, "step_control": "energy", "longest_step_s": 0.01}
        run, system = run_bonded(components, 1e-5, algorithm, **options)
        found.append((error(run), np.abs(stored(run) - stored(run)[0]).max(), system.steps))
        assert system.rejected == 0
        assert run.profile["first"].steps == system.steps
        assert run.time_s[-1] == pytest.approx(1.0)
        assert np.ptp(np.diff(run.time_s)) > 1e-4
    assert found[1][0] < 0.6 * found[0][0]
    assert found[1][1] < 0.6 * found[0][1]
    assert found[0][2] < found[1][2] < 1e5


def test_taken_back_steps_take_their_energy_back(folder):
    run, system = run_bonded(bonded_masses(folder), 1e-6, "extrapolated", tolerance=1e-4)
    added = stored(run) - stored(run)[0]
    assert system.rejected > 0
    assert np.abs(run.signals[RESIDUAL] - added).max() < 0.3 * np.abs(added).max()


@pytest.mark.parametrize(
    ("links", "options", "words"),
    [
        (BONDED, {"power_bonds": [("first.F_in", "second.x_in")]}, "name the inputs of effort"),
        (BONDED, {"power_bonds": [("first.F_in",)]}, "power bond first.F_in: name the inputs"),
        (
            [BONDED[0], BONDED[1]._replace(offset=1.0)],
            {"power_bonds": [BOND]},
            "power bond first.F_in=second.v_in: name the",
        ),
        (
            [*BONDED, Connection("first.F", "third.F_in")],
            {"power_bonds": [("first.F_in", "third.F_in")]},
            "back and forth between two components",
        ),
        (
            BONDED,
            {"step_control": "energy", "tolerance": 1e-3},
            "needs power bonds and a tolerance",
        ),
        (BONDED, {"step_control": "energy", "power_bonds": [BOND]}, "needs power bonds and"),
        (
            BONDED,
            {"power_bonds": [BOND], "component_steps": {"first": 0.01}},
            "leave the tolerance and power bonds out",
        ),
    ],
)
def test_bonds_that_are_none_are_named(folder, links, options, words):
    first, second = bonded_masses(folder)
    components = [first, second, Component("third", first.fmu)]
    with pytest.raises(UserError) as caught:
        System(components, links, **options)
    assert words in str(caught.value)


def test_energy_needs_steps_that_vary(small):
    fmu = small("oscillator", able=False)
    components = [Component("first", fmu), Component("second", fmu)]
    options = {"tolerance": 1e-3, "step_control": "energy", "power_bonds": [BOND]}
    with pytest.raises(FmuError, match=r"cannot vary its step .*, which a tolerance needs"):
        System(components, BONDED, **options)
