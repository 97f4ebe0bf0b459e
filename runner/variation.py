"""The jobs of a sweep: a grid of values, and variants that change several options together."""

from collections.abc import Mapping, Sequence
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser

Options = Mapping[str, Any]


def jobs_of(
    parser: OverridesParser,
    params: Options,
    variants: Sequence[Options],
    arguments: Sequence[str],
) -> list[list[str]]:
    """The overrides of every job: the grid of params and arguments, once for each variant.

    A variant replaces the params of the same name; what stands on the command line replaces both.
    """
    given = {override.key_or_group for override in parser.parse_overrides(list(arguments))}
    jobs: list[list[str]] = []
    for variant in variants or [{}]:
        options = {str(key): value for key, value in {**params, **variant}.items()}
        texts = [f"{key}={_text(value)}" for key, value in options.items() if key not in given]
        (part,) = BasicSweeper.split_arguments(
            parser.parse_overrides([*texts, *arguments]), max_batch_size=None
        )
        jobs += part
    return jobs


def _text(value: Any) -> str:
    """A value of YAML in the grammar of the command line; text is taken as it is."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ",".join(map(_text, value)) + "]"
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{_text(one)}" for key, one in value.items()) + "}"
    return str(value)
