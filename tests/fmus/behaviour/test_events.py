"""Communication steps, sticking, saturation and the solvers: one motion, however it is computed."""

import numpy as np
import pytest

from cosim.model.params import TABLE_II

OUTPUTS = ("theta", "omega", "omega_dot", "V_s", "i")
# One internal step of 1e-5 s at the largest acceleration that occurs (about 40 000 rad/s²).
ONE_STEP = 0.4
SOLVERS = pytest.mark.parametrize("solver", [1, 2])


@SOLVERS
@pytest.mark.parametrize(
    "start", [{"omega_des": 700.0}, {"closed_loop": False, "omega_start": 60.0, "V_in": -0.5}]
)
def test_result_does_not_depend_on_the_communication_step(rig, solver, start):
    runs = [rig(solver=solver, **start).run(0.2, step_s)[1] for step_s in (1e-5, 1e-4, 1e-3)]
    for name in OUTPUTS:
        assert (runs[0][name][::100] == runs[2][name]).all()
        assert (runs[1][name][::10] == runs[2][name]).all()


@SOLVERS
def test_sticking_breaking_away_and_reversing(rig, solver):
    motor = rig(closed_loop=False, solver=solver)
    held, driven, back = 0.35, 1.0, -1.0
    assert not motor.run(0.05)[1]["omega"].any()
    motor.set(V_in=held)
    assert not motor.run(0.05)[1]["omega"].any()
    motor.set(V_in=driven)
    assert motor.run(0.3)[1]["omega"][-1] > 300.0
    motor.set(V_in=back)
    speeds = motor.run(0.6)[1]["omega"]
    assert speeds[-1] < -300.0
    motor.set(V_in=held)
    speeds = motor.run(0.6)[1]["omega"]
    assert speeds[-1] == 0.0
    assert (np.diff(np.flatnonzero(speeds == 0.0)) == 1).all()  # once at rest, it stays


@SOLVERS
def test_disturbance_alone_moves_the_shaft_only_beyond_the_friction(rig, solver):
    ratios = (1.0, -1.0, -2.0)
    held, held_back, turning = (
        rig(closed_loop=False, d=ratio * TABLE_II.c, solver=solver).run(0.05)[1]["omega"]
        for ratio in ratios
    )
    assert not held.any() and not held_back.any()
    assert (turning[1:] < 0.0).all()


CASES = {
    "start to 700 rad/s through saturation": (0.5, {"omega_des": 700.0}),
    "coasting to rest": (0.2, {"closed_loop": False, "omega_start": 100.0}),
    "held below breakaway": (0.2, {"closed_loop": False, "V_in": 0.38}),
    "creeping up and held again": (0.5, {"closed_loop": False, "V_in": 0.42}),
    "reversing": (0.5, {"closed_loop": False, "omega_start": 200.0, "V_in": -1.0}),
    "out of reach: sliding along the limit": (2.0, {"omega_des": 5900.0}),
}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_both_solvers_agree_through_every_event(rig, case):
    duration_s, start = CASES[case]
    names = ("omega", "V_s", "integral")
    euler, rk4 = (rig(solver=k, **start).run(duration_s, names=names)[1] for k in (1, 2))
    assert rk4["omega"] == pytest.approx(euler["omega"], abs=ONE_STEP)
    assert rk4["V_s"] == pytest.approx(euler["V_s"], abs=TABLE_II.K_p * ONE_STEP)
    if case in {"coasting to rest", "held below breakaway", "creeping up and held again"}:
        assert rk4["omega"][-1] == 0.0


def end_state(rig, solver: int, step_s: float, **start) -> np.ndarray:
    motor = rig(solver=solver, step_size=step_s, **start)
    assert motor.do_step(0.0, 0.064) == 0
    return np.array(motor.get("theta", "omega"))


@pytest.mark.parametrize(
    "start",
    [
        # Turning steadily in one direction and within the limits: no event, no kink.
        {"closed_loop": False, "omega_start": 300.0, "V_in": 0.9},
        {"omega_start": 650.0, "omega_des": 700.0},
    ],
    ids=["open loop", "closed loop"],
)
@pytest.mark.parametrize(("solver", "order"), [(1, 1.0), (2, 4.0)])
def test_order_of_convergence(rig, solver, order, start):
    reference = end_state(rig, 2, 1e-5, **start)
    ends = [end_state(rig, solver, step_s, **start) for step_s in (4e-4, 2e-4, 1e-4)]
    errors = np.abs(ends - reference)
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(order, abs=0.5)


def test_rk4_keeps_its_accuracy_through_standstill(rig):
    # Stopped and reversed: located within the step, the event costs no order.
    start = {"closed_loop": False, "omega_start": 50.0, "V_in": -1.5}
    reference = end_state(rig, 2, 1e-6, **start)
    coarse, fine = (np.abs(end_state(rig, 2, h, **start) - reference).max() for h in (8e-4, 4e-4))
    assert fine < 1e-5
    assert np.log2(coarse / fine) > 3.0
