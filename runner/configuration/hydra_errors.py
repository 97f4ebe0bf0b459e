"""Errors of Hydra and OmegaConf as one line: what, where, got, expected."""

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import accumulate

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner.configuration.invocation import in_words, meant, replaced, trial_program
from seatrial.runner.configuration.plugins import leaves
from seatrial.runner.configuration.search_path import CONF, is_group, options

# Launchers that need an extra, and the name of the extra.
LAUNCHERS = {"submitit_slurm": "slurm", "ray": "ray"}
EXPECTED = (HydraException, OmegaConfBaseException, SeatrialError)
_NOT_FOUND = re.compile(r"Could not (?:find|load) '(?P<group>.*)/(?P<option>[^/']*)'")
_NO_KEY = re.compile(r"Could not override '(?P<key>[^']*)'")
_NO_NAME = re.compile(r"null|true|false|[-+.\d].*|[\[{].*", re.IGNORECASE)
_NOISE = re.compile(r"^\s*(See https?:|Set the environment variable|object_type=|full_key:)")


def refuse_gone(words: Iterable[str]) -> None:
    """Raise ConfigurationError for a word of the command line without an option that there is."""
    for word in words:
        if not word.lstrip("+~").partition("=")[0].strip():
            raise ConfigurationError(f"got {word!r}, expected option=value")
        if instead := replaced().get(f"seatrial {word}"):
            raise ConfigurationError(f"{word} is gone: {instead}")


def one_line(error: BaseException, overrides: Sequence[str] = ()) -> str:
    """Return the message of an error in one line, without technical details.

    `overrides` are those of the command line, for suggestions of option names.
    """
    if isinstance(error, OverrideParseException):
        return f"{error.override!r} cannot be read, expected option=value"
    text, key = str(error), getattr(error, "full_key", None)
    if isinstance(error, MissingConfigException) and (match := _NOT_FOUND.search(text)):
        return _missing_option(match["group"], match["option"], error.options or ())
    if match := _NO_KEY.search(text):
        return _unknown_option(match["key"], overrides)
    if (ours := in_words(text, key)) != text:
        return ours
    if text.startswith("Config group override must be") or isinstance(error, TypeError):
        for group, _, value in (override.partition("=") for override in overrides):
            if _NO_NAME.fullmatch(value) and (known := options(group)):
                return f"{group}: got {value}, expected one of {', '.join(known)}"
    # What says something, up to the list of folders that were searched.
    lines = map(str.strip, text.partition("Config search path")[0].splitlines())
    line = " ".join(line for line in lines if line and not _NOISE.match(line)) or "unknown error"
    return f"{key}: {line}" if isinstance(error, OmegaConfBaseException) and key else line


def _missing_option(group: str, name: str, known: Iterable[str]) -> str:
    if not group.startswith("hydra/"):  # what follows a group is a path
        group, slash, folder = group.partition("/")
        name = f"{folder}{slash}{name}"
    text = f"{group}={name}"
    if name.endswith((".yaml", ".yml")):
        return f"{group}: there is no file {name}"
    if text in replaced():
        return f"{text} is gone: {replaced()[text]}"
    if (extra := LAUNCHERS.get(name)) and group == "hydra/launcher":
        return f"{text} is not installed: pip install 'seatrial[{extra}]'"
    known = sorted(known) or options(group)
    known = [each for each in known if f"seatrial {group}={each}" not in replaced()]
    expected = f"one of {', '.join(known)}" if known else "none: there are none"
    return f"{group}: no option {name!r}, {meant(name, known)}expected {expected}"


def _unknown_option(key: str, overrides: Sequence[str]) -> str:
    """Return a message with the unknown option and a similar one.

    The valid choices of groups in `overrides` have options of their own.
    """
    for name in accumulate(key.split("."), "{}.{}".format):  # with the mappings that hold it
        if name in replaced():
            return f"{name} is gone: {replaced()[name]}"
    known = set[str]()
    choices = [item for item in overrides if is_group(item.partition("=")[0])]
    GlobalHydra.instance().clear()
    with (
        suppress(HydraException, OmegaConfBaseException, ValueError),
        initialize_config_dir(str(CONF), version_base="1.3"),
    ):
        for option, _ in leaves(OmegaConf.to_container(compose("trial", overrides=choices))):
            known.update(accumulate(option.split("."), "{}.{}".format))
    parts = {name.partition("[")[0].rpartition(".") for name in known}
    node, leaf, beside = key, key, list[str]()
    while node and not beside:  # the nearest that has options
        node, _, leaf = node.rpartition(".")
        beside = sorted({name for parent, _, name in parts if parent == node} - {"_target_"})
    hint = meant(leaf, beside, shown=lambda name: f"{node}.{name}".lstrip("."))
    hint = f"{leaf} as it is chosen has no options" if leaf in beside else hint
    if not hint:
        hint = f"expected one of {', '.join(beside)}" if node and beside else meant(key, known)
    return f"{key}: unknown option, {hint.rstrip() or f'see {trial_program()} --cfg job'}"
