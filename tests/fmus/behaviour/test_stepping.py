"""Communication points and steps of any size: the time is the importer's, and no step is lost."""

import ctypes
import itertools

import numpy as np
import pytest

from cosim.base.jit import kernel
from cosim.fmi.calls import do_step
from cosim.fmi.motor import Motor, MotorFmu

OK = 0
STEP_S = 1e-5
# The state may be behind or ahead by 1e-6 of an internal step, at up to 4e4 rad/s².
LAG_S = 1e-6 * STEP_S
LAG = {"theta": 1000.0 * LAG_S, "omega": 4e4 * LAG_S}


def turning(instance, fmi: int, solver: int, start_s: float):
    """Instance on its way to 700 rad/s, at `start_s`."""
    start = {"omega_des": 700.0, "omega_start": 650.0, "solver": solver}
    motor = instance(fmi).start(start_s - 0.125, **start)
    assert motor.do_step(start_s - 0.125, 0.125) == OK
    assert motor.get("time") == [start_s]
    return motor


@pytest.mark.parametrize("start_s", [0.125, 1024.0])
@pytest.mark.parametrize("solver", [1, 2])
@pytest.mark.parametrize(("tiny_s", "count"), [(1e-12, 20_000), (1e-9, 10_000), (3e-11, 5_000)])
def test_tiny_steps_add_up_to_one_step(instance, fmi, tiny_s, count, solver, start_s):
    tiny, whole = (turning(instance, fmi, solver, start_s) for _ in range(2))
    for k in range(count):
        assert tiny.do_step(start_s + k * tiny_s, tiny_s) == OK, tiny.messages
    assert tiny.get("time") == [start_s + (count - 1) * tiny_s + tiny_s]
    before = whole.get("theta")
    assert whole.do_step(start_s, count * tiny_s) == OK
    # Euler's own error over one internal step comes to the lag: h² times the slope of omega_dot.
    euler = {"theta": 1e-7, "omega": 1e-4} if solver == 1 else {"theta": 0.0, "omega": 0.0}
    for name in ("theta", "omega"):
        assert tiny.get(name) == pytest.approx(whole.get(name), abs=LAG[name] + euler[name], rel=0)
    assert tiny.get("theta")[0] - before[0] > 0.5 * 600.0 * count * tiny_s


def test_steps_of_all_sizes_add_up(instance, fmi):
    motor, whole = (turning(instance, fmi, 2, 0.125) for _ in range(2))
    time_s = 0.125
    for exponent in np.random.default_rng(3).uniform(-13.0, -4.0, 20_000):
        step_s = 10.0**exponent
        assert motor.do_step(time_s, step_s) == OK, motor.messages
        time_s += step_s
        assert motor.get("time") == [time_s]
    assert whole.do_step(0.125, time_s - 0.125) == OK
    for name in ("theta", "omega"):
        assert motor.get(name) == pytest.approx(whole.get(name), abs=LAG[name], rel=1e-12)


@kernel
def many_steps(function: int, instance: int, step_s: float, count: int) -> int:
    """Steps made before the first refusal."""
    for k in range(count):
        if do_step(function, instance, k * step_s, step_s) != OK:
            return k
    return count


def test_steps_rounded_to_single_precision_run_on(motor_fmu):
    step_s, count = float(np.float32(STEP_S)), 20_500_000
    assert step_s != STEP_S
    ends = []
    for length_s, steps in ((step_s, count), (count * step_s, 1)):
        motor = Motor(MotorFmu(motor_fmu), "motor", {"omega_des": 700.0})
        made = many_steps(motor.functions.do_step, motor.address, length_s, steps)
        assert made == steps, motor.log
        ends.append(motor.get(motor.fmu.outputs))
        motor.close()
    # Unmade differences would come to 5e-6 s, or 4e-3 rad.
    assert ends[0][:2] == pytest.approx(ends[1][:2], abs=1e-4, rel=0)


@pytest.mark.long
def test_steps_just_short_of_whole_ones_run_on(instance, fmi):
    """The importer's clock is 5e-3 s behind whole steps in the end, half an internal step."""
    internal_s, count = 1e-2, 600_000
    step_s = internal_s * (1.0 - 9e-7)
    gains = {"K_p": 1e-3, "K_i": 1e-3}  # stable in these steps
    motor = instance(fmi).start(omega_des=700.0, step_size=internal_s, solver=2, **gains)
    function = getattr(motor.library, f"fmi{fmi}DoStep")
    double, pointer, flag = ctypes.c_double, ctypes.c_void_p, ctypes.c_int
    function.argtypes = [pointer, double, double, flag] + [pointer] * (4 if fmi == 3 else 0)
    tail = [ctypes.byref(ctypes.c_double()) for _ in range(4 if fmi == 3 else 0)]
    refused = sum(function(motor.handle, k * step_s, step_s, 1, *tail) for k in range(count))
    assert not refused, motor.messages[0]
    assert motor.get("time") == [(count - 1) * step_s + step_s]
    assert motor.get("time")[0] > 5999.0


@pytest.mark.parametrize("share", [-1.0, -0.5, -0.3, -1e-3, 1e-3, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("step_s", [1e-7, 1e-5, 1e-3])
def test_other_communication_points_are_refused(instance, fmi, step_s, share):
    motor = instance(fmi).start(omega_des=700.0)
    assert motor.do_step(0.0, 0.01) == OK
    before = motor.save()
    time_s = 0.01 + share * min(step_s, STEP_S)
    motor.refused(motor.do_step(time_s, step_s), "communication point")
    assert motor.save() == before
    assert motor.do_step(0.01, step_s) == OK


@pytest.mark.parametrize("start_s", [0.0, 1e3, 1e9])
def test_rounded_communication_points_are_accepted(instance, fmi, start_s):
    sums = itertools.accumulate([STEP_S] * 1000, initial=start_s)
    products = (start_s + k * STEP_S for k in range(1000))
    decimals = (round(start_s + k * STEP_S, 9) for k in range(1000))
    for points in (sums, products, decimals):
        motor = instance(fmi).start(start_s)
        for time_s in points:
            assert motor.do_step(time_s, STEP_S) == OK, motor.messages


def test_the_time_is_the_end_of_the_step_to_the_bit(instance, fmi):
    motor, last = instance(fmi).start(), ctypes.c_double()
    for k in range(1000):
        assert motor.do_step(k * STEP_S, STEP_S, last) == OK
        if fmi == 2:
            assert motor.call("GetRealStatus", 2, ctypes.byref(last)) == OK
        assert [last.value] == motor.get("time") == [k * STEP_S + STEP_S]
