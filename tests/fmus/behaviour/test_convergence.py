"""Order of convergence of the internal solvers, measured on the smooth part of the motion."""

import numpy as np
import pytest

REFERENCE_STEP_S = 1e-6


def end_state(rig, solver: int, step_s: float, **start) -> np.ndarray:
    motor = rig(solver=solver, step_size=step_s, **start)
    motor.fmu.doStep(0.0, 0.064)
    return np.array(motor.get("theta", "omega"))


# Turning steadily in one direction and within the limits: no event, no kink.
SMOOTH = {
    "open loop": {"closed_loop": False, "omega_start": 300.0, "V_in": 0.9},
    "closed loop": {"omega_start": 650.0, "omega_des": 700.0},
}


@pytest.mark.parametrize("start", SMOOTH.values(), ids=SMOOTH)
@pytest.mark.parametrize(("solver", "order"), [(1, 1.0), (2, 4.0)])
def test_order_of_convergence(rig, solver, order, start):
    reference = end_state(rig, 2, REFERENCE_STEP_S * 10, **start)
    steps_s = (4e-4, 2e-4, 1e-4)
    errors = np.array(
        [np.abs(end_state(rig, solver, step_s, **start) - reference) for step_s in steps_s]
    )
    slopes = np.log2(errors[:-1] / errors[1:])
    assert slopes == pytest.approx(order, abs=0.5)


def test_rk4_keeps_its_accuracy_through_standstill(rig):
    # Stopped and reversed: located within the step, the event costs no order.
    start = {"closed_loop": False, "omega_start": 50.0, "V_in": -1.5}
    reference = end_state(rig, 2, REFERENCE_STEP_S, **start)
    coarse, fine = (np.abs(end_state(rig, 2, h, **start) - reference).max() for h in (8e-4, 4e-4))
    assert fine < 1e-5
    assert np.log2(coarse / fine) > 3.0
