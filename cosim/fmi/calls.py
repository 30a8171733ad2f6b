"""The motors' FMUs in compiled code: calls of their C functions behind addresses.

An address is a run-time integer: the code is compiled once for all FMUs and cached on disk, which
numba refuses for a global ctypes function pointer. Every call returns the fmi3Status.

An instance is one motor, or all motors as arrays. Signals stand in arrays (3 M, B), see
`cosim.coupling.signals.State`: the first of M motors of all columns, then the others, one signal
after the other.
FMI has the values of arrays in that order, so an instance of all motors takes and fills them in
place.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from cosim.base.jit import inlined
from cosim.physics.lanes import Width, load, store

# Of fmi3Status; anything above a warning is no result.
FMI_OK, FMI_WARNING, FMI_DISCARD, FMI_ERROR, FMI_FATAL = range(5)
INCOMPLETE, NOT_FINITE, RAISED = 100, 101, 102  # beyond every fmi3Status

_INT, _LONG, _DOUBLE, _BOOL = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8)
_POINTER = _BOOL.as_pointer()
_C_TYPES = {"p": _POINTER, "n": _LONG, "d": _DOUBLE, "b": _BOOL}


class Addresses(NamedTuple):
    """C functions of an FMI 3.0 binary, as integers for compiled code."""

    set_float64: int
    do_step: int
    get_float64: int


class Calls(NamedTuple):
    """What compiled code needs to reach the FMUs of all motors."""

    motors: int  # M, of every robot
    # (I,) int64 addresses: of one instance with all motors; or of those of the M motors of every
    # column, 0 where there is none
    instances: np.ndarray
    ticks: np.ndarray  # (I,) int64, ticks of dt that each has done
    values: np.ndarray  # (4,) room for the signals of an instance of one motor
    functions: Addresses
    # inputs, outputs, electrical: value references (uint32)
    inputs: np.ndarray
    outputs: np.ndarray
    electrical: np.ndarray
    step_period: int  # address of what steps all motors over a control period; 0 to step them here
    # (3 · S · M, B) outputs in that period: of each signal, at the ends of its S communication
    # steps, of each motor
    sampled: np.ndarray
    sampled_references: np.ndarray  # (3,) value references of them


def _call(builder: Any, form: str, address: Any, arguments: list[Any]) -> Any:
    """Call a C function that returns int; `form` has a letter of `_C_TYPES` per argument."""
    kinds = [_C_TYPES[letter] for letter in form]
    function = builder.inttoptr(address, ir.FunctionType(_INT, kinds).as_pointer())
    passed = [
        builder.inttoptr(value, kind) if kind is _POINTER and value.type != kind else value
        for value, kind in zip(arguments, kinds, strict=True)
    ]
    return builder.call(function, passed)


def _caller(form: str) -> Any:
    """An intrinsic (address, arguments as a tuple) -> status of functions of one form."""

    def typed(_typing, address, arguments):
        def codegen(_context, builder, _signature, values):
            return _call(builder, form, values[0], cgutils.unpack_tuple(builder, values[1]))

        return types.int32(types.int64, arguments), codegen

    return intrinsic(typed)


# (instance, references, variables, values, their number), of getters and setters.
exchange: Any = _caller("ppnpn")
# (anything), of a callback of ctypes, which takes the interpreter's lock.
_call_back: Any = _caller("p")


def _do_step(_typing, function, instance, time, step):
    """Call fmi3DoStep at `time` over `step` (s), for good.

    Returns the fmi3Status, or INCOMPLETE if the FMU returned early or asks to end the simulation.
    """

    def codegen(_context, builder, _signature, arguments):
        flags = [cgutils.alloca_once(builder, _BOOL) for _ in range(3)]
        for flag in flags:
            builder.store(_BOOL(0), flag)
        reached = builder.bitcast(cgutils.alloca_once(builder, _DOUBLE), _POINTER)
        function, *of_step = arguments
        status = _call(builder, "pddbpppp", function, [*of_step, _BOOL(1), *flags, reached])
        _, terminate, early = (builder.load(flag) for flag in flags)
        ended = builder.icmp_unsigned("!=", builder.or_(terminate, early), _BOOL(0))
        return builder.select(ended, _INT(INCOMPLETE), status)

    return types.int32(types.int64, types.int64, types.float64, types.float64), codegen


do_step: Any = intrinsic(_do_step)


@inlined
def exchange_signals(
    calls: Calls, function: int, references: np.ndarray, signals: np.ndarray, first: int, end: int
) -> tuple[int, int]:
    """Set or get signals of instances `first` to `end` − 1.

    The FMU reads the values of a setter and leaves them unchanged. It overwrites those of a getter
    and does not read them. Returns the fmi3Status, and the instance that failed, if any.
    """
    count, columns = references.shape[0], signals.shape[1]
    arrays, motors = calls.instances.shape[0] == 1, calls.motors
    for k in range(first, end):
        if calls.instances[k] == 0:
            continue
        if not arrays:
            for signal in range(count):
                calls.values[signal] = signals[motors * signal + k % motors, k // motors]
        values = signals.ctypes.data if arrays else calls.values.ctypes.data
        size = motors * count * columns if arrays else count
        arguments = (calls.instances[k], references.ctypes.data, count, values, size)
        status = exchange(function, arguments)
        if status > FMI_WARNING:
            return status, k
        if not arrays:
            for signal in range(count):
                signals[motors * signal + k % motors, k // motors] = calls.values[signal]
    return FMI_OK, 0


@inlined
def set_inputs(calls: Calls, signals: np.ndarray) -> tuple[int, int]:
    """Set the inputs of all motors; returns as `exchange_signals`."""
    last = calls.instances.shape[0]
    return exchange_signals(calls, calls.functions.set_float64, calls.inputs, signals, 0, last)


@inlined
def step_motors(
    calls: Calls, signals: np.ndarray, first: int, end: int, count: int, dt: float
) -> tuple[int, int]:
    """Step instances `first` to `end` − 1 over `count` ticks, and get their outputs."""
    functions = calls.functions
    for k in range(first, end):
        if calls.instances[k] != 0:
            tick = calls.ticks[k]
            status = do_step(functions.do_step, calls.instances[k], tick * dt, count * dt)
            if status > FMI_WARNING:
                return status, k
            calls.ticks[k] += count
    return exchange_signals(calls, functions.get_float64, calls.outputs, signals, first, end)


@inlined
def step_period(calls: Calls, signals: np.ndarray) -> int:
    """Set the inputs (6, B), have `calls.step_period` step all motors, and get the samples."""
    status, _ = set_inputs(calls, signals)
    if status <= FMI_WARNING:
        status = _call_back(calls.step_period, (0,))
    if status <= FMI_WARNING:
        wanted, sampled = calls.sampled_references, calls.sampled
        size = sampled.shape[0] * sampled.shape[1]
        room = (wanted.ctypes.data, wanted.shape[0], sampled.ctypes.data, size)
        status = exchange(calls.functions.get_float64, (calls.instances[0], *room))
    return status


@inlined
def take_sampled(calls: Calls, signals: np.ndarray, step: int, width: Width) -> None:
    """Put the outputs at the end of a communication step of the period in their place."""
    sampled, rows, motors = calls.sampled, signals.shape[0], calls.motors
    steps = sampled.shape[0] // rows
    for row in range(rows):
        sample = motors * (row // motors * steps + step) + row % motors
        for column in range(0, signals.shape[1], len(width)):
            store(signals, row, column, width, load(sampled, sample, column, width))
