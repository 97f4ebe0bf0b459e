"""Two trials are the same if, and only if, what they compute is."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from seatrial.runner.fingerprint import NOT_COMPARED, canonical, fingerprint, source_digest

keys = st.text("abcdef_", min_size=1, max_size=6).filter(lambda key: key not in NOT_COMPARED)
leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(10**12), 10**12)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8)
)
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3)
)
configurations = st.dictionaries(keys, values, max_size=5)
NAMES = {"vessel": "milliampere", "identifier": "ls"}


def of(config: dict[str, Any], names: dict[str, str] = NAMES, sources: str = "0") -> str:
    return fingerprint(config, names, sources)


def shuffled(value: Any) -> Any:
    """The same with the keys of every mapping in reverse order."""
    if isinstance(value, dict):
        return {key: shuffled(value[key]) for key in reversed(value)}
    if isinstance(value, list):
        return [shuffled(item) for item in value]
    return value


@given(configurations)
def test_the_order_of_keys_does_not_matter(config: dict[str, Any]) -> None:
    assert of(config) == of(shuffled(config))


@given(configurations, values)
def test_where_results_go_does_not_matter(config: dict[str, Any], value: Any) -> None:
    for key in NOT_COMPARED:
        assert of(config) == of({**config, key: value})


@given(configurations, keys, values, values)
def test_a_changed_value_matters(config: dict[str, Any], key: str, one: Any, other: Any) -> None:
    # 1, 1.0 and True are equal in Python; only the first two are the same value here.
    assume(canonical(one) != canonical(other))
    assert of({**config, key: one}) != of({**config, key: other})


@given(st.dictionaries(keys, leaves, min_size=1, max_size=5))
def test_a_removed_value_matters(config: dict[str, Any]) -> None:
    fewer = dict(config)
    fewer.popitem()
    assert of(config) != of(fewer)


@given(st.integers(-(10**12), 10**12))
def test_a_whole_number_may_be_written_as_a_float(number: int) -> None:
    assert of({"force": [number]}) == of({"force": [float(number)]})


def test_true_is_not_one() -> None:
    assert of({"a": True}) != of({"a": 1})


def test_names_and_sources_matter() -> None:
    assert of({"a": 1}) != of({"a": 1}, {"vessel": "milliampere", "identifier": "plsr"})
    assert of({"a": 1}) != of({"a": 1}, sources="1")
    assert of({"a": 1}, {**NAMES, "database": "sqlite"}) == of({"a": 1})


def test_not_a_number_has_no_fingerprint() -> None:
    with pytest.raises(ValueError, match="JSON"):
        of({"a": float("nan")})


def test_it_is_sha_256_in_hexadecimal() -> None:
    assert len(of({})) == 64
    assert set(of({})) <= set("0123456789abcdef")


def test_sources_are_names_and_bytes(tmp_path: Path) -> None:
    (tmp_path / "control").mkdir()
    (tmp_path / "a.py").write_bytes(b"x = 1\n")
    (tmp_path / "control" / "b.py").write_bytes(b"")
    first = source_digest(tmp_path)
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__" / "a.pyc").write_bytes(b"0")
    assert source_digest(tmp_path) == first
    (tmp_path / "a.py").write_bytes(b"x = 2\n")
    second = source_digest(tmp_path)
    (tmp_path / "a.py").rename(tmp_path / "c.py")
    third = source_digest(tmp_path)
    # What one file loses another gains: the boundary between them counts.
    (tmp_path / "c.py").write_bytes(b"x = ")
    (tmp_path / "control" / "b.py").write_bytes(b"2\n")
    assert len({first, second, third, source_digest(tmp_path)}) == 4


def test_a_wind_file_stands_for_what_is_in_it(tmp_path: Path) -> None:
    def of(name: str) -> str:
        wind = {"variation": "file", "file": str(tmp_path / name)}
        return fingerprint({"disturbance": {"wind": wind, "noise": None}}, {}, "")

    for name, speed in (("a", 5), ("b", 5), ("c", 6)):
        (tmp_path / name).write_text(f"t,speed,direction\n0,{speed},0\n")
    assert of("a") == of("b") != of("c")
    assert fingerprint({"disturbance": {"wind": None}}, {}, "") != of("a")
