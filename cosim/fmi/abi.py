"""Calls from compiled code to the C functions of FMI 2.0 and 3.0 behind an address.

The address is a run-time integer: the code is compiled once for all FMUs and cached on disk,
which numba refuses for a global ctypes function pointer. All addresses and counts are int64, and
every call returns the fmi2Status or fmi3Status.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

# Of fmi2Status and fmi3Status; anything above a warning is no result.
FMI_OK, FMI_WARNING, FMI_DISCARD, FMI_ERROR, FMI_FATAL = range(5)

_INT, _LONG, _DOUBLE, _BOOL = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8)
_POINTER = _BOOL.as_pointer()
_C_TYPES = {"p": _POINTER, "n": _LONG, "d": _DOUBLE, "b": _BOOL, "i": _INT}


def _call(builder: Any, form: str, address: Any, arguments: list[Any]) -> Any:
    """Call a C function that returns int.

    Args:
        builder: of the code.
        form: a letter per argument: pointer, size_t, double, one byte, int.
        address: of the function.
        arguments: values; int64 where the function takes other integers or a pointer.
    """
    kinds = [_C_TYPES[letter] for letter in form]
    function = builder.inttoptr(address, ir.FunctionType(_INT, kinds).as_pointer())
    passed = []
    for value, kind in zip(arguments, kinds, strict=True):
        if kind is _POINTER and value.type != _POINTER:
            passed.append(builder.inttoptr(value, _POINTER))
        else:
            passed.append(builder.trunc(value, kind) if kind in (_BOOL, _INT) else value)
    return builder.call(function, passed)


def _caller(form: str) -> Any:
    """An intrinsic (address, arguments as a tuple) -> status of functions of one form."""

    def typed(_typing, address, arguments):
        def codegen(_context, builder, _signature, values):
            return _call(builder, form, values[0], cgutils.unpack_tuple(builder, values[1]))

        return types.int32(types.int64, arguments), codegen

    return intrinsic(typed)


# (instance), of changes of mode; (instance, place of the state), of saving and restoring.
change_mode: Any = _caller("p")
exchange_state: Any = _caller("pp")
# (instance, references, variables, values, and of FMI 3.0 their number), of getters and setters.
exchange_2: Any = _caller("ppnp")
exchange_3: Any = _caller("ppnpn")
# (instance, time, step, whether the state before it will not be restored), of FMI 2.0.
do_step_2: Any = _caller("pddi")
# (instance, kind, place of the answer), of FMI 2.0.
ask_status_2: Any = _caller("pip")
# (instance, five places of a byte, place of a double), of FMI 3.0.
update_discrete_states: Any = _caller("p" * 7)
# (anything), of a callback of ctypes, which takes the interpreter's lock.
call_back: Any = _caller("p")
# (clock, place of seconds and nanoseconds), of POSIX.
read_clock: Any = _caller("ip")


def _do_step(_typing, function, instance, time, step, final):
    """Call fmi3DoStep at `time` over `step` (s).

    `final` is 1 if the state before the step will not be restored. Returns the status, 1 or 0 for
    whether events are to be handled, the simulation is to end, and the FMU returned early, and the
    time (s) it reached.
    """
    results = types.Tuple((types.int32, *(types.int64,) * 3, types.float64))

    def codegen(context, builder, signature, arguments):
        function, instance, time, step, final = arguments
        flags = [cgutils.alloca_once(builder, _BOOL) for _ in range(3)]
        reached = cgutils.alloca_once(builder, _DOUBLE)
        for flag in flags:
            builder.store(_BOOL(0), flag)
        builder.store(time, reached)
        places = [*flags, builder.bitcast(reached, _POINTER)]
        status = _call(builder, "pddbpppp", function, [instance, time, step, final, *places])
        told = [builder.zext(builder.load(flag), _LONG) for flag in flags]
        found = [status, *told, builder.load(reached)]
        return context.make_tuple(builder, signature.return_type, found)

    kinds = (types.int64, types.int64, types.float64, types.float64, types.int64)
    return results(*kinds), codegen


do_step_3: Any = intrinsic(_do_step)
