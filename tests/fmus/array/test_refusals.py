"""Refusals of arrays of several motors, and their sizes; see also `tests.fmus.behaviour`."""

import numpy as np
import pytest

OK = 0
STEP_S = 1e-5
MOST = 65536


def test_sizes_are_set_in_configuration_mode(array):
    motors = array(4)
    one = np.ones(1, dtype=np.uint64)
    motors.refused(motors.values("SetUInt64", ("n",), 3 * one), "Instantiated")
    for name in ("n", "samples"):
        for wrong in (0, MOST + 1, 2**64 - 1):
            words = f"{name} cannot be {wrong}; use 1 to {MOST}"
            motors.refused(motors.set_sizes(**{name: wrong}), words)
    assert motors.call("EnterConfigurationMode") == OK
    motors.refused(motors.set(omega_des=1.0), "Configuration Mode")
    motors.refused(motors.do_step(0.0, STEP_S), "Configuration Mode")
    assert motors.call("ExitConfigurationMode") == OK
    assert motors.set_sizes(samples=2, n=3) == OK
    for expected in ([2, 3, 2], [1, 4, 1]):
        room = np.zeros(3, dtype=np.uint64)
        assert motors.call("EnterConfigurationMode") == OK
        assert motors.values("GetUInt64", ("samples", "n", "samples"), room) == OK
        assert room.tolist() == expected
        assert motors.call("ExitConfigurationMode") == OK
        motors.n = expected[1]
        motors.start(omega_des=100.0)
        motors.refused(motors.values("SetUInt64", ("n",), 4 * one), "Step Mode")
        motors.refused(motors.call("EnterConfigurationMode"), "Step Mode")
        assert motors.call("Reset") == OK
    assert motors.start().get("omega_des").tolist() == [[0.0] * 4]


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


@pytest.mark.long
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
    for count in (0, 2, 4, 6):
        for function, name, kind in (
            ("GetFloat64", "omega_des", float),
            ("SetFloat64", "omega_des", float),
            ("SetInt64", "restart", np.int64),
        ):
            status = motors.values(function, (name,), np.zeros(count, dtype=kind))
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


def test_an_unstable_motor_is_named_before_the_next_step(array):
    motors = array(3).start(omega_des=700.0)
    assert motors.do_step(0.0, STEP_S) == OK
    assert motors.set(J=np.array([2.67e-9, 5e-13, 1e-13])) == OK
    before = motors.save()
    least = "J of motor 2 cannot be 5e-13", "step_size 1e-05 s; the least"
    motors.refused(motors.do_step(STEP_S, STEP_S), *least)
    assert motors.save() == before
    other = array(3).start()
    assert other.load(before) == OK
    other.refused(other.do_step(STEP_S, STEP_S), *least)
    assert motors.set(J=2.67e-9) == motors.do_step(STEP_S, STEP_S) == OK
