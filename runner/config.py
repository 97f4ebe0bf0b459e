"""From the resolved configuration of one trial to checked, frozen objects.

A node of the configuration names its class with `_target_`: a frozen dataclass inside `models` or
`runner`. Its keys are the dataclass's fields, its values are checked against their annotations
here and against their ranges in the class's own `__post_init__`. Every error names the key, what
was got and what was expected.
"""

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, get_type_hints

from seatrial.models.errors import ConfigurationError
from seatrial.runner.coercion import coerce

GROUPS = (
    "vessel",
    "disturbance",
    "excitation",
    "identifier",
    "controller",
    "evaluation",
)
SETTINGS = (
    "seed",
    "sample_time_s",
    "integration_step_s",
    "plant",
    "update",
    "results_dir",
    "database",
    "rerun",
    "dry_run",
)
ROOTS = ("seatrial.models", "seatrial.runner")  # the only packages a `_target_` may name
TARGET = re.compile(rf"({'|'.join(ROOTS)})(\.[A-Za-z]\w*)+")
Node = Mapping[str, Any]


@dataclass(frozen=True)
class Trial:
    """One trial, checked: what is sailed, and where its results go.

    `names` are the options chosen for `GROUPS`; `config` is the resolved configuration that all
    else was built from. An object is None where its group's node is empty (`controller=none`).
    """

    vessel: Any
    disturbance: Any
    excitation: Any
    identifier: Any
    controller: Any
    evaluation: Any
    sample_time_s: float  # control and logging period
    integration_step_s: float  # of the plant's simulation
    plant_scale: float  # true plant = plant_scale x nominal coefficient table
    seed: int
    names: Mapping[str, str]
    config: Node
    results_dir: Path
    database_url: str
    rerun: bool = False
    dry_run: bool = False
    plant_change: "PlantChange | None" = None
    update: Any = (
        None  # seatrial.runner.adaptive.Update, where the model is identified again while sailing
    )


@dataclass(frozen=True)
class PlantChange:
    """In the deployment the true plant is another from `at_s` [s] on: `scale` x the nominal."""

    at_s: float
    scale: float

    def __post_init__(self) -> None:
        for name in ("at_s", "scale"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")


def build_trial(config: Node, names: Mapping[str, str]) -> Trial:
    """The trial that a resolved configuration describes; ConfigurationError where it is wrong."""
    _only_known(config, (*GROUPS, *SETTINGS), "")
    sample_time = _positive(config, "sample_time_s")
    step = _positive(config, "integration_step_s")
    if step > sample_time:
        raise ConfigurationError(
            f"integration_step_s must not be above sample_time_s = {sample_time:g}, got {step:g}"
        )
    plant = _section(config, "plant", ("scale", "change"))
    seed: int = coerce(_given(config, "seed"), int, "seed")
    if seed < 0:
        raise ConfigurationError(f"seed must not be negative, got {seed}")
    settings = {
        "sample_time_s": sample_time,
        "integration_step_s": step,
        "plant_scale": _positive(plant, "scale", "plant."),
        "plant_change": _optional(plant.get("change"), PlantChange, "plant.change"),
        "update": _optional(config.get("update"), "seatrial.runner.adaptive.Update", "update"),
        "seed": seed,
        "results_dir": coerce(_given(config, "results_dir"), Path, "results_dir"),
        "database_url": database_url(config),
        "rerun": coerce(config.get("rerun", False), bool, "rerun"),
        "dry_run": coerce(config.get("dry_run", False), bool, "dry_run"),
    }
    objects = {group: build(config.get(group), group) for group in GROUPS}
    return Trial(**objects, **settings, names=dict(names), config=config)


def _optional(node: Any, cls: type | str, key: str) -> Any:
    """An object of a class, or None for null."""
    if node is None:
        return None
    if not isinstance(node, Mapping):
        raise ConfigurationError(f"{key}: got {node!r}, expected null or a group of options")
    return build_as(_target(cls, key) if isinstance(cls, str) else cls, node, key)


def database_url(config: Node) -> str:
    """Where the logbook is; the one option of the group `database`.

    Where it is null, in the folder of results.
    """
    database = _section(config, "database", ("url",))
    if "url" in database and database["url"] is None:
        from seatrial.runner.database.engine import file_url  # slow to import

        folder: Path = coerce(_given(config, "results_dir"), Path, "results_dir")
        return file_url(folder / "results.db")
    url: str = coerce(_given(database, "url", "database."), str, "database.url")
    return url


def build(node: Any, key: str) -> Any:
    """The object that a node with a `_target_` describes; None for an empty node."""
    if node is None or node == {}:
        return None
    if not isinstance(node, Mapping):
        raise ConfigurationError(f"{key}: got {node!r}, expected a group of options")
    if "_target_" not in node:
        raise ConfigurationError(f"{key}._target_ is missing, expected the name of a class")
    return build_as(_target(node["_target_"], key), node, key)


def build_as(cls: type, node: Node, key: str) -> Any:
    """An object of the dataclass `cls` from the values of `node`, each checked and coerced."""
    options = {field.name: field for field in fields(cls) if field.init}
    given = {name: value for name, value in node.items() if name != "_target_"}
    _only_known(given, tuple(options), f"{key}.")
    for name, field in options.items():
        if name not in given and field.default is MISSING and field.default_factory is MISSING:
            raise ConfigurationError(f"{key}.{name} is missing")
    hints = _annotations(cls)
    values = {
        name: coerce(value, hints[name], f"{key}.{name}", build=_nested)
        for name, value in given.items()
    }
    try:
        return cls(**values)
    except ConfigurationError as error:
        message = str(error)
        if message.startswith((f"{key}.", f"{key}:")):
            raise
        raise ConfigurationError(f"{key}: {message}") from error


def _nested(node: Node, key: str, cls: type | None) -> Any:
    """A node inside a node: of the class it names, else of the class its field is annotated as."""
    if cls is None or "_target_" in node:
        return build(node, key)
    return build_as(cls, node, key)


@cache
def _annotations(cls: type) -> dict[str, Any]:
    return get_type_hints(cls)


def _target(name: Any, key: str) -> type:
    """The dataclass that a `_target_` names."""
    where = f"{key}._target_"
    if not isinstance(name, str) or not TARGET.fullmatch(name):
        raise ConfigurationError(f"{where}: got {name!r}, expected a class inside seatrial")
    module_name, _, class_name = name.rpartition(".")
    try:
        found = getattr(import_module(module_name), class_name, None)
    except ModuleNotFoundError as error:
        if error.name is None or not module_name.startswith(error.name):
            raise  # the module is there, something it imports is not: a bug, not an option
        found = None
    inside = isinstance(found, type) and found.__module__.startswith(tuple(f"{r}." for r in ROOTS))
    if not (inside and isinstance(found, type) and is_dataclass(found)):
        raise ConfigurationError(f"{where}: got {name!r}, which is not a dataclass to build")
    return found


def _only_known(node: Node, known: tuple[str, ...], prefix: str) -> None:
    for name in node:
        if name not in known:
            close = get_close_matches(str(name), known)
            hint = f"did you mean {' or '.join(close)}?" if close else f"expected {_listed(known)}"
            raise ConfigurationError(f"{prefix}{name}: unknown option, {hint}")


def _listed(names: tuple[str, ...]) -> str:
    return f"one of {', '.join(names)}" if names else "no options here"


def _section(config: Node, name: str, known: tuple[str, ...]) -> Node:
    section = config.get(name)
    if not isinstance(section, Mapping):
        raise ConfigurationError(f"{name}: got {section!r}, expected the option {', '.join(known)}")
    _only_known(section, known, f"{name}.")
    return section


def _given(config: Node, name: str, prefix: str = "") -> Any:
    if name not in config:
        raise ConfigurationError(f"{prefix}{name} is missing")
    return config[name]


def _positive(config: Node, name: str, prefix: str = "") -> float:
    value: float = coerce(_given(config, name, prefix), float, prefix + name)
    if value <= 0.0:
        raise ConfigurationError(f"{prefix}{name} must be positive, got {value:g}")
    return value
