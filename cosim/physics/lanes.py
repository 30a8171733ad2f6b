"""L float64 in one vector register, as a number of compiled code: one source for one and for many.

A kernel written with + − · /, comparisons, & and |, `sqrt`, `abs`, `floor`, `select` and `any_lane`
compiles for float64 and for lanes alike. Every lane does the IEEE operations of the scalar in the
scalar's order, nothing is contracted, so that it gets the scalar's bits. Branches that may differ
from lane to lane are written as `select`. How many lanes there are is said by the length of a
tuple, see `width_of`: `load` gives float64 where it is one.
"""

import math
import operator
from collections.abc import Callable
from typing import Any

import llvmlite.binding
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, models, register_model

Width = tuple[int, ...]  # L zeros: numba compiles a kernel for each length of a tuple

_DOUBLE, _BIT, _INDEX = ir.DoubleType(), ir.IntType(1), ir.IntType(32)
_SCALARS = (types.Float, types.Integer)


def width_of(lanes: int) -> Width:
    """Type with the number of lanes, a power of two, for compiled code."""
    return (0,) * lanes


def host_lanes() -> int:
    """Return the number of lanes of a register of this processor that numba compiles for."""
    # what numba is set to compile for, or what the processor can do
    told = numba.core.config.CPU_FEATURES  # pyright: ignore[reportAttributeAccessIssue]
    features = told or llvmlite.binding.get_host_cpu_features().flatten()
    on = features.split(",")
    return 8 if "+avx512f" in on else 4 if "+avx2" in on else 2


class _Vector(types.Type):
    """Common base of lanes and masks: one element may represent all."""

    elements: tuple[type, ...]

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(name=f"{type(self).__name__}{count}")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Any:
        return Conversion.safe if isinstance(other, self.elements) else None

    def unify(self, typingctx: Any, other: types.Type) -> Any:
        return self if isinstance(other, self.elements) else None


class Lanes(_Vector):
    """`count` float64."""

    elements = _SCALARS


class Mask(_Vector):
    """`count` truth values."""

    elements = (types.Boolean,)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Lanes) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(_DOUBLE, fe_type.count))


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Mask) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(_BIT, fe_type.count))


def _spread(builder: Any, value: Any, count: int) -> Any:
    vector = ir.VectorType(value.type, count)
    if isinstance(value, ir.Constant):
        return ir.Constant(vector, [value] * count)
    nothing = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(nothing, value, _INDEX(0))
    return builder.shuffle_vector(
        first, nothing, ir.Constant(ir.VectorType(_INDEX, count), [_INDEX(0)] * count)
    )


@lower_cast(types.Float, Lanes)
@lower_cast(types.Integer, Lanes)
def _number_to_lanes(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    return _spread(builder, context.cast(builder, value, given, types.float64), wanted.count)


@lower_cast(types.Boolean, Mask)
def _truth_to_mask(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    truth = context.cast(builder, value, given, types.boolean)
    return _spread(
        builder, builder.trunc(truth, _BIT) if truth.type != _BIT else truth, wanted.count
    )


def _define(
    function: Any, arguments: int, kind: type[_Vector], result: Any, emit: Callable
) -> None:
    """Teach numba an operation on `kind`, elements next to which are spread."""

    @infer_global(function)  # pyright: ignore[reportOptionalCall]
    class _Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            vector = next((a for a in args if isinstance(a, kind)), None)
            fits = len(args) == arguments and all(
                isinstance(a, (kind, *kind.elements)) for a in args
            )
            if vector is None or not fits:
                return None
            return signature(result(vector.count), *(vector,) * arguments)

    @lower_builtin(function, *(kind,) * arguments)
    def _lower(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return emit(builder, *args)


def _call(name: str) -> Callable:
    """An instruction of LLVM that acts on every lane."""

    def emit(builder: Any, x: Any) -> Any:
        lanes = f"v{x.type.count}f64" if isinstance(x.type, ir.VectorType) else "f64"
        function = ir.FunctionType(x.type, [x.type])
        return builder.call(
            cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.{lanes}"), [x]
        )

    return emit


def _compared(how: str) -> Callable:
    return lambda builder, x, y: builder.fcmp_ordered(how, x, y)


_define(operator.add, 2, Lanes, Lanes, lambda builder, x, y: builder.fadd(x, y))
_define(operator.iadd, 2, Lanes, Lanes, lambda builder, x, y: builder.fadd(x, y))
_define(operator.sub, 2, Lanes, Lanes, lambda builder, x, y: builder.fsub(x, y))
_define(operator.mul, 2, Lanes, Lanes, lambda builder, x, y: builder.fmul(x, y))
_define(operator.truediv, 2, Lanes, Lanes, lambda builder, x, y: builder.fdiv(x, y))
_define(operator.neg, 1, Lanes, Lanes, lambda builder, x: builder.fneg(x))
_define(math.sqrt, 1, Lanes, Lanes, _call("sqrt"))
_define(abs, 1, Lanes, Lanes, _call("fabs"))
for _operator, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="),
    (operator.eq, "=="),
):  # fmt: skip
    _define(_operator, 2, Lanes, Mask, _compared(_sign))
_define(operator.and_, 2, Mask, Mask, lambda builder, x, y: builder.and_(x, y))
_define(operator.or_, 2, Mask, Mask, lambda builder, x, y: builder.or_(x, y))


def _floor(_typing, x):
    """Largest whole number not above x, as a float."""

    def codegen(_context, builder, _signature, arguments):
        return _call("floor")(builder, *arguments)

    number = x if isinstance(x, Lanes) else types.float64
    return number(number), codegen


def _select(_typing, condition, yes, no):
    """`yes` where the condition holds, else `no`; both are computed."""

    def codegen(_context, builder, _signature, arguments):
        return builder.select(*arguments)

    number = Lanes(condition.count) if isinstance(condition, Mask) else types.float64
    return number(condition, number, number), codegen


def _any_lane(_typing, condition):
    """Return whether a condition holds in any lane."""

    def codegen(_context, builder, _signature, arguments):
        if not isinstance(condition, Mask):
            return arguments[0]
        bits = ir.IntType(condition.count)
        return builder.icmp_unsigned("!=", builder.bitcast(arguments[0], bits), bits(0))

    return types.boolean(condition), codegen


def _place(context: Any, builder: Any, kinds: Any, values: Any, count: int) -> Any:
    """Address of [row, column] of a C-contiguous (rows, columns) float64 array, as lanes."""
    array = context.make_array(kinds[0])(context, builder, values[0])
    row, column = (
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(values[1:3], kinds[1:3], strict=True)
    )
    columns = cgutils.unpack_tuple(builder, array.shape)[1]
    place = builder.gep(array.data, [builder.add(builder.mul(row, columns), column)])
    vector = _DOUBLE if count == 1 else ir.VectorType(_DOUBLE, count)
    return builder.bitcast(place, vector.as_pointer())


def _load(_typing, array, row, column, width):
    """Neighbours array[row, column], array[row, column + 1] … of a C-contiguous array."""
    count = len(width)

    def codegen(context, builder, signature, arguments):
        value = builder.load(_place(context, builder, signature.args, arguments, count))
        value.align = 8
        return value

    number = types.float64 if count == 1 else Lanes(count)
    return number(array, row, column, width), codegen


def _store(_typing, array, row, column, width, value):
    """Write neighbours array[row, column], array[row, column + 1] … of a C-contiguous array."""
    count = len(width)

    def codegen(context, builder, signature, arguments):
        place = _place(context, builder, signature.args, arguments, count)
        builder.store(arguments[4], place).align = 8
        return context.get_dummy_value()

    number = types.float64 if count == 1 else Lanes(count)
    return types.void(array, row, column, width, number), codegen


floor: Any = intrinsic(_floor)
select: Any = intrinsic(_select)
any_lane: Any = intrinsic(_any_lane)
load: Any = intrinsic(_load)
store: Any = intrinsic(_store)
