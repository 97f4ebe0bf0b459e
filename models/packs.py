"""A number type for numba: a pack of WIDTH numbers that are processed in parallel.

A kernel compiled for arrays of packs computes WIDTH candidates at once with the vector
instructions of the processor. Its source is the same equation that is compiled for arrays of
numbers. Packs support addition, subtraction, multiplication, division and comparison; a number
combined with a pack is broadcast to WIDTH equal numbers. A comparison gives a mask, and
`where(mask, a, b)` replaces a branch. `abs`, `np.sqrt`, `np.floor`, `np.exp`, `np.cos`, `np.sin`
and `np.arctan2` accept packs.

Packs exist in compiled code only, where `as_packs` views an array of numbers, shape (..., WIDTH),
as an array of packs, shape (...).
"""

# mypy: allow-untyped-calls, allow-untyped-decorators
# (numba's extension interface is not typed)
import operator
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.core.base import BaseContext
from numba.core.datamodel import models
from numba.core.datamodel.manager import DataModelManager
from numba.core.imputils import impl_ret_borrowed
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.context import BaseContext as TypingContext
from numba.core.typing.templates import AbstractTemplate, Signature, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, overload, register_model
from numba.np.arrayobj import make_array, populate_array
from numpy.typing import NDArray

from seatrial.models.compiled import LEAN, tuple_of
from seatrial.models.elementary import angle_of, cosine_and_sine, where

Array = NDArray[np.float64]
T = TypeVar("T")
WIDTH = 32
VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
FLAGS = ir.VectorType(ir.IntType(1), WIDTH)
Emitter = Callable[..., ir.Value]  # of a builder and the values of the arguments
Typed = tuple[Signature, Callable[..., ir.Value]]  # what an `intrinsic` function gives


class Pack(types.Type):
    """numba type of WIDTH numbers; a single number converts to a pack of equal numbers."""

    def __init__(self) -> None:
        super().__init__(name=f"Pack{WIDTH}")

    def can_convert_from(self, typingctx: TypingContext, other: types.Type) -> Conversion | None:
        """A number can be used where a pack is expected."""
        return Conversion.safe if isinstance(other, types.Number) else None

    def unify(self, typingctx: TypingContext, other: types.Type) -> "Pack | None":
        """A variable that is assigned both a number and a pack is a pack."""
        return self if isinstance(other, types.Number) else None


class Mask(types.Type):
    """numba type of WIDTH truth values, the result of comparing packs."""

    def __init__(self) -> None:
        super().__init__(name=f"Mask{WIDTH}")


PACK, MASK = Pack(), Mask()
PACKS = types.Array(PACK, 1, "C", aligned=False)


@register_model(Pack)
class _PackModel(models.PrimitiveModel):
    def __init__(self, manager: DataModelManager, pack: Pack) -> None:
        super().__init__(manager, pack, VECTOR)


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: DataModelManager, mask: Mask) -> None:
        super().__init__(manager, mask, FLAGS)


@lower_cast(types.Number, Pack)
def _broadcast(
    context: BaseContext, builder: ir.IRBuilder, source: types.Number, target: Pack, value: ir.Value
) -> ir.Value:
    """Copy a number to every lane of a vector."""
    number = context.cast(builder, value, source, types.float64)
    index = ir.IntType(32)
    undefined = ir.Constant(VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, number, index(0))
    lanes = ir.Constant(ir.VectorType(index, WIDTH), [index(0)] * WIDTH)
    return builder.shuffle_vector(first, undefined, lanes)


def _define(function: Callable[..., object], result: types.Type, count: int, emit: Emitter) -> None:
    """Define a function of `count` packs, or packs and numbers, by LLVM instructions."""

    class Template(AbstractTemplate):
        key = function

        def generic(
            self, args: tuple[types.Type, ...], kws: dict[str, types.Type]
        ) -> Signature | None:
            packs = all(arg == PACK or isinstance(arg, types.Number) for arg in args)
            if len(args) == count and packs and PACK in args:
                typed: Signature = signature(result, *([PACK] * count))
                return typed
            return None

    infer_global(function)(Template)
    lower_builtin(function, *([PACK] * count))(
        lambda context, builder, sig, args: emit(builder, *args)
    )


def _of_llvm(name: str) -> Emitter:
    """Emitter of an LLVM intrinsic function of one pack."""

    def emit(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
        kind = ir.FunctionType(VECTOR, [VECTOR])
        full = f"llvm.{name}.v{WIDTH}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, full), [value])

    return emit


def _comparison(sign: str) -> Emitter:
    """Emitter of a comparison; as for numbers, every comparison with NaN but `!=` is false."""
    ordered = sign != "!="
    return lambda builder, a, b: (
        builder.fcmp_ordered(sign, a, b) if ordered else builder.fcmp_unordered(sign, a, b)
    )


for _name, _instruction in {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}.items():
    for _operator in (getattr(operator, _name), getattr(operator, f"i{_name}")):
        _define(_operator, PACK, 2, lambda b, x, y, _i=_instruction: getattr(b, _i)(x, y))
for _name, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}.items():
    _define(getattr(operator, _name), MASK, 2, _comparison(_sign))
_define(operator.neg, PACK, 1, lambda builder, value: builder.fneg(value))
for _function, _name in ((abs, "fabs"), (np.sqrt, "sqrt"), (np.floor, "floor"), (np.exp, "exp")):
    _define(_function, PACK, 1, _of_llvm(_name))


def _typed_select(
    typingctx: TypingContext, mask: types.Type, a: types.Type, b: types.Type
) -> Typed:
    return PACK(MASK, PACK, PACK), lambda context, builder, sig, args: builder.select(*args)


_select = cast(Callable[..., Array], intrinsic(_typed_select))
_overload = partial(overload, jit_options=LEAN)
_overload(where)(
    lambda mask, a, b: (lambda mask, a, b: _select(mask, a, b)) if mask == MASK else None
)
_overload(np.cos)(lambda x: (lambda x: cosine_and_sine(x)[0]) if x == PACK else None)
_overload(np.sin)(lambda x: (lambda x: cosine_and_sine(x)[1]) if x == PACK else None)
_overload(np.arctan2)(lambda y, x: (lambda y, x: angle_of(y, x)) if PACK in (y, x) else None)


def _typed_view(typingctx: TypingContext, numbers: Any) -> Typed:
    if isinstance(numbers, types.BaseNamedTuple):
        views = [_typed_view(typingctx, array) for array in cast(Any, numbers)]
        whole = types.NamedTuple([sig.return_type for sig, _ in views], tuple_of(numbers))

        def emit_each(
            context: BaseContext, builder: ir.IRBuilder, sig: Signature, args: Sequence[ir.Value]
        ) -> ir.Value:
            parts = zip(views, cgutils.unpack_tuple(builder, args[0]), strict=True)
            made = [view(context, builder, own, [part]) for (own, view), part in parts]
            return context.make_tuple(builder, whole, made)

        return whole(numbers), emit_each

    packs = types.Array(PACK, numbers.ndim - 1, "C", aligned=False)

    def emit(
        context: BaseContext, builder: ir.IRBuilder, sig: Signature, args: Sequence[ir.Value]
    ) -> ir.Value:
        source = make_array(numbers)(context, builder, args[0])
        view = make_array(packs)(context, builder)
        populate_array(
            view,
            data=builder.bitcast(source.data, view.data.type),
            shape=cgutils.unpack_tuple(builder, source.shape)[:-1],
            strides=cgutils.unpack_tuple(builder, source.strides)[:-1],
            itemsize=context.get_constant(types.intp, context.get_abi_sizeof(VECTOR)),
            meminfo=source.meminfo,
            parent=source.parent,
        )
        return impl_ret_borrowed(context, builder, packs, view._getvalue())

    return packs(numbers), emit


as_packs = cast(Callable[[T], T], intrinsic(_typed_view))
"""View a contiguous array of numbers, shape (..., WIDTH), as an array of packs, shape (...).

The view holds a reference to the buffer so that it is not freed while it is in use. Named tuples of
arrays are viewed as such of arrays of packs.
"""
