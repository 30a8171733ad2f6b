"""Declared dependencies compared with what really changes, for both standards."""

from collections.abc import Callable, Iterator
from typing import Any

import fmpy
import numpy as np

from tests.fmus.starts import motor_starts

STATES = ("theta", "omega", "integral")
INPUTS = ("omega_des", "d", "omega_noise", "V_in")
CHANGES = {"theta_start": 0.25, "omega_start": 2.0,
           "omega_des": 2.0, "d": 1e-5, "omega_noise": 2.0, "V_in": 0.5}  # fmt: skip

STARTS = motor_starts()
TYPES = {"closed_loop": bool, "solver": int}

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
        named = dict(zip((*STATES, *INPUTS), values.tolist(), strict=True))
        yield rest | named | {"closed_loop": closed_loop}


def simulate(motor, at: Values) -> None:
    """Bring an instance to a point of the simulation."""
    motor.start(closed_loop=at["closed_loop"] > 0, **{name: at[name] for name in INPUTS})
    motor.place(**{name: at[name] for name in STATES})
    assert motor.set(**{name: at[name] for name in INPUTS}) == 0


def initialise(motor, at: Values) -> None:
    """Bring an instance to Initialization Mode with these start values."""
    assert motor.set(**{name: TYPES.get(name, float)(value) for name, value in at.items()}) == 0
    assert motor.enter_initialization() == 0


def observe(
    read: Callable[[Values], np.ndarray], at: Values, changes: Values
) -> dict[str, np.ndarray]:
    """Change of all unknowns over that of each known, one known after the other."""
    before = read(at)
    return {name: (read(at | {name: value}) - before) / (value - at[name])
            for name, value in changes.items()}  # fmt: skip


def compare(declared: list, unknowns: list[str], factors: dict[str, list[np.ndarray]]) -> None:
    """Assert that what changed is what is declared."""
    promised = {
        (unknown.variable.name, known.name)
        for unknown in declared
        for known in unknown.dependencies
    }
    seen = {
        (unknown, known)
        for known, rows in factors.items()
        for unknown, column in zip(unknowns, np.array(rows).T, strict=True)
        if np.any(column)
    }
    assert seen == promised


def test_dependencies_in_the_simulation(fmus, instance, fmi):
    declared: Any = fmpy.read_model_description(str(fmus[fmi])).outputs
    unknowns = [unknown.variable.name for unknown in declared]

    def read(at: Values) -> np.ndarray:
        motor = instance(fmi)
        simulate(motor, at)
        return np.array(motor.get(*unknowns))

    factors: dict[str, list[np.ndarray]] = {name: [] for name in INPUTS}
    for at in points():
        changes = {name: at[name] + CHANGES[name] for name in factors}
        for name, found in observe(read, at, changes).items():
            factors[name].append(found)
    compare(declared, unknowns, factors)


def test_dependencies_at_the_start(fmus, instance, fmi):
    declared: Any = fmpy.read_model_description(str(fmus[fmi])).initialUnknowns
    unknowns = [unknown.variable.name for unknown in declared]

    def read(at: Values) -> np.ndarray:
        motor = instance(fmi)
        initialise(motor, at)
        return np.array(motor.get(*unknowns))

    factors: dict[str, list[np.ndarray]] = {name: [] for name in STARTS}
    for point in points():
        at = STARTS | {name: point[name] for name in (*INPUTS, "closed_loop")}
        at |= {"theta_start": point["theta"], "omega_start": point["omega"]}
        changes = {name: value + CHANGES.get(name, 0.1 * value) for name, value in at.items()}
        changes |= {"closed_loop": 1.0 - at["closed_loop"], "solver": 3.0 - at["solver"]}
        for name, found in observe(read, at, changes).items():
            factors[name].append(found)
    compare(declared, unknowns, factors)
