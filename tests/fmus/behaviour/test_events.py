"""Communication steps, sticking and saturation: the same motion whichever way it is computed."""

import ctypes

import fmpy
import numpy as np
import pytest
from fmpy.sundials import CVodeSolver

from cosim.model.params import TABLE_II

OUTPUTS = ("theta", "omega", "omega_dot", "V_s", "i")
# One internal step of 1e-5 s at the largest acceleration that occurs (about 40 000 rad/s²).
ONE_STEP = 0.4


@pytest.mark.parametrize("solver", [1, 2])
@pytest.mark.parametrize(
    "start", [{"omega_des": 700.0}, {"closed_loop": False, "omega_start": 60.0, "V_in": -0.5}]
)
def test_result_does_not_depend_on_the_communication_step(rig, solver, start):
    runs = [rig(solver=solver, **start).run(0.2, step_s)[1] for step_s in (1e-5, 1e-4, 1e-3)]
    for name in OUTPUTS:
        assert (runs[0][name][::100] == runs[2][name]).all()
        assert (runs[1][name][::10] == runs[2][name]).all()


def test_variable_communication_steps_follow_the_same_motion(rig):
    steady = rig(omega_des=700.0, solver=2).run(0.2)[1]["omega"][-1]
    motor, generator = rig(omega_des=700.0, solver=2), np.random.default_rng(1)
    time_s = 0.0
    while time_s < 0.2:
        step_s = min(generator.uniform(1e-7, 3e-4), 0.2 - time_s)
        motor.fmu.doStep(time_s, step_s)
        time_s += step_s
    # The end of the saturation is resolved to one internal step, wherever these lie.
    assert motor.get("omega")[0] == pytest.approx(steady, rel=1e-6)
    assert motor.get("time")[0] == pytest.approx(0.2, rel=1e-12)


def test_time_does_not_drift(rig):
    motor = rig()
    for k in range(100_000):
        motor.fmu.doStep(k * 1e-5, 1e-5)
    assert motor.get("time") == [100_000 * 1e-5]


def test_sticking_breaking_away_and_reversing(rig):
    motor = rig(closed_loop=False)
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


@pytest.mark.parametrize("solver", [1, 2])
def test_disturbance_alone_moves_the_shaft_only_beyond_the_friction(rig, solver):
    assert not rig(closed_loop=False, d=TABLE_II.c, solver=solver).run(0.05)[1]["omega"].any()
    assert not rig(closed_loop=False, d=-TABLE_II.c, solver=solver).run(0.05)[1]["omega"].any()
    assert (rig(closed_loop=False, d=-2.0 * TABLE_II.c, solver=solver).run(0.05)[1]["omega"] < 0)[
        1:
    ].all()


def exchange(path, duration_s: float, **start):
    """Model Exchange with fmpy's CVode."""
    return fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="CVode",
        stop_time=duration_s,
        output_interval=1e-3,
        relative_tolerance=1e-8,
        start_values=start,
        output=["theta", "omega", "V_s", "integral"],
        record_events=False,
    )


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
def test_model_exchange_with_a_variable_step_solver_agrees(fmus, rig, fmi, case):
    duration_s, start = CASES[case]
    result = exchange(fmus[fmi], duration_s, **start)
    stepped = rig(**start).run(duration_s, names=("omega", "V_s", "integral"))[1]
    assert result["omega"] == pytest.approx(stepped["omega"], abs=ONE_STEP)
    assert result["V_s"] == pytest.approx(stepped["V_s"], abs=TABLE_II.K_p * ONE_STEP)
    if case in {"coasting to rest", "held below breakaway", "creeping up and held again"}:
        assert result["omega"][-1] == 0.0


def test_indicators_are_positive_until_their_event(instance, fmi):
    motor = instance(fmi, True).start(closed_loop=False)
    motor.call("EnterContinuousTimeMode")
    names = ("z_friction", "z_upper", "z_lower")
    assert all(value > 0 for value in motor.get(*names))
    motor.set(V_in=2.0 * TABLE_II.V_s_max)
    friction, upper, lower = motor.get(*names)
    assert friction < 0 and upper < 0 and lower > 0
    motor.call("EnterEventMode")
    motor.update_discrete_states()
    assert all(value > 0 for value in motor.get(*names))
    assert motor.get("omega_dot")[0] > 0.0


@pytest.mark.parametrize(
    ("start", "states"),
    [
        ({"closed_loop": False}, (0.0, 10.0, 0.0)),  # slipping
        ({"closed_loop": False, "omega_start": 10.0}, (0.0, -10.0, 0.0)),  # the other way
        ({"closed_loop": False, "omega_start": 10.0}, (0.0, 0.0, 0.0)),  # sticking
        ({"omega_start": 10.0}, (0.0, 10.0, 1e3)),  # saturated
        ({"omega_start": 10.0, "omega_des": 1e4}, (0.0, 9999.0, 0.0)),  # no longer
    ],
)
def test_every_change_of_mode_is_told_once(instance, fmi, start, states):
    motor = instance(fmi, True).start(**start)
    assert not motor.update_discrete_states()
    assert motor.call("EnterContinuousTimeMode") == 0
    content = (ctypes.c_double * 3)(*states)
    assert motor.call("SetContinuousStates", content, ctypes.c_size_t(3)) == 0
    assert motor.call("EnterEventMode") == 0
    assert motor.update_discrete_states()
    assert not motor.update_discrete_states()


def test_inputs_set_in_event_mode_are_told_once(instance, fmi):
    motor = instance(fmi, True).start(closed_loop=False, omega_start=10.0)
    assert not motor.update_discrete_states()
    assert motor.set(V_in=0.1) == 0
    assert motor.update_discrete_states()
    assert not motor.update_discrete_states()


class NoInput:
    """Inputs of fmpy's solver; here they are set by the importer."""

    def apply(self, time_s: float) -> None:
        pass


@pytest.mark.parametrize(
    ("start", "change"),
    [
        ({}, {"omega_des": 700.0}),
        ({"closed_loop": False}, {"V_in": 1.0}),
        ({"closed_loop": False, "omega_start": 700.0, "V_in": 0.709, "g": 0.0}, {"V_in": 1.2}),
    ],
    ids=["closed loop", "from standstill", "turning steadily"],
)
def test_an_importer_that_restarts_its_solver_when_told_misses_nothing(
    instance, rig, fmi, start, change
):
    """CVode with steps of any length, which would go on along the motion before the change."""
    motor = instance(fmi, True).start(**start)

    def call(name):
        return lambda values, count: motor.call(name, values, ctypes.c_size_t(count))

    derivatives = "GetContinuousStateDerivatives" if fmi == 3 else "GetDerivatives"
    motor.update_discrete_states()
    motor.call("EnterContinuousTimeMode")
    solver = CVodeSolver(
        nx=3,
        nz=3,
        get_x=call("GetContinuousStates"),
        set_x=call("SetContinuousStates"),
        get_dx=call(derivatives),
        get_z=call("GetEventIndicators"),
        get_nominals=call("GetNominalsOfContinuousStates"),
        set_time=lambda time_s: motor.call("SetTime", time_s),
        input=NoInput(),
        startTime=0.0,
        relativeTolerance=1e-8,
    )
    change_s, time_s, ends, speeds = 0.1, 0.0, np.arange(1, 201) * 1e-3, []
    for end_s in ends:
        while time_s < end_s:
            event, _, time_s = solver.step(time_s, end_s)
            changing = time_s == change_s
            if event or changing:
                motor.call("EnterEventMode")
                if changing:
                    motor.set(**change)
                told = motor.update_discrete_states()
                motor.call("EnterContinuousTimeMode")
                if told:
                    solver.reset(time_s)
        speeds += motor.get("omega")
    stepped = rig(**start)
    before = stepped.run(0.1, names=("omega",))[1]["omega"][1:]
    stepped.set(**change)
    after = stepped.run(0.1, names=("omega",))[1]["omega"][1:]
    assert change_s in ends
    assert speeds == pytest.approx(np.concatenate([before, after]), abs=ONE_STEP)
