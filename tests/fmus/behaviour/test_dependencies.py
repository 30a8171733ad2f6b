"""Declared dependencies compared with what really changes, for both standards."""

from collections.abc import Iterator
from typing import Any

import fmpy
import numpy as np
import pytest

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


def changes_at(point: Values, start: bool) -> tuple[Values, Values]:
    """What is known at a point, and another value of each."""
    if not start:
        return point, {name: point[name] + CHANGES[name] for name in INPUTS}
    at = STARTS | {name: point[name] for name in (*INPUTS, "closed_loop")}
    at |= {"theta_start": point["theta"], "omega_start": point["omega"]}
    changes = {name: value + CHANGES.get(name, 0.1 * value) for name, value in at.items()}
    return at, changes | {"closed_loop": 1.0 - at["closed_loop"], "solver": 3.0 - at["solver"]}


@pytest.mark.parametrize("start", [False, True], ids=["in the simulation", "at the start"])
def test_what_changes_is_what_is_declared(fmus, instance, fmi, start):
    description: Any = fmpy.read_model_description(str(fmus[fmi]))
    declared = description.initialUnknowns if start else description.outputs
    unknowns = [unknown.variable.name for unknown in declared]

    def read(at: Values) -> np.ndarray:
        motor = instance(fmi)
        (initialise if start else simulate)(motor, at)
        return np.array(motor.get(*unknowns))

    seen = set()
    for point in points():
        at, changes = changes_at(point, start)
        before = read(at)
        for known, value in changes.items():
            changed = read(at | {known: value}) != before
            seen |= {(unknowns[k], known) for k in np.flatnonzero(changed).tolist()}
    promised = {(u.variable.name, known.name) for u in declared for known in u.dependencies}
    assert seen == promised
