"""Errors of Hydra and OmegaConf as one line: what, where, got, expected."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import accumulate
from typing import Any, cast

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner.configuration.invocation import meant, replaced, trial_program
from seatrial.runner.configuration.search_path import CONF, is_group, options

# Launchers that need an extra, and the name of the extra.
LAUNCHERS = {"submitit_slurm": "slurm", "ray": "ray"}
# Launchers that come with those and do not store what they run.
UNUSED = ("hydra/launcher=joblib", "hydra/launcher=submitit_local")
EXPECTED = (HydraException, OmegaConfBaseException, SeatrialError)
_NOT_FOUND = re.compile(r"Could not (?:find|load) '(?P<group>.*)/(?P<option>[^/']*)'")
_NO_KEY = re.compile(r"Could not override '(?P<key>[^']*)'")
_AMBIGUOUS = re.compile(r"Ambiguous value for argument '(?P<override>.*)'")
_ALREADY = re.compile(r"An item is already at '(?P<key>[^']*)'")
_NO_NAME = re.compile(r"null|true|false|[-+.\d].*|[\[{].*", re.IGNORECASE)
_NO_VARIABLE = re.compile(r"Environment variable '(?P<name>[^']*)' not found")
_NOISE = re.compile(r"^\s*(See https?:|Set the environment variable|object_type=|full_key:)")


def refuse_unused(words: Iterable[str]) -> None:
    """Raise ConfigurationError if a word of the command line is a launcher that does not work."""
    for word in words:
        if word in UNUSED:
            raise ConfigurationError(f"{word} is not supported, use hydra/launcher=processes")


def one_line(error: BaseException, overrides: Sequence[str] = ()) -> str:
    """Return the message of an error in one line, without technical details.

    `overrides` are those of the command line, for suggestions of option names.
    """
    if isinstance(error, OverrideParseException):
        return f"{error.override!r} cannot be read, expected option=value"
    if isinstance(error, MissingConfigException):
        return _missing_config(error)
    key = getattr(error, "full_key", None)
    if isinstance(error, MissingMandatoryValue):
        return f"{key} is missing, give it as {key}=..."
    text = str(error)
    if match := _NO_KEY.search(text):
        return _unknown_option(match["key"], overrides)
    if match := _AMBIGUOUS.search(text):
        return f"{match['override']}: several values, expected one (a sweep needs -m)"
    if match := _ALREADY.search(text):
        return f"+{match['key']}: the option exists already, write {match['key']}=..."
    if text.startswith("Config group override must be"):  # a name, such as null
        for group, _, value in (override.partition("=") for override in overrides):
            if _NO_NAME.fullmatch(value) and (known := options(group)):
                return f"{group}: got {value}, expected one of {', '.join(known)}"
        return text
    if match := _NO_VARIABLE.search(text):
        return f"{key}: the environment variable {match['name']} is not set"
    line = _joined(text)
    if isinstance(error, OmegaConfBaseException) and key:
        return f"{key}: {line}"
    return line


def _joined(text: str) -> str:
    """Return the lines that say something, up to the list of folders that were searched."""
    lines = map(str.strip, text.partition("Config search path")[0].splitlines())
    return " ".join(line for line in lines if line and not _NOISE.match(line)) or "unknown error"


def _missing_config(error: MissingConfigException) -> str:
    match = _NOT_FOUND.search(str(error))
    if match is None:
        return _joined(str(error))
    text = f"{match['group']}={match['option']}"
    if text in replaced():
        return f"{text} is gone: {replaced()[text]}"
    if (extra := LAUNCHERS.get(match["option"])) and match["group"] == "hydra/launcher":
        return f"{text} is not installed: pip install 'seatrial[{extra}]'"
    known = sorted(error.options or ()) or options(match["group"])
    known = [name for name in known if f"{match['group']}={name}" not in UNUSED]
    expected = f"one of {', '.join(known)}" if known else "none: there are none"
    hint = meant(match["option"], known)
    return f"{match['group']}: no option {match['option']!r}, {hint}expected {expected}"


def _unknown_option(key: str, overrides: Sequence[str]) -> str:
    """Return a message with the unknown option and similar options."""
    for name in accumulate(key.split("."), "{}.{}".format):  # with the mappings that hold it
        if name in replaced():
            return f"{name} is gone: {replaced()[name]}"
    known = _known_keys(overrides)
    same_depth = [name for name in known if name.count(".") == key.count(".")]
    close = get_close_matches(key, same_depth, n=2, cutoff=0.7)
    if not close:  # right name in the wrong place
        leaf = key.rpartition(".")[2]
        close = [name for name in known if name.rpartition(".")[2] == leaf][:3]
    hint = f"did you mean {' or '.join(close)}?" if close else f"see {trial_program()} --cfg job"
    return f"{key}: unknown option, {hint}"


def _known_keys(overrides: Sequence[str]) -> list[str]:
    """Return all keys of the configuration, with the valid choices of groups in `overrides`."""
    choices = [item for item in overrides if is_group(item.partition("=")[0])]
    for attempt in (choices, []):
        GlobalHydra.instance().clear()
        try:
            with initialize_config_dir(str(CONF), version_base="1.3"):
                node = OmegaConf.to_container(compose("trial", overrides=list(attempt)))
                return [*_keys(cast(Mapping[Any, Any], node), "")]
        except (HydraException, OmegaConfBaseException, ValueError):
            continue
    return []


def _keys(node: Mapping[Any, Any], prefix: str) -> Iterator[str]:
    for name, value in node.items():
        yield f"{prefix}{name}"
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{name}.")
