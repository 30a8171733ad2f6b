"""Refusals and rollback, by bare C calls of both standards, and of an array of one motor."""

import ctypes

import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave

from cosim.model.params import TABLE_II, TIMING

OK, ERROR = 0, 3
STEP_S = 1e-5


@pytest.mark.parametrize("step_s", [float("nan"), -STEP_S, 0.0, float("inf"), 1e300])
def test_bad_steps_are_refused_and_change_nothing(instance, kind, step_s):
    motor = instance(kind).start(omega_des=700.0)
    before = motor.save()
    motor.refused(motor.do_step(0.0, step_s), "communication step")
    assert motor.save() == before
    assert motor.do_step(0.0, STEP_S) == OK


@pytest.mark.parametrize("time_s", [float("nan"), 1.0, -STEP_S])
def test_a_lost_or_doubled_step_is_refused(instance, kind, time_s):
    motor = instance(kind).start()
    motor.refused(motor.do_step(time_s, STEP_S), "communication point")


def test_steps_beyond_the_stop_time_are_refused(instance, kind):
    motor = instance(kind)
    assert motor.enter_initialization(stop_s=1e-3) == OK
    assert motor.call("ExitInitializationMode") == OK
    assert motor.do_step(0.0, 1e-3) == OK
    motor.refused(motor.do_step(1e-3, 1e-3), "stop time")


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("J", 0.0, "least"),
        ("J", -1e-9, "least"),
        ("R", 0.0, "least"),
        ("V_s_max", -1.0, "least"),
        ("K_T", float("nan"), "finite"),
        ("step_size", 1.0, "most"),
        ("step_size", 0.0, "least"),
        ("omega_des", float("inf"), "finite"),
        ("omega", 1.0, "set"),
    ],
)
def test_values_out_of_range_are_refused_by_name(instance, kind, name, value, word):
    motor = instance(kind)
    before = motor.save()
    motor.refused(motor.set(**{name: value}), name, word)
    assert motor.save() == before


def test_an_unknown_solver_is_refused(instance, fmi):
    motor = instance(fmi)
    before = motor.save()
    motor.refused(motor.set(solver=3), "solver", "1 to 2")
    assert motor.save() == before


@pytest.mark.parametrize("last", [999, "omega", "theta"])
def test_a_refused_call_sets_none_of_its_variables(instance, kind, last):
    motor = instance(kind)
    for begin in (lambda: None, motor.enter_initialization):
        begin()
        assert motor.refuses_whole(last, closed_loop=False)
        whole = "restart" if kind == "array" else "solver"
        assert motor.refuses_whole(last, **{whole: 1}) and motor.refuses_whole(last, **{whole: 2})
        assert motor.refuses_whole(last, J=1e-8, omega_des=5.0)
    motor.call("ExitInitializationMode")
    assert motor.refuses_whole("omega_start", omega_des=5.0)


def test_parameters_are_fixed_once_the_simulation_runs(instance, kind):
    motor = instance(kind).start()
    for name in ("omega_start", "step_size", *([] if kind == "array" else ["J"])):
        motor.refused(motor.set(**{name: 1e-9}), name, "fixed parameter")
    motor.refused(motor.set(closed_loop=False), "closed_loop", "fixed parameter")
    assert motor.set(omega_des=700.0) == OK


def test_unknown_and_mistyped_variables_are_refused(instance, kind):
    motor = instance(kind).start()
    room = np.zeros(1)
    motor.refused(motor.get_status([999], room), "999")
    motor.refused(motor.get_status(motor.references("closed_loop"), room), "closed_loop")
    motor.refused(motor.get_status([1], None), "null")


def test_arrays_of_different_lengths_are_refused(instance):
    motor = instance(3).start()
    two, room = (ctypes.c_uint32 * 2)(1, 2), (ctypes.c_double * 1)()
    status = motor.call("GetFloat64", two, ctypes.c_size_t(2), room, ctypes.c_size_t(1))
    motor.refused(status, "2 value references but 1 values")


def test_calls_in_the_wrong_state_are_refused(instance, kind):
    motor = instance(kind)
    motor.refused(motor.do_step(0.0, STEP_S), "not allowed in the state Instantiated")
    motor.refused(motor.call("ExitInitializationMode"), "Instantiated")
    motor.start()
    motor.refused(motor.call("EnterInitializationMode", *[0] * 5), "Step Mode")
    assert motor.call("Terminate") == OK
    motor.refused(motor.do_step(0.0, STEP_S), "Terminated")
    motor.refused(motor.set(omega_des=1.0), "Terminated")
    assert motor.get("omega") == [0.0]
    assert motor.call("Reset") == OK
    motor.start()


@pytest.mark.parametrize(
    ("start", "step_s", "d"),
    [({"step_size": 1e-2, "J": 1e-15, "K_p": 1e6, "V_s_max": 1e300}, 10.0, 0.0),
     ({}, STEP_S, 1e300)],
    ids=["explosion", "derivative"],
)  # fmt: skip
def test_a_speed_beyond_all_bounds_is_refused_and_undone(instance, kind, start, step_s, d):
    motor = instance(kind).start(**start)
    assert motor.set(omega_des=700.0, d=d) == OK
    before = motor.save()
    motor.refused(motor.do_step(0.0, step_s), "beyond all bounds", "step_size")
    assert motor.save() == before
    assert motor.set(omega_des=0.0, d=0.0) == OK
    assert motor.do_step(0.0, STEP_S) == OK


def test_model_exchange_is_refused_in_fmi_2(library, token):
    messages: list[bytes] = []
    log = fmi2CallbackLoggerTYPE(lambda *a: messages.append(a[4]))
    functions, text = fmi2CallbackFunctions(logger=log), token.encode()
    make = ctypes.CDLL(str(library)).fmi2Instantiate
    assert not make(b"name", 0, text, b"", ctypes.byref(functions), 0, 1)
    assert b"does not offer Model Exchange" in messages[0]


def test_a_model_description_of_another_build_is_refused(instance, kind):
    motor = instance(kind, token="{100%}")
    assert not motor.handle
    assert ("{100%%}" if kind == 2 else "{100%}") in motor.messages[-1]


@pytest.mark.parametrize("name", [None, b"", b" ", b" \t\r\n"])
def test_a_blank_instance_name_is_refused(instance, kind, name):
    motor = instance(kind, name=name)
    assert not motor.handle
    assert "instance name is blank" in motor.messages[-1]
    assert instance(kind, name=b" a").handle


@pytest.mark.parametrize("model", ["library", "array_library"])
def test_no_instance_is_an_error_and_no_crash(model, request):
    functions, checked = ctypes.CDLL(str(request.getfixturevalue(model))), 0
    classes = {FMU3Slave: "fmi3"} | ({FMU2Slave: "fmi2"} if model == "library" else {})
    for name in sorted(n for c, prefix in classes.items() for n in dir(c) if n.startswith(prefix)):
        if "Instantiate" in name or name.endswith(("GetVersion", "GetTypesPlatform")):
            continue
        status = getattr(functions, name)(*[ctypes.c_void_p()] * 10)
        assert "FreeInstance" in name or status == ERROR, name
        checked += 1
    assert checked > 60


def test_rollback_repeats_the_same_bits(instance, kind):
    motor = instance(kind).start(omega_des=700.0)
    assert motor.do_step(0.0, 0.05) == OK
    saved = motor.save()
    rows = []
    for _ in range(2):
        for k in range(50):
            assert motor.do_step(0.05 + k * 1e-3, 1e-3) == OK
        rows.append(motor.save())
        assert motor.load(saved) == OK
    assert rows[0] == rows[1] != saved
    assert motor.save() == saved


def test_a_state_moves_to_another_instance(instance, kind):
    first, second = instance(kind).start(omega_des=700.0, J=3e-9), instance(kind)
    assert first.do_step(0.0, 0.1) == OK
    assert second.load(first.save()) == OK
    for motor in (first, second):
        assert motor.do_step(0.1, 0.1) == OK
    assert first.save() == second.save()


def test_defaults_are_those_of_the_paper(instance, kind):
    motor = instance(kind).start()
    assert motor.get(*TABLE_II._fields) == list(TABLE_II)
    assert motor.get("step_size") == [TIMING.dt_s]
