"""Overrides of jobs: parsed once for each text, and applied to a configuration as Hydra does."""

import re
from collections.abc import Iterator, Sequence
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType, Sweep, ValueType
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from seatrial.runner.vocabulary import GROUPS

# `key=number` without spaces or underscores; a part of Hydra's grammar.
_NUMBER = re.compile(
    r"(?P<key>[A-Za-z_]\w*(?:\.(?:[A-Za-z_]\w*|0|[1-9]\d{0,8}))*)"
    r"=(?P<number>-?(?:0|[1-9]\d{0,17})(?P<rest>(?:\.\d{1,20})?(?:e[+-]?\d{1,3})?))",
    re.ASCII,
)


class Parser:
    """Hydra's parser of overrides. Numbers, which differ from job to job, are read faster."""

    KEPT = 4096  # largest number of parsed texts

    def __init__(self, loader: ConfigLoader) -> None:
        self._loader = loader
        self._parser = OverridesParser.create(config_loader=loader)
        self._parsed: dict[str, Override] = {}

    def parse(self, texts: Sequence[str]) -> list[Override]:
        """Parse the overrides of a job; raises errors of Hydra."""
        return [self._number(text) or self._other(text) for text in texts]

    def _number(self, text: str) -> Override | None:
        match = _NUMBER.fullmatch(text)
        if match is None:
            return None
        return Override(
            type=OverrideType.CHANGE,
            key_or_group=match["key"],
            value_type=ValueType.ELEMENT,
            _value=float(match["number"]) if match["rest"] else int(match["number"]),
            input_line=text,
            config_loader=self._loader,
        )

    def _other(self, text: str) -> Override:
        if text not in self._parsed:
            if len(self._parsed) >= self.KEPT:
                self._parsed.clear()
            (self._parsed[text],) = self._parser.parse_overrides([text])
        return self._parsed[text]


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


class Refused(Exception):  # noqa: N818
    """An override that Hydra refuses."""


def apply(config: DictConfig, overrides: Sequence[Override]) -> None:
    """Apply overrides of values in their order; raises Refused where Hydra raises its own error."""
    try:
        for override in overrides:
            if override.is_delete():
                _delete(config, override)
            elif override.is_add() and not _may_be_added(config, override):
                raise Refused(override.input_line)
            else:
                set_value(config, override)
    except (OmegaConfBaseException, AttributeError, TypeError, ValueError, AssertionError) as error:
        raise Refused(str(error)) from error


def set_value(config: DictConfig, override: Override) -> None:
    """Set or add a value; raises errors of OmegaConf."""
    force = override.is_add() or override.is_force_add()
    key, value = override.key_or_group, override.value()
    OmegaConf.update(config, key, value, merge=True, force_add=force)


def _may_be_added(config: DictConfig, override: Override) -> bool:
    if isinstance(override.value(), dict | list):
        return True
    return OmegaConf.select(config, override.key_or_group, throw_on_missing=False) is None


def _delete(config: DictConfig, override: Override) -> None:
    key, value = override.key_or_group, override.value()
    present = OmegaConf.select(config, key, throw_on_missing=False)
    if present is None or (value is not None and value != present):
        raise Refused(override.input_line)
    parent, _, last = key.rpartition(".")
    with open_dict(config):
        node: Any = OmegaConf.select(config, parent) if parent else config
        del node[last]
