"""Calls from compiled code to the FMI 3.0 C functions behind an address.

The address is a run-time integer: the code is compiled once for all FMUs and cached on disk,
which numba refuses for a global ctypes function pointer.

An instance is one motor, or all motors as arrays. Signals stand in arrays (6, B), see
`cosim.coupling.signals.State`: motors D of all columns, then motors E, one signal after the other.
That is the order in which FMI has the values of arrays, so an instance of all motors takes and
fills them where they are.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from cosim.base.jit import inlined

INCOMPLETE, NOT_FINITE = 100, 101  # beyond every fmi3Status
FMI_OK, FMI_WARNING = 0, 1  # of fmi3Status; anything above ends the run

_INT, _LONG, _DOUBLE, _BOOL = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8)
_POINTER = _BOOL.as_pointer()
_VALUES = ir.FunctionType(_INT, [_POINTER, _POINTER, _LONG, _POINTER, _LONG])
_DO_STEP = ir.FunctionType(_INT, [_POINTER, _DOUBLE, _DOUBLE, _BOOL] + [_POINTER] * 4)


def _pointer(builder, address, to):
    return builder.inttoptr(address, to.as_pointer() if to is not _POINTER else _POINTER)


def _exchange_float64(_typing, function, instance, references, count, values, size):
    """Call fmi3SetFloat64 or fmi3GetFloat64(instance, references, count, values, size).

    All arguments are integers: addresses, the number of variables, and that of their values.
    Returns the fmi3Status.
    """

    def codegen(_context, builder, _signature, arguments):
        function, instance, references, count, values, size = arguments
        return builder.call(
            _pointer(builder, function, _VALUES),
            [
                _pointer(builder, instance, _POINTER),
                _pointer(builder, references, _POINTER),
                count,
                _pointer(builder, values, _POINTER),
                size,
            ],
        )

    return types.int32(*(types.int64,) * 6), codegen


exchange_float64: Any = intrinsic(_exchange_float64)


def _do_step(_typing, function, instance, time, step):
    """Call fmi3DoStep at `time` over `step` (s).

    Returns the fmi3Status, or INCOMPLETE if the FMU returned early or asks to end the simulation.
    """

    def codegen(_context, builder, _signature, arguments):
        function, instance, time, step = arguments
        flags = [cgutils.alloca_once(builder, _BOOL) for _ in range(3)]
        last_time = cgutils.alloca_once(builder, _DOUBLE)
        status = builder.call(
            _pointer(builder, function, _DO_STEP),
            [
                _pointer(builder, instance, _POINTER),
                time,
                step,
                ir.Constant(_BOOL, 1),  # noSetFMUStatePriorToCurrentPoint
                *flags,
                builder.bitcast(last_time, _POINTER),
            ],
        )
        _event_handling_needed, terminate, early_return = (builder.load(flag) for flag in flags)
        stopped = builder.icmp_unsigned("!=", builder.or_(terminate, early_return), _BOOL(0))
        return builder.select(stopped, _INT(INCOMPLETE), status)

    return types.int32(types.int64, types.int64, types.float64, types.float64), codegen


do_step: Any = intrinsic(_do_step)


class Calls(NamedTuple):
    """What compiled code needs to reach the FMUs of all motors; integers are addresses.

    Attributes:
        instances: (I,) int64: one of all motors; or those of motors D and E of every column, 0
            where there is none.
        ticks: (I,) int64, ticks of dt that each has done.
        values: (3,) float64, room for the signals of an instance of one motor.
        set_float64, do_step, get_float64: functions of the binary.
        inputs, outputs, electrical: arrays of value references (uint32).
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


@inlined
def set_inputs(calls: Calls, signals: np.ndarray) -> tuple[int, int]:
    """Set the inputs of all motors; returns the fmi3Status and the instance that failed, if any."""
    count, columns = calls.inputs.shape[0], signals.shape[1]
    arrays = calls.instances.shape[0] == 1
    for k in range(calls.instances.shape[0]):
        if calls.instances[k] == 0:
            continue
        if not arrays:
            for signal in range(count):
                calls.values[signal] = signals[2 * signal + k % 2, k // 2]
        status = exchange_float64(
            calls.set_float64,
            calls.instances[k],
            calls.inputs.ctypes.data,
            count,
            signals.ctypes.data if arrays else calls.values.ctypes.data,
            2 * count * columns if arrays else count,
        )
        if status > FMI_WARNING:
            return status, k
    return FMI_OK, 0


@inlined
def get_signals(
    calls: Calls, references: np.ndarray, signals: np.ndarray, first: int, end: int
) -> tuple[int, int]:
    """Get outputs of the motors of instances `first` to `end` − 1; returns as `set_inputs`."""
    count, columns = references.shape[0], signals.shape[1]
    arrays = calls.instances.shape[0] == 1
    for k in range(first, end):
        if calls.instances[k] == 0:
            continue
        status = exchange_float64(
            calls.get_float64,
            calls.instances[k],
            references.ctypes.data,
            count,
            signals.ctypes.data if arrays else calls.values.ctypes.data,
            2 * count * columns if arrays else count,
        )
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
