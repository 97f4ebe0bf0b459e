"""Numbers that an identifier, a controller or an excitation reports about its own result,
and checks of what the parts of an experiment return, which may be classes from elsewhere.

A finding is stored unchanged as a row of the table `diagnostic`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import PartError

# 1: the standard errors are of the estimate only, which may be biased; 0: of the coefficient.
INTERVAL_OF_ESTIMATE = "interval_of_estimate"
TRAINING_TIME = "training_time"  # wall-clock time of the identification, machine code included


@dataclass(frozen=True)
class Finding:
    """A reported number, such as the error at model order `i`.

    For an error surface, `i` is the order and `j` the number of variables. For a Pareto set, `i`
    is the point, `j` the parameter and `label` the name of the parameter. `dof` is a degree of
    freedom or `all`.
    """

    name: str
    dof: str
    value: float | None
    unit: str = ""
    i: int | None = None
    j: int | None = None
    label: str | None = None


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
