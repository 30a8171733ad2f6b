"""Calls from compiled code to the C functions of FMI 3.0 behind an address.

The address is a run-time integer: the code is compiled once for all FMUs and cached on disk,
which numba refuses for a global ctypes function pointer. All addresses and counts are int64, and
every call returns the fmi3Status.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

# Of fmi3Status; anything above a warning is no result.
FMI_OK, FMI_WARNING, FMI_DISCARD, FMI_ERROR, FMI_FATAL = range(5)

_INT, _LONG, _DOUBLE, _BOOL = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8)
_POINTER = _BOOL.as_pointer()
_C_TYPES = {"p": _POINTER, "n": _LONG, "d": _DOUBLE, "b": _BOOL}


def _call(builder: Any, form: str, address: Any, arguments: list[Any]) -> Any:
    """Call a C function that returns int.

    Args:
        builder: of the code.
        form: a letter per argument: pointer, size_t, double, one byte.
        address: of the function.
        arguments: values; a pointer may be an int64.
    """
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
exchange_3: Any = _caller("ppnpn")
# (anything), of a callback of ctypes, which takes the interpreter's lock.
call_back: Any = _caller("p")


def _do_step(_typing, function, instance, time, step):
    """Call fmi3DoStep at `time` over `step` (s), for good.

    Returns the status, and 1 if the FMU returned early or asks to end the simulation, else 0.
    """

    def codegen(context, builder, signature, arguments):
        flags = [cgutils.alloca_once(builder, _BOOL) for _ in range(3)]
        for flag in flags:
            builder.store(_BOOL(0), flag)
        reached = builder.bitcast(cgutils.alloca_once(builder, _DOUBLE), _POINTER)
        function, *of_step = arguments
        status = _call(builder, "pddbpppp", function, [*of_step, _BOOL(1), *flags, reached])
        _, terminate, early = (builder.load(flag) for flag in flags)
        ended = builder.zext(builder.or_(terminate, early), _LONG)
        return context.make_tuple(builder, signature.return_type, [status, ended])

    kinds = (types.int64, types.int64, types.float64, types.float64)
    return types.Tuple((types.int32, types.int64))(*kinds), codegen


do_step_3: Any = intrinsic(_do_step)
