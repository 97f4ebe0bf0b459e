"""Values from a configuration become what the annotations say, or are refused by name."""

import math
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegativeInt, Positive
from seatrial.runner.configuration.config import build_as
from tests.trials import composed


@dataclass(frozen=True)
class Rudder:
    area_m2: float


def coerce(value: Any, annotation: Any) -> Any:
    """`value` as an option `key` of a dataclass that declares it as `annotation`."""
    holder = make_dataclass("Holder", [("key", annotation)], frozen=True)
    return build_as(holder, {"key": value}, "").key


TAKEN: list[tuple[Any, Any, Any]] = [
    *((1, float, 1.0), (2, int, 2), ("a", str, "a"), ("a/b", Path, Path("a/b"))),
    *((None, float | None, None), (3, float | None, 3.0), (None, None, None)),
    *(("ls", Literal["ls", "plsr"], "ls"), ("auto", float | Literal["auto"], "auto")),
    *(([1, 2.5], tuple[float, ...], (1.0, 2.5)), ([1, "x"], tuple[float, str], (1.0, "x"))),
    *(([[1], [2]], tuple[tuple[float, ...], ...], ((1.0,), (2.0,))), ([1], list[float], [1.0])),
    ({"u": 1}, dict[str, float], {"u": 1.0}),
    ({"u": {"v": [1]}}, dict[str, Any], {"u": {"v": [1]}}),
]
REFUSED: list[tuple[Any, Any, str]] = [
    ("abc", float, "key: got 'abc', expected a number"),
    (True, float, "key: got true, expected a number"),
    (1.0, int, "key: got 1.0, expected an integer"),
    (1, bool, "key: got 1, expected true or false"),
    (None, float, "key: got null, expected a number"),
    (3, str, "key: got 3, expected text"),
    ("", Path, "key: got '', expected a path"),
    ("x", float | Literal["auto"], "key: got 'x', expected a number or one of auto"),
    ("x", Literal["ls", "plsr"], "key: got 'x', expected one of ls, plsr"),
    (3, tuple[float, ...], "key: got 3, expected a list"),
    ([1], tuple[float, float], "key: got [1], expected a list of 2"),
    ([1, "x"], tuple[float, ...], "key[1]: got 'x', expected a number"),
    ([1], dict[str, float], "key: got [1], expected a group of options"),
    ({"u": "x"}, dict[str, float], "key.u: got 'x', expected a number"),
    ({2: 1.0}, dict[str, float], "key[2]: got 2, expected text"),
    (3, Rudder, "key: got 3, expected a group of options"),
    ({}, Rudder, "key.area_m2 is missing"),
    ([{"area_m2": 1}, {"area": 1}], tuple[Rudder, ...], "key[1].area: unknown option, did you"),
    ({"area_m2": 1, "_target_": "os.system"}, Rudder | None, "key._target_: got 'os.system'"),
    (0, Positive, "key must be positive, got 0"),
    (0, Positive | None, "key must be positive or null, got 0"),
    ([1, -1], tuple[NotNegativeInt, ...], "key[1] must not be negative, got -1"),
    (math.nan, float | None, "key: got nan, expected a finite number"),
    (math.inf, Any, "key: got inf, expected a finite number"),
    (10**400, float, "key: got 1000"),
]


def test_takes() -> None:
    for value, annotation, result in TAKEN:
        taken = coerce(value, annotation if annotation is not None else type(None))
        assert taken == result
        assert type(taken) is type(result)


def test_refuses(subtests: pytest.Subtests) -> None:
    for value, annotation, message in REFUSED:
        with subtests.test(message):
            with pytest.raises(ConfigurationError) as caught:
                coerce(value, annotation)
            assert str(caught.value).startswith(message)
            assert len(str(caught.value)) < 200


@given(st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**53), 2**53))
def test_no_number_is_changed(number: float) -> None:
    assert coerce(number, float) == number


texts = st.text(max_size=3)
trees = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
ANNOTATIONS: list[Any] = [
    *(float, int, bool, str, Path, Rudder, Literal["a"], float | None),
    *(tuple[float, ...], dict[str, float], tuple[int, str], list[float]),
    float | Literal["b"] | tuple[int, ...],
]


@given(trees, st.sampled_from(ANNOTATIONS))
def test_only_ever_refuses_by_name(value: Any, annotation: Any) -> None:
    """Whatever is given, a value comes out or one line that begins with the key."""
    said = "key"
    try:
        coerce(value, annotation)
    except ConfigurationError as error:
        said = str(error)
    assert said.startswith("key")
    assert "\n" not in said


def test_values_to_choose_among_are_checked_as_the_option_itself() -> None:
    for tune, message in (
        ("{penalty: [1, -1]}", "identifier.tune.penalty[1] must not be negative or null, got -1"),
        ("{basis: [full, [3]]}", "identifier.tune.basis[1][0]: got 3, expected text"),
    ):
        with pytest.raises(ConfigurationError) as caught:
            composed("identifier=ridge", f"identifier.tune={tune}")
        assert str(caught.value) == message


def test_lists_to_choose_among_become_what_the_option_is() -> None:
    trial = composed("identifier=ls", "identifier.tune={basis: [physical, [u_dot, u]]}")
    assert trial.identifier.tune == {"basis": ("physical", ("u_dot", "u"))}
