"""Steps that compiled code calls through an address, so that it is not compiled for each of them.

Code that is compiled together with the steps of a controller or of devices is compiled anew for
every combination of their types. A `Bound` step has one type for all: the address of its machine
code, and its parameters as they lie in memory. It is compiled alone, once for each type.
"""

# mypy: disallow-untyped-calls=False
# (numba's extension interface is not typed)
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.core.typing.templates import signature
from numba.extending import intrinsic
from numba.np.arrayobj import make_array
from numpy.typing import NDArray

MEMORY = 4096  # bytes; those of a linear controller take 2,480


class Bound(NamedTuple):
    """A step with its parameters. It is valid as long as the arrays among these exist."""

    address: int
    memory: NDArray[np.uint8]  # (MEMORY,)


def bound(bind: Callable[..., int], *parts: object) -> Bound:
    """Bind parameters by the kernel for their role, which calls what `entry` gives."""
    memory = np.zeros(MEMORY, np.uint8)
    return Bound(bind(memory, parts), memory)


def is_lean(step: Any) -> bool:
    """Whether a step is a `lean_kernel`: no other may be bound, since arrays are not counted."""
    return getattr(step, "targetoptions", {}).get("_nrt") is False


def entry(step: Callable[..., None], *arguments: types.Type) -> tuple[Any, Any]:
    """For kernels: a function that binds a step of such arguments, and one that calls it.

    The first, (memory, parts), copies parts, and gives the address of `step(*parts, *arguments)` as
    a function of the memory and the arguments; the second, (address, memory, values), calls that.
    """
    kinds = types.voidptr, *arguments

    def typed_bind(typingctx: Any, memory: types.Array, parts: Any) -> tuple[Any, Any]:
        function = typingctx.resolve_value_type(step)
        called = typingctx.resolve_function_type(function, (*parts, *arguments), {})

        def emit(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            kept, convention = context.get_value_type(parts), context.call_conv
            data = make_array(memory)(context, builder, args[0]).data
            builder.store(args[1], builder.bitcast(data, kept.as_pointer()))
            size = context.get_abi_sizeof(kept)
            assert size <= MEMORY, f"{parts}: {size} bytes of parameters, expected {MEMORY}"
            kind = convention.get_function_type(types.none, kinds)
            name = builder.module.get_unique_name(f"{builder.function.name}.{step.__name__}")
            made = ir.Function(builder.module, kind, name)
            made.linkage = "internal"
            inner = ir.IRBuilder(made.append_basic_block())
            own, *given = convention.decode_arguments(inner, kinds, made)
            values = inner.load(inner.bitcast(own, kept.as_pointer()))
            code = context.get_function(function, called)
            context.add_linking_libs(getattr(code, "libs", ()))
            code(inner, [*cgutils.unpack_tuple(inner, values, len(parts)), *given])
            convention.return_value(inner, context.get_dummy_value())
            return builder.ptrtoint(made, ir.IntType(64))

        return signature(types.int64, memory, parts), emit

    def typed_call(
        typingctx: Any, address: types.Type, memory: types.Array, values: Any
    ) -> tuple[Any, Any]:
        if tuple(values) != arguments:
            raise TypingError(f"a bound step: got {tuple(values)}, expected {arguments}")

        def emit(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            kind = context.call_conv.get_function_type(types.none, kinds)
            data = make_array(memory)(context, builder, args[1]).data
            given = [data, *cgutils.unpack_tuple(builder, args[2], len(arguments))]
            code = builder.inttoptr(args[0], kind.as_pointer())
            status, _ = context.call_conv.call_function(builder, code, types.none, kinds, given)
            with cgutils.if_unlikely(builder, status.is_error):
                context.call_conv.return_status_propagate(builder, status)
            return context.get_dummy_value()

        return signature(types.none, address, memory, values), emit

    return intrinsic(typed_bind), intrinsic(typed_call)


ROW = types.Array(types.float64, 1, "C")  # an argument: a row of numbers
TABLE = types.Array(types.float64, 2, "C")
