"""Refusals and the number of motors, by bare C calls."""

import ctypes

import numpy as np
import pytest

OK = 0
STEP_S = 1e-5
MOST = 65536


def test_the_number_of_motors_is_set_in_configuration_mode(array):
    motors = array(4)
    set_n = lambda n: motors.values("SetUInt64", ("n",), np.array([n], dtype=np.uint64))  # noqa: E731
    motors.refused(set_n(3), "Instantiated")
    assert motors.call("EnterConfigurationMode") == OK
    for wrong in (0, MOST + 1, 2**64 - 1):
        motors.refused(set_n(wrong), f"n cannot be {wrong}; use 1 to {MOST}")
    motors.refused(motors.set(omega_des=1.0), "Configuration Mode")
    motors.refused(motors.do_step(0.0, STEP_S), "Configuration Mode")
    assert set_n(3) == OK
    room = np.zeros(1, dtype=np.uint64)
    assert motors.values("GetUInt64", ("n",), room) == OK
    assert room == [3]
    assert motors.call("ExitConfigurationMode") == OK
    motors.n = 3
    motors.start(omega_des=[100.0, 200.0, 300.0])
    motors.refused(set_n(4), "Step Mode")
    motors.refused(motors.call("EnterConfigurationMode"), "Step Mode")
    assert motors.call("Reset") == OK
    motors.n = 4
    assert motors.start().get("omega_des").tolist() == [[0.0] * 4]


def test_the_number_of_samples_is_set_alike(array):
    motors = array(3)
    for wrong in (0, MOST + 1):
        status = motors.set_sizes(samples=wrong)
        motors.refused(status, f"samples cannot be {wrong}; use 1 to {MOST}")
    assert motors.set_sizes(samples=3, n=2) == OK
    for expected in ([3, 2, 3], [1, 4, 1]):
        room = np.zeros(3, dtype=np.uint64)
        assert motors.call("EnterConfigurationMode") == OK
        assert motors.values("GetUInt64", ("samples", "n", "samples"), room) == OK
        assert room.tolist() == expected
        assert motors.call("ExitConfigurationMode") == OK
        assert motors.call("Reset") == OK


@pytest.mark.parametrize("step_s", [2 * STEP_S, 4 * STEP_S, 3.3 * STEP_S])
def test_a_step_is_refused_that_is_not_made_of_equal_parts(array, step_s):
    motors = array(3)
    assert motors.set_sizes(samples=3) == OK
    motors.start(omega_des=700.0)
    assert motors.do_step(0.0, 3 * STEP_S) == OK
    before = motors.save()
    motors.refused(motors.do_step(3 * STEP_S, step_s), "3 equal parts", "samples or step_size")
    assert motors.set(d=1e300) == OK
    unbounded = motors.save()
    motors.refused(motors.do_step(3 * STEP_S, 3 * STEP_S), "motor 1")
    assert motors.save() == unbounded != before


def test_many_motors(array):
    motors = array(MOST).start(omega_des=np.linspace(100.0, 900.0, MOST))
    assert motors.do_step(0.0, STEP_S) == OK
    speeds = motors.get("omega")[0]
    assert speeds[0] > 0.0
    assert motors.load(motors.save()) == OK
    assert (motors.get("omega")[0] == speeds).all()


def test_several_arrays_and_scalars_come_in_order(array):
    motors = array(3).start(omega_des=[1.0, 2.0, 3.0], d=[4e-6, 5e-6, 6e-6])
    room = np.zeros(8)
    assert motors.values("GetFloat64", ("omega_des", "step_size", "time", "d"), room) == OK
    assert room.tolist() == [1.0, 2.0, 3.0, STEP_S, 0.0, 4e-6, 5e-6, 6e-6]
    both = np.array([7.0, 8.0, 9.0, 1e-6, 2e-6, 3e-6])
    assert motors.values("SetFloat64", ("omega_des", "d"), both) == OK
    assert motors.get("omega_des", "d").ravel().tolist() == both.tolist()


@pytest.mark.parametrize("count", [0, 2, 4, 6])
def test_arrays_of_wrong_length_are_refused(array, count):
    motors = array(3).start()
    for function in ("GetFloat64", "SetFloat64"):
        status = motors.values(function, ("omega_des",), np.zeros(count))
        motors.refused(status, f"{count} values, but the variables have 3")
    status = motors.values("SetInt64", ("restart",), np.zeros(count, dtype=np.int64))
    motors.refused(status, f"{count} values, but the variables have 3")


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("J", [1e-9, 0.0, 1e-9], "least"),
        ("V_s_max", [1.0, 1.0, -1.0], "least"),
        ("omega_des", [0.0, np.nan, 0.0], "finite"),
    ],
)
def test_values_out_of_range_are_refused_by_name(array, name, value, word):
    motors = array(3)
    before = motors.save()
    motors.refused(motors.set(**{name: value}), name, word)
    assert motors.save() == before


def test_mistyped_and_unknown_variables_are_refused(array):
    motors = array(1).start()
    motors.refused(motors.values("GetFloat64", ("closed_loop",), np.zeros(1)), "closed_loop is no")
    motors.refused(motors.values("GetInt64", ("n",), np.zeros(1, dtype=np.int64)), "n is no Int64")
    motors.refused(motors.values("GetUInt64", ("d",), np.zeros(1, dtype=np.uint64)), "d is no")
    room, unknown, one = (ctypes.c_double * 1)(), (ctypes.c_uint32 * 1)(99), ctypes.c_size_t(1)
    motors.refused(motors.call("GetFloat64", unknown, one, room, one), "99")
    motors.refused(motors.call("GetFloat64", None, one, room, one), "null")
    motors.refused(motors.call("SetInt64", unknown, one, None, one), "null")


def test_a_motor_beyond_all_bounds_is_named_and_the_step_undone(array):
    motors = array(10).start(omega_des=700.0)
    assert motors.do_step(0.0, 0.01) == OK
    assert motors.set(d=np.where(np.arange(10) == 8, 1e300, 0.0), restart=np.arange(10)) == OK
    before = motors.save()
    motors.refused(motors.do_step(0.01, STEP_S), "motor 9", "step_size")
    assert motors.save() == before
    assert motors.set(d=0.0) == OK
    assert motors.do_step(0.01, STEP_S) == OK
    first, second = motors.get("theta")[0, :2]
    assert 0.0 < second < 1e-3 * first  # which alone was not to restart


def test_other_interfaces_are_refused(array, array_library):
    motors = array(2).start()
    library = ctypes.CDLL(str(array_library))
    for name in ("ModelExchange", "ScheduledExecution"):
        make = getattr(library, f"fmi3Instantiate{name}")
        make.restype = ctypes.c_void_p
        assert not make(b"a", b"{}", b"", *[ctypes.c_void_p()] * 8)
    for name in ("EnterEventMode", "SetTime", "GetContinuousStates", "GetDirectionalDerivative",
                 "GetAdjointDerivative", "GetOutputDerivatives"):  # fmt: skip
        motors.refused(motors.call(name, *[ctypes.c_void_p()] * 8), "does not offer")
