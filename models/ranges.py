"""Ranges of parameters, declared with the fields of a dataclass and checked on construction.

    window_s: Positive
    horizon: Annotated[int, Ge(2), Le(1000)]
    lowpass_hz: Positive | None

pydantic reads the same annotations for the schema of all options.
"""

from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

from seatrial.models.errors import ConfigurationError

Bound = Gt | Ge | Le | Lt
MOST_REPEATS = 1_000_000
Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Gt(0), Lt(1)]
Length = Annotated[float, Ge(0.1), Le(1000.0)]  # of a hull [m]
Density = Annotated[float, Ge(900.0), Le(1100.0)]  # of water [kg/m^3]
PositiveInt = Annotated[int, Ge(1), Le(MOST_REPEATS)]
NotNegativeInt = Annotated[int, Ge(0)]
Replicates = Annotated[int, Ge(20), Le(MOST_REPEATS)]  # of a bootstrap
Folds = Annotated[int, Ge(2), Le(1000)]  # of a cross-validation


def check_ranges(parameters: object) -> None:
    """Raise ConfigurationError if a field of a dataclass, or an element of it, is out of range."""
    kind: Any = type(parameters)
    for name, bound, optional in _bounds(kind):
        value = getattr(parameters, name)
        if value is None or isinstance(value, str):  # allowed in place of a number
            continue
        items = (value or (0.0,)) if isinstance(value, tuple) else (value,)
        if not all(_inside(item, bound) for item in items):
            shown = list(value) if isinstance(value, tuple) else f"{value:g}"
            null = " or null" if optional else ""
            raise ConfigurationError(f"{name} must {in_words(bound)}{null}, got {shown}")


def in_words(bound: Bound) -> str:
    """The range in words, to follow `must` in a message."""
    if isinstance(bound, Gt):
        return "be positive" if bound.gt == 0 else f"be above {bound.gt}"
    if isinstance(bound, Le):
        return f"be at most {bound.le}"
    if isinstance(bound, Lt):
        return f"be below {bound.lt}"
    return "not be negative" if bound.ge == 0 else f"be at least {bound.ge}"


def _inside(value: Any, bound: Any) -> bool:
    if isinstance(bound, Le):
        return bool(value <= bound.le)
    if isinstance(bound, Lt):
        return bool(value < bound.lt)
    return bool(value > bound.gt if isinstance(bound, Gt) else value >= bound.ge)


@cache
def _bounds(cls: Any) -> list[tuple[str, Bound, bool]]:
    """Name and bound of every field, and whether the field may be None."""
    hints = get_type_hints(cls, include_extras=True)
    return [
        (name, bound, type(None) in get_args(_without_marks(hint)))
        for name, hint in hints.items()
        for bound in _declared(hint)
    ]


def _declared(hint: object) -> list[Bound]:
    """The bounds declared for a type, for its alternatives and for its elements."""
    own = [bound for bound in getattr(hint, "__metadata__", ()) if isinstance(bound, Bound)]
    inner = get_args(_without_marks(hint))
    return own + [bound for part in inner for bound in _declared(part)]


def _without_marks(hint: Any) -> object:
    """The type without what is annotated to it."""
    return hint.__origin__ if get_origin(hint) is Annotated else hint
