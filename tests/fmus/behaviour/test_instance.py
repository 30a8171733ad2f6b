"""Refusals, rollback and messages, of both standards, and of an array of one motor."""

import ctypes
import re

import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave, fmi3LogMessageCallback
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.model.params import TABLE_II, TIMING

OK, ERROR = 0, 3
STEP_S = 1e-5
CATEGORY = "logStatusError"
ON_OFF = pytest.mark.parametrize("logging", [False, True])


@pytest.mark.parametrize(
    ("time_s", "step_s"),
    [
        *((0.0, step_s) for step_s in (float("nan"), -STEP_S, 0.0, float("inf"), 1e300)),
        *((time_s, STEP_S) for time_s in (float("nan"), 1.0, -STEP_S)),
    ],
)
def test_bad_steps_are_refused_and_change_nothing(instance, kind, time_s, step_s):
    motor = instance(kind).start(omega_des=700.0)
    before = motor.save()
    motor.refused(motor.do_step(time_s, step_s), "communication")
    assert motor.save() == before
    assert motor.do_step(0.0, STEP_S) == OK


def test_steps_beyond_the_stop_time_are_refused(instance, kind):
    motor = instance(kind).start(stop_s=1e-3)
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
        ("solver", 3, "1 to 2"),
    ],
)
def test_values_out_of_range_are_refused_by_name(instance, kind, name, value, word):
    motor = instance(kind)
    if name in motor.variables:  # an array has no choice of solver
        before = motor.save()
        motor.refused(motor.set(**{name: value}), name, word)
        assert motor.save() == before


@pytest.mark.parametrize("last", [999, "omega", "theta"])
def test_a_refused_call_sets_none_of_its_variables(instance, kind, last):
    motor = instance(kind)

    def refuses_whole(refused: int | str, **values: float | bool) -> None:
        """Set variables of one type, and the refused one to the first one's value."""
        first = next(iter(values.values()))
        name, number = motor.kind_of("", first)
        before = motor.save()
        references = motor.references(*values)
        references.append(motor.reference.get(refused, refused))
        array = np.array([*values.values(), first], dtype=number)
        motor.refused(motor.exchange(f"Set{name}", references, array))
        assert motor.save() == before

    for begin in (lambda: None, motor.enter_initialization):
        begin()
        refuses_whole(last, closed_loop=False)
        whole = "restart" if kind == "array" else "solver"
        refuses_whole(last, **{whole: 1})
        refuses_whole(last, **{whole: 2})
        refuses_whole(last, J=1e-8, omega_des=5.0)
    motor.call("ExitInitializationMode")
    refuses_whole("omega_start", omega_des=5.0)


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
    one = ctypes.c_size_t(1)
    if kind == "array":
        for function, name in (("GetInt64", "n"), ("GetUInt64", "d")):
            motor.refused(motor.values(function, (name,), room.astype(int)), f"{name} is no ")
        motor.refused(motor.call("GetFloat64", None, one, None, one), "null")
        motor.refused(motor.exchange("SetInt64", [99], None), "null")
    elif kind == 3:
        two, place = (ctypes.c_uint32 * 2)(1, 2), (ctypes.c_double * 1)()
        status = motor.call("GetFloat64", two, ctypes.c_size_t(2), place, one)
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
    [({"step_size": 5e-3}, 10.0, 1e93), ({}, STEP_S, 1e300)],
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


@ON_OFF
@pytest.mark.parametrize(
    ("options", "words"),
    [
        *(({"name": name}, "instance name is blank") for name in (None, b"", b" ", b" \t\r\n")),
        ({"token": "{100%}"}, "{100%}"),
    ],
)
def test_bad_names_and_model_descriptions_of_other_builds_are_refused(
    instance, kind, options, words, logging
):
    motor = instance(kind, logging=logging, **options)
    assert not motor.handle
    assert len(motor.messages) == logging
    words = words.replace("%", "%%") if kind == 2 else words  # a message of FMI 2 is a format
    assert all(words in message for message in motor.messages)
    assert instance(kind, name=b" a").handle


@ON_OFF
@pytest.mark.parametrize("model", ["VibrationMotor", "VibrationMotors"])
@pytest.mark.parametrize("interface", ["ModelExchange", "ScheduledExecution"])
def test_other_interfaces_of_fmi_3_are_refused(instance, libraries, model, interface, logging):
    messages: list[bytes] = []
    log, none = fmi3LogMessageCallback(lambda *a: messages.append(a[3])), ctypes.c_void_p()
    make = getattr(ctypes.CDLL(str(libraries[model])), f"fmi3Instantiate{interface}")
    make.restype = ctypes.c_void_p
    token = instance("array" if model == "VibrationMotors" else 3).token
    flags = [ctypes.c_bool(False), ctypes.c_bool(logging)]
    assert not make(b"name", token.encode(), b"", *flags, none, log, none, none, none)
    assert len(messages) == logging


def test_model_exchange_is_refused_in_fmi_2(instance, libraries):
    messages: list[bytes] = []
    log = fmi2CallbackLoggerTYPE(lambda *a: messages.append(a[4]))
    functions, token = fmi2CallbackFunctions(logger=log), instance(2).token.encode()
    make = ctypes.CDLL(str(libraries["VibrationMotor"])).fmi2Instantiate
    assert not make(b"name", 0, token, b"", ctypes.byref(functions), 0, 1)
    assert b"does not offer Model Exchange" in messages[0]


@pytest.mark.parametrize("kind", [3, "array"])
def test_other_functions_of_fmi_3_are_refused(instance, kind):
    motor = instance(kind).start()
    for name in ("EnterEventMode", "SetTime", "GetContinuousStates", "GetDirectionalDerivative",
                 "GetAdjointDerivative", "GetOutputDerivatives"):  # fmt: skip
        motor.refused(motor.call(name, *[ctypes.c_void_p()] * 8), "does not offer")


@pytest.mark.parametrize("model", ["VibrationMotor", "VibrationMotors"])
def test_no_instance_is_an_error_and_no_crash(libraries, model):
    functions, checked = ctypes.CDLL(str(libraries[model])), 0
    classes = {FMU3Slave: "fmi3"} | ({FMU2Slave: "fmi2"} if model == "VibrationMotor" else {})
    for name in sorted(n for c, prefix in classes.items() for n in dir(c) if n.startswith(prefix)):
        if "Instantiate" in name or name.endswith(("GetVersion", "GetTypesPlatform")):
            continue
        status = getattr(functions, name)(*[ctypes.c_void_p()] * 10)
        assert "FreeInstance" in name or status == ERROR, name
        checked += 1
    assert checked > 60


def test_rollback_repeats_the_same_bits_also_in_another_instance(instance, kind):
    """With its inputs, its parameters, and the time that its steps owe: 6e-12 s of each."""
    step_s, values = STEP_S * (1.0 + 6e-7), {"omega_des": 700.0, "omega_noise": 5.0, "d": 1e-6}
    motor, other = instance(kind).start(J=4e-9, **values), instance(kind)
    for k in range(101):
        assert motor.do_step(k * step_s, step_s) == OK
    saved, ends = motor.save(), []
    for each in (motor, motor, other):
        assert each.load(saved) == OK
        assert each.save() == saved
        for k in range(101, 151):
            assert each.do_step(k * step_s, step_s) == OK
        ends.append((each.save(), each.get("theta", "omega", "V_s", "i", *values, "J")))
    assert ends[0] == ends[1] == ends[2]
    assert ends[0][0] != saved


def test_defaults_are_those_of_the_paper(instance, kind):
    motor = instance(kind).start()
    assert motor.get(*TABLE_II._fields) == list(TABLE_II)
    assert motor.get("step_size") == [TIMING.dt_s]


def told(motor) -> int:
    """Messages that a refused call brings."""
    before = len(motor.messages)
    assert motor.set(J=-1.0) == ERROR
    return len(motor.messages) - before


def set_logging(motor, on: bool, *categories: str | None) -> int:
    names = [None if c is None else c.encode() for c in categories]
    flag = ctypes.c_bool(on) if motor.fmi == 3 else ctypes.c_int(on)
    array = (ctypes.c_char_p * len(names))(*names)
    return motor.call("SetDebugLogging", flag, ctypes.c_size_t(len(names)), array)


@ON_OFF
def test_logging_is_as_instantiated_until_it_is_switched(instance, kind, logging):
    motor = instance(kind, logging=logging)
    assert told(motor) == logging
    for categories in ((), (CATEGORY,), (CATEGORY, CATEGORY)):
        assert set_logging(motor, True, *categories) == OK
        assert told(motor) == 1
        assert motor.call("Reset") == OK
        assert told(motor) == 1
        assert set_logging(motor, False, *categories) == OK
        assert told(motor) == 0


@ON_OFF
@pytest.mark.parametrize("category", ["logAll", "", None])
def test_unknown_log_categories_are_refused_and_change_nothing(instance, kind, logging, category):
    motor = instance(kind, logging=logging)
    for on in (False, True):
        assert set_logging(motor, on, CATEGORY, category) == ERROR
        assert told(motor) == logging
    if logging:
        assert f'no log category "{category or ""}"; use {CATEGORY}' in motor.messages[0]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    K_T=st.floats(1e-4, 1e-2),
    R=st.floats(0.5, 100.0),
    b=st.sampled_from([0.0, 1e-8, 1e-6]),
    K_p=st.sampled_from([0.0, 0.015, 1.0]),
    K_i=st.sampled_from([0.0, 0.025, 10.0]),
    step_size=st.sampled_from([1e-6, 1e-5, 1e-3]),
)
def test_the_least_inertia_is_where_the_speed_stops_to_swing_up(instance, kind, step_size, **own):
    """By the eigenvalues of a step without weight and friction, and by the speeds of the FMU."""
    wanted = own | {"step_size": step_size, "J": 1e-15, "m": 0.0, "c": 0.0, "V_s_max": 1e9}
    motor = instance(kind)
    assert motor.set(**wanted) == motor.enter_initialization() == OK

    def growth() -> float:
        """Largest size of an eigenvalue of speed and integral."""
        volts, rate = own["K_T"] / own["R"], step_size / (0.99 * wanted["J"])
        pull = rate * (own["b"] + volts * (own["K_T"] + own["K_p"]))
        loop = [[1.0 - pull, rate * volts * wanted["K_i"]], [-step_size, 1.0]]
        return np.abs(np.linalg.eigvals(np.array(loop))).max()

    while motor.call("ExitInitializationMode") == ERROR:
        before = motor.save()
        motor.refused(motor.call("ExitInitializationMode"), "swing up", f"step_size {step_size:g}")
        assert motor.save() == before
        ((name, value),) = re.findall(r": (J|K_i) .* is (\S+)$", motor.messages[-1])
        wanted[name] = float(value)
        if name == "J":
            assert growth() > 1.0
        assert motor.set(**{name: wanted[name]}) == OK
    assert motor.set(omega_des=100.0) == OK
    for k in range(20):
        assert motor.do_step(100 * k * step_size, 100 * step_size) == OK
    assert abs(motor.get("omega")[0]) < 1e3
