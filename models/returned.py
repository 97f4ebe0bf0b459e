"""Checks of what the parts of an experiment return, which may be classes from elsewhere."""

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import PartError


def name_of(part: object) -> str:
    """The class of a part as `_target_` names it."""
    return f"{type(part).__module__}.{type(part).__qualname__}"


def checked_array(
    part: object, method: str, value: object, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """An array that a method of a part has returned.

    Raises PartError if it is of another shape, or not of finite numbers.
    """
    where = f"{name_of(part)}.{method}"
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise PartError(f"{where}: got a {type(value).__name__}, expected {shape}") from None
    if array.shape != shape:
        raise PartError(f"{where}: got shape {array.shape}, expected {shape}")
    finite = np.isfinite(array)
    if not finite.all():
        first = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise PartError(f"{where}: got {array[first]} at {first}, expected finite numbers")
    return array
