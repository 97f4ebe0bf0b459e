"""Checks of `vessel.tuning`, whose values other groups read by interpolation.

No class declares these values, so a name must be read by some YAML file (or override), and a value
must be of the kind that the vessel files hold under its name.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.runner.yaml_files import LOADER

READ = re.compile(r"\btuning\.([\w.]+)")  # in an interpolation, absolute or relative

NUMBER = re.compile(r"[-+]?\d+\.?\d*[eE][-+]?\d+")


class Known(NamedTuple):
    """Names that files read, and the kinds of values by name."""

    names: frozenset[str]
    kinds: Mapping[str, frozenset[str]]


def check_tuning(
    tuning: Mapping[str, Any], folders: Sequence[str], overrides: Iterable[str] = ()
) -> None:
    """Raise ConfigurationError for a name that nobody reads or a value of another kind.

    `folders` are those of the configuration, `overrides` those of the trial.
    """
    known = _known(tuple(folders))
    names = known.names | {name for text in overrides for name in _names(text)}
    for name, value in _items(tuning):
        if not _is_read(name, names):
            close = get_close_matches(name, names)
            hint = f"did you mean {' or '.join(close)}?" if close else "expected one that is read"
            raise ConfigurationError(f"vessel.tuning.{name}: no option reads this value, {hint}")
        kinds = known.kinds.get(name)
        if kinds and value is not None and _kind(value) not in kinds:
            expected = " or ".join(sorted(kinds))
            raise ConfigurationError(f"vessel.tuning.{name}: got {value!r}, expected {expected}")


def _is_read(name: str, names: Iterable[str]) -> bool:
    """Whether the value itself, a group that it is in, or a value inside it is read."""
    return any(f"{name}.".startswith(f"{n}.") or n.startswith(f"{name}.") for n in names)


def _names(text: str) -> Iterator[str]:
    if "${" in text:
        yield from READ.findall(text)


@lru_cache(maxsize=8)
def _known(folders: tuple[str, ...]) -> Known:
    names: set[str] = set()
    kinds: dict[str, set[str]] = {}
    for folder in folders:
        for path in sorted(Path(folder).rglob("*.yaml")):
            try:
                text = path.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError):  # not a file that is chosen
                continue
            names.update(_names(text))
            if path.parent.name == "vessel":
                for name, value in _items(_tuning_of(text)):
                    if value is not None and "${" not in str(value):
                        kinds.setdefault(name, set()).add(_kind(value))
    return Known(frozenset(names), {name: frozenset(found) for name, found in kinds.items()})


def _tuning_of(text: str) -> Mapping[str, Any]:
    try:
        content = yaml.load(text, Loader=LOADER)
    except yaml.YAMLError:
        return {}
    tuning = content.get("tuning") if isinstance(content, Mapping) else None
    return tuning if isinstance(tuning, Mapping) else {}


def _items(tuning: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Full name and value of everything in nested groups, but not in parts with a `_target_`."""
    for key, value in tuning.items():
        yield f"{prefix}{key}", value
        if isinstance(value, Mapping) and "_target_" not in value:
            yield from _items(value, f"{prefix}{key}.")


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "true or false"
    if isinstance(value, int | float):
        return "a number"
    if isinstance(value, Mapping):
        return "a group of options"
    if isinstance(value, str):  # `1e5`, a number for OmegaConf but not for YAML
        return "a number" if NUMBER.fullmatch(value) else "text"
    return "a list"
