"""Calls from compiled code to the FMI 3.0 C functions behind an address.

The address is a run-time integer: the code is compiled once for all FMUs and cached on disk,
which numba refuses for a global ctypes function pointer.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

INCOMPLETE = 100  # beyond every fmi3Status

_INT, _LONG, _DOUBLE, _BOOL = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8)
_POINTER = _BOOL.as_pointer()
_VALUES = ir.FunctionType(_INT, [_POINTER, _POINTER, _LONG, _POINTER, _LONG])
_DO_STEP = ir.FunctionType(_INT, [_POINTER, _DOUBLE, _DOUBLE, _BOOL] + [_POINTER] * 4)


def _pointer(builder, address, to):
    return builder.inttoptr(address, to.as_pointer() if to is not _POINTER else _POINTER)


def _exchange_float64(_typing, function, instance, references, count, values):
    """Call fmi3SetFloat64 or fmi3GetFloat64(instance, references, count, values, count).

    All arguments are integers: addresses, and the number of scalar variables.
    Returns the fmi3Status.
    """

    def codegen(_context, builder, _signature, arguments):
        function, instance, references, count, values = arguments
        return builder.call(
            _pointer(builder, function, _VALUES),
            [
                _pointer(builder, instance, _POINTER),
                _pointer(builder, references, _POINTER),
                count,
                _pointer(builder, values, _POINTER),
                count,
            ],
        )

    return types.int32(*(types.int64,) * 5), codegen


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
