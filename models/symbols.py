"""A number type for Python that records operations, so that an equation can leave as source text.

A kernel compiled for packs (`packs.py`) computes many numbers at once from the same source; the
Python function behind it, called with symbols, gives the expression of its result. As with packs,
no branch may depend on a symbol; `where` is used instead. Loops of a fixed length are unrolled,
and operations with 0 and 1 are left out, so that an expression holds what a vessel has.

Equal operations on equal operands are one symbol: common subexpressions are shared. Names of
operations are those of numpy (`add`, `cos`, `where`); `entry` is an entry of a named argument.

A printer, or a translation into another library, is a function `apply` for `evaluate`, which walks
over every symbol once, operands first. With numpy, and with CasADi, whose names are the same but
for a few:

    def apply(operation, operands, uses):
        if operation == "entry":
            name, index = operands
            return arguments[name][index]
        return getattr(np, operation)(*operands)

A printer of source text returns texts, and assigns those with several uses to variables
(`seatrial.runner.export.equations`).
"""

import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from types import FunctionType
from typing import Any, NoReturn, TypeVar, cast
from weakref import WeakValueDictionary

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from seatrial.models.compiled import in_python
from seatrial.models.elementary import angle_of, where
from seatrial.models.errors import ConfigurationError

Value = TypeVar("Value")
F = TypeVar("F", bound=Callable[..., object])
ENTRY = "entry"
OPERATIONS = frozenset({
    "add", "subtract", "multiply", "divide", "negative", "absolute", "minimum", "maximum",
    "less", "less_equal", "greater", "greater_equal", "sqrt", "exp", "cos", "sin", "arctan2",
})  # fmt: skip


class Symbol(NDArrayOperatorsMixin):
    """An operation on numbers and other symbols, or an entry of a named argument."""

    __slots__ = ("__weakref__", "number", "operands", "operation")
    __hash__ = object.__hash__

    def __init__(self, operation: str, operands: Sequence[Any]) -> None:
        self.operation, self.operands, self.number = operation, tuple(operands), next(_NUMBERS)

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *operands: Any, **options: Any
    ) -> "Symbol | float":
        """The operation; one in place (`out`) gives a new symbol as well."""
        if ufunc.__name__ not in OPERATIONS or method != "__call__" or {*options} - {"out"}:
            _refuse(f"the operation {ufunc.__name__}", ", ".join(sorted(OPERATIONS)))
        return _simplified(ufunc.__name__, *operands)

    def __bool__(self) -> bool:
        _refuse("a branch that depends on the motion", "where(mask, a, b)")

    def __float__(self) -> float:
        _refuse("a function of single numbers", "one of numpy")


_NUMBERS = count()  # operands have lower numbers than what is made of them
_KNOWN: WeakValueDictionary[tuple[object, ...], Symbol] = WeakValueDictionary()


def entries(name: str, n: int) -> np.ndarray[Any, Any]:
    """The entries of an argument of an equation, an object array (n,)."""
    return np.array([_symbol(ENTRY, name, i) for i in range(n)], dtype=object)


def in_symbols(function: F) -> F:
    """The Python function of a kernel, with those of all kernels that it calls, for symbols."""
    return cast(F, _plain(function, {}))


def evaluate(
    outputs: Sequence[Symbol | float], apply: Callable[[str, Sequence[Any], int], Value]
) -> list[Value | float]:
    """The values of expressions, from those of their operands.

    Args:
        outputs: symbols, or numbers, which are their own values.
        apply: returns the value of an operation, from its name, the values of its operands and the
            number of its uses; called once for each symbol.
    """
    reached: dict[int, Symbol] = {}
    open_ones = [*outputs]
    uses = Counter(o.number for o in outputs if isinstance(o, Symbol))
    while open_ones:
        symbol = open_ones.pop()
        if isinstance(symbol, Symbol) and symbol.number not in reached:
            reached[symbol.number] = symbol
            open_ones += symbol.operands
            uses.update(o.number for o in symbol.operands if isinstance(o, Symbol))
    values: dict[int, Value] = {}

    def value(of: Any) -> Any:
        return values[of.number] if isinstance(of, Symbol) else of

    for number in sorted(reached):
        symbol = reached[number]
        values[number] = apply(symbol.operation, [*map(value, symbol.operands)], uses[number])
    return [*map(value, outputs)]


def _symbol(operation: str, *operands: Any) -> Symbol:
    """The symbol of an operation; the same one for the same operands."""
    key = (operation, *(id(o) if isinstance(o, Symbol) else (o,) for o in operands))
    known = _KNOWN.get(key)
    if known is None:
        known = _KNOWN[key] = Symbol(operation, operands)
    return known


def _simplified(operation: str, *operands: Any) -> Symbol | float:
    """An operation without what has no effect."""
    first, last = operands[0], operands[-1]
    constants = [None if isinstance(operand, Symbol) else float(operand) for operand in operands]
    parts = zip(operands, constants, strict=True)
    match operation, *constants:
        case ("multiply", 0.0, _) | ("multiply", _, 0.0) | ("divide", 0.0, _):
            return 0.0
        case ("add" | "subtract", _, 0.0) | ("multiply" | "divide", _, 1.0):
            return cast(Symbol, first)
        case ("add", 0.0, _) | ("multiply", 1.0, _):
            return cast(Symbol, last)
        case ("subtract", 0.0, _):
            return _symbol("negative", last)
    return _symbol(operation, *(operand if c is None else c for operand, c in parts))


def _select(mask: Any, a: Any, b: Any) -> Any:
    """`a` where the mask is true, else `b`."""
    return _symbol("where", mask, a, b) if isinstance(mask, Symbol) else a if mask else b


SPELLED: Mapping[object, object] = {where: _select, in_python(angle_of): np.arctan2}


def _plain(value: Any, known: dict[object, Any]) -> Any:
    """A function in which the kernels are Python functions; anything else as it is."""
    if isinstance(value, dict):  # of steps by the type of what they are for
        return {key: _plain(item, known) for key, item in value.items()}
    value = in_python(value)
    if not isinstance(value, FunctionType):
        return value
    if value in SPELLED:
        return SPELLED[value]
    if value not in known:
        scope, code = dict(value.__globals__), value.__code__
        known[value] = FunctionType(
            code, scope, value.__name__, value.__defaults__, value.__closure__
        )
        scope |= {name: _plain(scope[name], known) for name in code.co_names if name in scope}
    return known[value]


def _refuse(what: str, expected: str) -> NoReturn:
    """Raise ConfigurationError for what is no operation on symbols, with its place."""
    frame = sys._getframe(2)
    while frame.f_back and frame.f_globals["__name__"].startswith(("numpy", __name__)):
        frame = frame.f_back
    place = f"{frame.f_globals['__name__']}, line {frame.f_lineno}"
    raise ConfigurationError(f"{place}: got {what}, which has no expression, expected {expected}")
