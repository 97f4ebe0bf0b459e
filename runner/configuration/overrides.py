"""Overrides of a sweep's command line: which are left to its jobs, and their sweeps in lists."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, QuotedString, Sweep
from hydra.errors import HydraException

from seatrial.runner.record.vocabulary import GROUPS


def left_to_jobs(
    words: Sequence[str], variants: Sequence[Sequence[str]]
) -> tuple[list[str], list[list[str]]]:
    """Return the words of a sweep's command line, and its variants with what is left to the jobs.

    Hydra applies a plain override to the default of its group first, which may not have the option:
    `identifier=none,ls identifier.basis=physical`. As a part of every variant it is for the jobs.
    So is a list with sweeps, which no configuration can hold.
    """
    parser = OverridesParser.create()

    def parsed(word: str) -> Override | None:
        try:
            return parser.parse_override(word)
        except HydraException:  # said by Hydra itself
            return None

    overrides = {word: override for word in words if "=" in word and (override := parsed(word))}
    swept = {each.key_or_group for each in overrides.values() if each.is_sweep_override()}
    swept |= {text.partition("=")[0] for variant in variants for text in variant}

    def is_left(override: Override) -> bool:
        group, dot, _ = override.key_or_group.partition(".")
        plain = not (override.is_sweep_override() or override.is_delete())
        several = plain and next(nested_sweeps(override.value(), ""), None) is not None
        return several or (plain and bool(dot) and group in swept & set(GROUPS))

    left = [word for word, override in overrides.items() if is_left(override)]
    if not left:
        return list(words), [list(variant) for variant in variants]
    kept = [word for word in words if word not in left]
    return kept, [[*left, *variant] for variant in variants or [()]]


def nested_sweeps(value: object, name: str) -> Iterator[tuple[str, Sweep]]:
    """Yield the sweeps of an override's value, also in its lists, by `name`, `name[0]`, ..."""
    if isinstance(value, Sweep):
        yield name, value
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from nested_sweeps(inner, f"{name}[{i}]")
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from nested_sweeps(inner, f"{name}.{key}")


def text_of(value: Any, name: str = "", values: Mapping[str, Any] = MappingProxyType({})) -> str:
    """Return a value in the grammar of the command line; `values` are those of its sweeps."""
    if isinstance(value, Sweep):
        return str(values[name])
    if isinstance(value, list):
        return f"[{','.join(text_of(v, f'{name}[{i}]', values) for i, v in enumerate(value))}]"
    if isinstance(value, dict):
        inner = (f"{key}:{text_of(v, f'{name}.{key}', values)}" for key, v in value.items())
        return "{" + ",".join(inner) + "}"
    if isinstance(value, QuotedString):
        return str(value.with_quotes())
    text = "null" if value is None else str(value)
    return text.lower() if isinstance(value, bool) else text
