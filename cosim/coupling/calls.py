"""The motors' FMUs in compiled code: the calls that set, step and get, and their signals.

An instance is one motor, or all motors as arrays. Signals stand in arrays (6, B), see
`cosim.coupling.signals.State`: motors D of all columns, then motors E, one signal after the other.
That is the order in which FMI has the values of arrays, so an instance of all motors takes and
fills them where they are.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.jit import inlined
from cosim.fmi.abi import FMI_OK, FMI_WARNING, call_back, do_step_3, exchange_3
from cosim.physics.lanes import Width, load, store

INCOMPLETE, NOT_FINITE, RAISED = 100, 101, 102  # beyond every fmi3Status


@inlined
def do_step(function: int, instance: int, time: float, step: float) -> int:
    """Step an FMU of FMI 3.0 at `time` over `step` (s), for good.

    Returns the fmi3Status, or INCOMPLETE if the FMU returned early or asks to end the simulation.
    """
    status, ended = do_step_3(function, instance, time, step)
    return INCOMPLETE if ended else status


class Calls(NamedTuple):
    """Addresses by which compiled code reaches the FMUs of all motors; integers are addresses.

    Attributes:
        instances: (I,) int64: one of all motors; or those of motors D and E of every column, 0
            where there is none.
        ticks: (I,) int64, ticks of dt that each has done.
        values: (4,) float64, room for the signals of an instance of one motor.
        set_float64, do_step, get_float64: functions of the binary.
        inputs, outputs, electrical: arrays of value references (uint32).
        step_period: function that steps all motors over a control period; 0 to step them here.
        sampled: (3 · S · 2, B) outputs in that period: of each signal, at the ends of its S
            communication steps, of motors D and E.
        sampled_references: (3,) value references of them.
    """

    instances: np.ndarray
    ticks: np.ndarray
    values: np.ndarray
    set_float64: int
    do_step: int
    get_float64: int
    inputs: np.ndarray
    outputs: np.ndarray
    electrical: np.ndarray
    step_period: int
    sampled: np.ndarray
    sampled_references: np.ndarray


@inlined
def set_inputs(calls: Calls, signals: np.ndarray) -> tuple[int, int]:
    """Set the inputs of all motors; returns the fmi3Status and the instance that failed, if any."""
    return _exchange(calls, calls.set_float64, calls.inputs, signals, 0, calls.instances.shape[0])


@inlined
def get_signals(
    calls: Calls, references: np.ndarray, signals: np.ndarray, first: int, end: int
) -> tuple[int, int]:
    """Get outputs of the motors of instances `first` to `end` − 1; returns as `set_inputs`."""
    return _exchange(calls, calls.get_float64, references, signals, first, end)


@inlined
def _exchange(
    calls: Calls, function: int, references: np.ndarray, signals: np.ndarray, first: int, end: int
) -> tuple[int, int]:
    """Set or get signals; a setter's come back, and a getter's go, as they are."""
    count, columns = references.shape[0], signals.shape[1]
    arrays = calls.instances.shape[0] == 1
    for k in range(first, end):
        if calls.instances[k] == 0:
            continue
        if not arrays:
            for signal in range(count):
                calls.values[signal] = signals[2 * signal + k % 2, k // 2]
        values = signals.ctypes.data if arrays else calls.values.ctypes.data
        size = 2 * count * columns if arrays else count
        arguments = (calls.instances[k], references.ctypes.data, count, values, size)
        status = exchange_3(function, arguments)
        if status > FMI_WARNING:
            return status, k
        if not arrays:
            for signal in range(count):
                signals[2 * signal + k % 2, k // 2] = calls.values[signal]
    return FMI_OK, 0


@inlined
def step_motors(
    calls: Calls, signals: np.ndarray, first: int, end: int, count: int, dt: float
) -> tuple[int, int]:
    """Step instances `first` to `end` − 1 over `count` ticks, and get their outputs."""
    for k in range(first, end):
        if calls.instances[k] != 0:
            status = do_step(calls.do_step, calls.instances[k], calls.ticks[k] * dt, count * dt)
            if status > FMI_WARNING:
                return status, k
            calls.ticks[k] += count
    return get_signals(calls, calls.outputs, signals, first, end)


@inlined
def step_period(calls: Calls, signals: np.ndarray) -> int:
    """Set the inputs of all motors, have them stepped over a control period, and get the samples.

    Args:
        calls: with a function that steps the instance of all motors.
        signals: (6, B) inputs.

    Returns:
        The status.
    """
    status, _ = set_inputs(calls, signals)
    if status <= FMI_WARNING:
        status = call_back(calls.step_period, (0,))
    if status <= FMI_WARNING:
        references, sampled = calls.sampled_references, calls.sampled
        arguments = (
            calls.instances[0],
            references.ctypes.data,
            references.shape[0],
            sampled.ctypes.data,
            sampled.shape[0] * sampled.shape[1],
        )
        status = exchange_3(calls.get_float64, arguments)
    return status


@inlined
def take_sampled(calls: Calls, signals: np.ndarray, step: int, width: Width) -> None:
    """Put the outputs at the end of a communication step of the period in their place."""
    sampled, rows = calls.sampled, signals.shape[0]
    steps = sampled.shape[0] // rows
    for row in range(rows):
        sample = 2 * (row // 2 * steps + step) + row % 2
        for column in range(0, signals.shape[1], len(width)):
            store(signals, row, column, width, load(sampled, sample, column, width))
