"""Declared dependencies against what really changes, for both standards and both interfaces."""

import ctypes
from collections.abc import Callable, Iterator
from typing import Any

import fmpy
import numpy as np
import pytest

from fmus.variables import load_table

STATES = ("theta", "omega", "integral")
INPUTS = ("omega_des", "d", "omega_noise", "V_in")
CHANGES = {"theta": 0.25, "omega": 2.0, "integral": 0.5, "theta_start": 0.25, "omega_start": 2.0,
           "omega_des": 2.0, "d": 1e-5, "omega_noise": 2.0, "V_in": 0.5}  # fmt: skip
# A load that nothing speeds up: in one step of it the integral becomes what a test wants. Steps
# and states are multiples of powers of two, so that this is exact.
HEAVY_J, STEP_S, GRID = 1e30, 2.0**-7, 2.0**10

STARTS = {v.name: v.start for v in load_table().variables if v.start is not None}

Values = dict[str, float]


def points() -> Iterator[Values]:
    """States, inputs and the loop: sticking, at and beyond the voltage limit, and any others."""
    rest = dict.fromkeys((*STATES, *INPUTS, "closed_loop"), 0.0)
    yield rest | {"V_in": 0.125}
    yield rest | {"V_in": 3.5, "omega": 300.0}
    # K_p e close to V_s_max on either side: the least that is added to the command matters.
    for error in (199.5, 200.5):
        yield rest | {"closed_loop": 1.0, "omega": 500.0, "omega_des": 500.0 + error}
    generator = np.random.default_rng(0)
    for closed_loop in (1.0, 0.0, 1.0, 1.0):
        scales = (3.0, 300.0, 0.9, 300.0, 1e-6, 20.0, 2.0)
        values = generator.uniform(-1.0, 1.0, len(scales)) * scales
        values[:3] = np.round(values[:3] * GRID) / GRID
        named = dict(zip((*STATES, *INPUTS), values.tolist(), strict=True))
        yield rest | named | {"closed_loop": closed_loop}


def exchange(motor, at: Values) -> None:
    """Bring a Model Exchange instance to a point of the simulation."""
    motor.start(theta_start=at["theta"], omega_start=at["omega"], closed_loop=at["closed_loop"] > 0)
    assert motor.call("EnterContinuousTimeMode") == 0
    states = (ctypes.c_double * 3)(*(at[name] for name in STATES))
    assert motor.call("SetContinuousStates", states, ctypes.c_size_t(3)) == 0
    assert motor.set(**{name: at[name] for name in INPUTS}) == 0
    assert motor.call("EnterEventMode") == 0
    motor.update_discrete_states()


def cosimulate(motor, at: Values) -> None:
    """Bring a co-simulation instance to a point; in open loop the integral stays 0."""
    theta, omega, error = at["theta"] - at["omega"] * STEP_S, at["omega"], at["integral"] / STEP_S
    motor.start(theta_start=theta, omega_start=omega, closed_loop=at["closed_loop"] > 0,
                omega_des=omega + error, J=HEAVY_J, step_size=STEP_S)  # fmt: skip
    assert motor.do_step(0.0, STEP_S) == 0
    assert motor.set(**{name: at[name] for name in INPUTS}) == 0
    reached = [at["theta"], at["omega"], at["integral"] * at["closed_loop"]]
    assert motor.get(*STATES) == reached


def initialise(motor, at: Values) -> None:
    """Bring an instance to Initialization Mode with these start values."""
    assert motor.set(**{name: type(STARTS[name])(value) for name, value in at.items()}) == 0
    assert motor.enter_initialization() == 0


def observe(
    read: Callable[[Values], np.ndarray], at: Values, changes: Values
) -> dict[str, np.ndarray]:
    """Change of all unknowns over that of each known, one known after the other."""
    before = read(at)
    return {name: (read(at | {name: value}) - before) / (value - at[name])
            for name, value in changes.items()}  # fmt: skip


def compare(declared: list, unknowns: list[str], factors: dict[str, list[np.ndarray]]) -> None:
    """Assert that what changed is what is declared, and that constant factors are constant."""
    promised = {
        (unknown.variable.name, known.name): kind
        for unknown in declared
        for known, kind in zip(unknown.dependencies, unknown.dependenciesKind, strict=True)
    }
    seen = {
        (unknown, known): column
        for known, rows in factors.items()
        for unknown, column in zip(unknowns, np.array(rows).T, strict=True)
        if np.any(column)
    }
    assert seen.keys() == promised.keys()
    for pair, column in seen.items():
        constant = bool(column == pytest.approx(column[0], rel=1e-9, abs=0.0))
        assert constant == (promised[pair] == "constant"), (pair, column)


def test_dependencies_in_the_simulation(fmus, instance, fmi):
    description: Any = fmpy.read_model_description(str(fmus[fmi]))
    declared = [*description.outputs, *description.derivatives, *description.eventIndicators]
    unknowns = sorted({unknown.variable.name for unknown in declared})
    factors: dict[str, list[np.ndarray]] = {name: [] for name in (*STATES, *INPUTS)}
    for arrive in (exchange, cosimulate):

        def read(at: Values, arrive: Callable = arrive) -> np.ndarray:
            motor = instance(fmi, arrive is exchange)
            arrive(motor, at)
            return np.array(motor.get(*unknowns))

        for at in points():
            changes = {name: at[name] + CHANGES[name] for name in factors}
            if arrive is cosimulate and not at["closed_loop"]:
                del changes["integral"]
            for name, found in observe(read, at, changes).items():
                factors[name].append(found)
    compare(declared, unknowns, factors)


@pytest.mark.parametrize("model_exchange", [True, False])
def test_dependencies_at_the_start(fmus, instance, fmi, model_exchange):
    declared: Any = fmpy.read_model_description(str(fmus[fmi])).initialUnknowns
    unknowns = [unknown.variable.name for unknown in declared]
    starts = {name: float(start) for name, start in STARTS.items()}

    def read(at: Values) -> np.ndarray:
        motor = instance(fmi, model_exchange)
        initialise(motor, at)
        return np.array(motor.get(*unknowns))

    factors: dict[str, list[np.ndarray]] = {name: [] for name in starts}
    for point in points():
        at = starts | {name: point[name] for name in (*INPUTS, "closed_loop")}
        at |= {"theta_start": point["theta"], "omega_start": point["omega"]}
        changes = {name: value + CHANGES.get(name, 0.1 * value) for name, value in at.items()}
        changes |= {"closed_loop": 1.0 - at["closed_loop"], "solver": 3.0 - at["solver"]}
        for name, found in observe(read, at, changes).items():
            factors[name].append(found)
    compare(declared, unknowns, factors)
