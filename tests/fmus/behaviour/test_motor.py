"""Fig. 7, sticking and anti-windup, on the FMU itself."""

from typing import Any, cast

import control
import numpy as np
import pytest

from cosim.model.params import FIG_7, TABLE_II, motor_gain, motor_time_constant

BREAKAWAY_V = TABLE_II.c * TABLE_II.R / TABLE_II.K_T  # overcomes Coulomb friction at θ = 0
TAU_S = motor_time_constant(TABLE_II)
# Speed that a disturbance torque shifts the open loop by: d R / (bR + K_T²), in rad/s.
OFFSET = FIG_7.d * motor_gain(TABLE_II) * TABLE_II.R / TABLE_II.K_T
OUTPUTS = ("theta", "omega", "omega_dot", "V_s", "i")


def test_closed_forms_are_the_published_ones():
    assert pytest.approx(0.174, abs=5e-4) == TAU_S
    assert pytest.approx(65.0, abs=0.5) == OFFSET
    assert pytest.approx(0.39, abs=0.005) == BREAKAWAY_V


def test_open_loop_rises_with_the_motor_time_constant(rig):
    time_s, y = rig(closed_loop=False, V_in=FIG_7.open_loop_V).run(2.0)
    remaining = y["omega"][-200:].mean() - y["omega"]
    # Above 300 rad/s the ripple of the turning mass is small beside the rise.
    window = (y["omega"] > 300.0) & (remaining > 20.0)
    slope = np.polyfit(time_s[window], np.log(remaining[window]), 1)[0]
    assert -1.0 / slope == pytest.approx(TAU_S, rel=0.02)
    reached = time_s[np.argmax(y["omega"] > 0.632 * FIG_7.omega_des)]
    assert reached == pytest.approx(TAU_S, rel=0.05)


def test_open_loop_settles_off_by_the_disturbance(rig):
    start = {"closed_loop": False, "V_in": FIG_7.open_loop_V}
    final = {
        d: rig(**start, d=d).run(2.0)[1]["omega"][-200:].mean() for d in (0.0, FIG_7.d, -FIG_7.d)
    }
    assert final[0.0] == pytest.approx(FIG_7.omega_des, abs=1.0)
    assert final[FIG_7.d] - final[0.0] == pytest.approx(OFFSET, rel=0.01)
    assert final[0.0] - final[-FIG_7.d] == pytest.approx(OFFSET, rel=0.01)
    assert final[FIG_7.d] == pytest.approx(764.0, abs=2.0)
    assert final[-FIG_7.d] == pytest.approx(633.0, abs=2.0)


def exact_start() -> tuple[float, float, float]:
    """End of the saturation and times to 90 and 98 % without weight, from python-control.

    The shaft turns one way, so Coulomb friction takes a constant part of the voltage. At the limit
    the integral holds, until K_p e is below it; then the loop is linear.
    """
    gain, lost = motor_gain(TABLE_II), BREAKAWAY_V
    highest = gain * (TABLE_II.V_s_max - lost)
    leaves = FIG_7.omega_des - TABLE_II.V_s_max / TABLE_II.K_p
    saturated_s = -TAU_S * np.log(1.0 - leaves / highest)
    loop = control.ss(  # of ω and ∫e, driven by 1
        [[-(1.0 + gain * TABLE_II.K_p) / TAU_S, gain * TABLE_II.K_i / TAU_S], [-1.0, 0.0]],
        [[gain * (TABLE_II.K_p * FIG_7.omega_des - lost) / TAU_S], [FIG_7.omega_des]],
        [[1.0, 0.0]], 0.0,
    )  # fmt: skip
    time_s = np.arange(0.0, 2.0, 1e-4)
    omega = control.step_response(loop, time_s, initial_state=cast(Any, [leaves, 0.0])).outputs
    to_90, to_98 = (time_s[np.argmax(omega >= s * FIG_7.omega_des)] for s in (0.9, 0.98))
    return saturated_s, saturated_s + to_90, saturated_s + to_98


def test_closed_loop_starts_as_control_theory_says(rig):
    expected = exact_start()
    time_s, y = rig(omega_des=FIG_7.omega_des, m=0.0).run(2.0)
    to_90, to_98 = (time_s[np.argmax(y["omega"] >= s * FIG_7.omega_des)] for s in (0.9, 0.98))
    saturated_s = time_s[y["V_s"] == TABLE_II.V_s_max].max()
    found = saturated_s, to_90, to_98
    # A sample is 1 ms: the saturation ends within it, a level is crossed within the one before.
    assert np.abs(np.subtract(found, expected)).max() < 1.2e-3


@pytest.mark.parametrize("d", [0.0, FIG_7.d, -FIG_7.d])
def test_closed_loop_recovers_the_set_point_within_the_voltage(rig, d):
    """It ripples with the eccentric mass, which is fastest at the bottom, θ = 0.

    J ω̇ = −m g r sin θ gives ω = ω_des + m g r / (J ω_des) cos θ.
    """
    time_s, y = rig(omega_des=FIG_7.omega_des, d=d).run(6.0)
    rise_s = time_s[np.argmax(y["omega"] > 0.9 * FIG_7.omega_des)]
    saturated_exact_s, rise_exact_s, _ = exact_start()
    # Weight and disturbance are at most a third of the friction, which is 13 % of the voltage.
    assert rise_s == pytest.approx(rise_exact_s, abs=3e-3)
    assert rise_s < 0.1 * TAU_S * np.log(10.0)
    assert np.abs(y["V_s"]).max() == TABLE_II.V_s_max
    saturated_s = time_s[y["V_s"] == TABLE_II.V_s_max]
    assert saturated_s.max() == pytest.approx(saturated_exact_s, abs=1.5e-3)
    p, last = TABLE_II, {name: values[-900:] for name, values in y.items()}
    columns = np.stack([np.cos(last["theta"]), np.sin(last["theta"]), np.ones(900)], axis=1)
    in_phase, _, mean = np.linalg.lstsq(columns, last["omega"])[0]
    assert mean == pytest.approx(FIG_7.omega_des, abs=0.1)
    assert in_phase == pytest.approx(p.m * p.g * p.r / (p.J * FIG_7.omega_des), rel=0.1)
    assert np.ptp(last["omega"]) / 2 == pytest.approx(1.9, abs=0.1)


def test_shaft_sticks_up_to_the_breakaway_voltage(rig):
    below = rig(closed_loop=False, V_in=0.999 * BREAKAWAY_V).run(0.1)[1]
    assert not any(below[name].any() for name in ("omega", "omega_dot", "theta"))
    above = rig(closed_loop=False, V_in=1.001 * BREAKAWAY_V).run(0.1)[1]
    # It creeps until the lifted mass holds it again.
    assert above["theta"][-1] > 0.0


@pytest.mark.parametrize("solver", [1, 2])
def test_friction_holds_the_mass_up_and_stops_the_shaft_for_good(rig, solver):
    held = rig(closed_loop=False, theta_start=1.5, solver=solver).run(0.1)[1]
    assert (held["theta"] == 1.5).all()
    stopped = rig(closed_loop=False, omega_start=100.0, solver=solver).run(0.2)[1]
    at_rest = int(np.argmax(stopped["omega"] == 0.0))
    assert 0 < at_rest < 100
    assert not stopped["omega"][at_rest:].any()
    assert not stopped["omega_dot"][at_rest:].any()


@pytest.mark.parametrize("solver", [1, 2])
@pytest.mark.parametrize(
    "start",
    [{"omega_des": 700.0}, {"closed_loop": False, "V_in": 1.0}, {"omega_start": 50.0, "d": 1e-6}],
)
def test_a_motor_turning_backwards_is_the_mirror_image_in_every_bit(rig, start, solver):
    reversed_start = {k: v if k == "closed_loop" else -v for k, v in start.items()}
    forwards, backwards = (rig(solver=solver, **s).run(0.3)[1] for s in (start, reversed_start))
    assert forwards["omega"].max() > 10.0
    for name in OUTPUTS:
        assert (forwards[name] == -backwards[name]).all(), name


@pytest.mark.parametrize("solver", [1, 2])
def test_integral_grows_by_the_error_while_the_shaft_sticks(rig, solver):
    set_point, duration_s = 10.0, 0.1
    y = rig(omega_des=set_point, solver=solver).run(duration_s, names=("omega", "integral"))[1]
    assert TABLE_II.K_p * set_point < 0.5 * BREAKAWAY_V
    assert not y["omega"].any()
    assert y["integral"][-1] == pytest.approx(set_point * duration_s)


def test_integral_holds_while_the_voltage_is_saturated(rig):
    motor = rig(omega_des=7000.0)
    y = motor.run(1.0, names=("V_s", "integral"))[1]
    assert (y["V_s"] == TABLE_II.V_s_max).all()
    assert not y["integral"].any()
    motor.set(omega_des=700.0)
    speeds = motor.run(1.0)[1]["omega"]
    # Had it grown by the 1 s of error above 2000 rad, 50 V would keep it from coming down.
    assert speeds[-1] == pytest.approx(700.0, abs=15.0)
