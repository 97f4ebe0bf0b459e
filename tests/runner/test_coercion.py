"""Values from a configuration become what the annotations say, or are refused by name."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.coercion import coerce

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Rudder:
    area_m2: float


@pytest.mark.parametrize(
    ("value", "annotation", "result"),
    [
        (1, float, 1.0),
        (1.5, float, 1.5),
        (2, int, 2),
        (True, bool, True),
        ("a", str, "a"),
        ("a/b", Path, Path("a/b")),
        (None, float | None, None),
        (3, float | None, 3.0),
        ("ls", Literal["ls", "plsr"], "ls"),
        ("auto", float | Literal["auto"], "auto"),
        ([1, 2.5], tuple[float, ...], (1.0, 2.5)),
        ([1, "x"], tuple[float, str], (1.0, "x")),
        ([[1], [2]], tuple[tuple[float, ...], ...], ((1.0,), (2.0,))),
        ([1], list[float], [1.0]),
        ([1], Sequence[float], (1.0,)),
        ({"u": 1}, dict[str, float], {"u": 1.0}),
        ({"u": {"v": [1]}}, dict[str, Any], {"u": {"v": [1]}}),
        (None, None, None),
    ],
)
def test_takes(value: Any, annotation: Any, result: Any) -> None:
    taken = coerce(value, annotation if annotation is not None else type(None), "key")
    assert taken == result
    assert type(taken) is type(result)


@pytest.mark.parametrize(
    ("value", "annotation", "message"),
    [
        ("abc", float, "key: got 'abc', expected a number"),
        ("1", float, "key: got '1', expected a number"),
        (True, float, "key: got true, expected a number"),
        (True, int, "key: got true, expected an integer"),
        (1.0, int, "key: got 1.0, expected an integer"),
        (1, bool, "key: got 1, expected true or false"),
        (None, float, "key: got null, expected a number"),
        (3, str, "key: got 3, expected text"),
        ("", Path, "key: got '', expected a path"),
        ("abc", float | None, "key: got 'abc', expected a number or null"),
        ("x", float | Literal["auto"], "key: got 'x', expected a number or one of auto"),
        ("x", Literal["ls", "plsr"], "key: got 'x', expected one of ls, plsr"),
        ("x", Literal["ls"] | None, "key: got 'x', expected one of ls or null"),
        (3, tuple[float, ...], "key: got 3, expected a list (a number each)"),
        ([1], tuple[float, float], "key: got [1], expected a list of 2"),
        ([1, "x"], tuple[float, ...], "key[1]: got 'x', expected a number"),
        ([1, "x"], tuple[float, ...] | None, "key[1]: got 'x', expected a number"),
        ([1], dict[str, float], "key: got [1], expected a group of options"),
        ({"u": "x"}, dict[str, float], "key.u: got 'x', expected a number"),
        ({2: 1.0}, dict[str, float], "key.2: got 2, expected text"),
        (3, Rudder, "key: got 3, expected a Rudder"),
        (math.nan, float | None, "key: got nan, expected a finite number"),
        (math.inf, Any, "key: got inf, expected a finite number"),
        (10**400, float, "key: got 1000"),
    ],
)
def test_refuses(value: Any, annotation: Any, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        coerce(value, annotation, "key")
    assert str(caught.value).startswith(message)
    assert len(str(caught.value)) < 200


def test_arrays() -> None:
    array = coerce([[1, 2.5], [3, 4]], Array, "key")
    assert array.dtype == np.float64
    np.testing.assert_array_equal(array, [[1.0, 2.5], [3.0, 4.0]])
    assert not array.flags.writeable
    assert coerce([1, 2], Indices, "key").dtype == np.int64
    assert coerce([], Array, "key").shape == (0,)


@pytest.mark.parametrize(
    ("value", "annotation", "message"),
    [
        (3, Array, "key: got 3, expected a list of numbers"),
        ([1, "x"], Array, "key[1]: got 'x', expected a number"),
        ([[1], [2, math.nan]], Array, "key[1][1]: got nan, expected a finite number"),
        ([[1], [2, 3]], Array, "key: rows of different lengths, expected equal ones"),
        ([1.5], Indices, "key[0]: got 1.5, expected an integer"),
    ],
)
def test_refuses_arrays(value: Any, annotation: Any, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        coerce(value, annotation, "key")
    assert str(caught.value) == message


@given(st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**53), 2**53))
def test_no_number_is_changed(number: float) -> None:
    assert coerce(number, float, "key") == number


trees = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=6,
)
annotations = st.sampled_from(
    [
        *(float, int, bool, str, Path, Array, Rudder, Literal["a"], float | None),
        *(tuple[float, ...], dict[str, float], tuple[int, str], list[Array]),
        float | Literal["b"] | tuple[int, ...],
    ]
)


@given(trees, annotations)
def test_only_ever_refuses_by_name(value: Any, annotation: Any) -> None:
    """Whatever is given, a value comes out or one line that begins with the key."""
    said = "key"
    try:
        coerce(value, annotation, "key")
    except ConfigurationError as error:
        said = str(error)
    assert said.startswith("key")
    assert "\n" not in said
