"""What is declared as a range is checked where an object is made."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from annotated_types import Ge, Gt

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, Positive, PositiveInt, check_ranges


@dataclass(frozen=True)
class Filter:
    window_s: Positive = 1.0
    order: PositiveInt | Literal["gap"] = 1
    horizon: Annotated[int, Ge(2)] = 2
    factor: Annotated[float, Gt(1)] | None = None
    gains: tuple[NotNegative, ...] = ()
    weights: tuple[Positive, ...] | None = None

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class Cascade(Filter):
    stages: PositiveInt = 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window_s": 0.0}, "window_s must be positive, got 0"),
        ({"window_s": float("nan")}, "window_s must be positive, got nan"),
        ({"order": 0}, "order must be at least 1, got 0"),
        ({"horizon": 1}, "horizon must be at least 2, got 1"),
        ({"factor": 1.0}, "factor must be above 1 or null, got 1"),
        ({"gains": (1.0, -0.5)}, "gains must not be negative, got [1.0, -0.5]"),
        ({"weights": ()}, "weights must be positive or null, got []"),
        ({"stages": 0}, "stages must be at least 1, got 0"),
    ],
)
def test_out_of_range(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Cascade(**options)
    assert str(caught.value) == message


def test_in_range() -> None:
    Cascade(order="gap", factor=1.5, gains=(0.0, 1.0), weights=(0.1,))
