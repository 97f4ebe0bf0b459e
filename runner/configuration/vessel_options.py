"""Options that are taken from the vessel: `auto` in a configuration becomes a number.

The classes mark such options (seatrial.models.vessel.tuning.FromVessel). A number that the vessel
gives is copied, any other is derived from its inertia, drag, limits and length. So the stored
configuration of a trial holds the numbers that were used.

The excitation and the controller of a vessel, where a command does not name both.

A vessel takes the first pair of `SUITED` that agrees with what is named. A lap of way-points under
PID control is for a vessel by force in the plane, or one whose devices give any force.
"""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, fields, is_dataclass
from operator import is_
from types import SimpleNamespace
from typing import TYPE_CHECKING

import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.runner.configuration.config import Settings, build_as
from seatrial.runner.configuration.search_path import CONF, user_folders
from seatrial.runner.record.vocabulary import Config

if TYPE_CHECKING:  # what is slow to import
    from seatrial.models.excitation import missions
    from seatrial.models.vessel import derivation, parameters, tuning
    from seatrial.runner.configuration import options
else:
    import lazy_loader

    missions = lazy_loader.load("seatrial.models.excitation.missions", suppress_warning=True)
    derivation = lazy_loader.load("seatrial.models.vessel.derivation", suppress_warning=True)
    parameters = lazy_loader.load("seatrial.models.vessel.parameters", suppress_warning=True)
    tuning = lazy_loader.load("seatrial.models.vessel.tuning", suppress_warning=True)
    options = lazy_loader.load("seatrial.runner.configuration.options", suppress_warning=True)

INNER = (dict, list)  # nodes that hold others
NULLABLE = ("tuning.windage", "thruster", "driven_by")  # of a vessel, where null is a value
SHORTEST_S, LONGEST_S = 1e-9, 1e9


def filled(config: Config) -> dict[str, object]:
    """Return a resolved configuration with the numbers of its vessel.

    Raises ConfigurationError if a number cannot be derived.
    """
    numbers = _Numbers(config.get("vessel"), config.get("sample_time_s"))
    parts = tuning.marks_of(Settings).parts
    return {name: _fill(node, name, numbers, parts.get(name)) for name, node in config.items()}


class _Numbers:
    """The numbers of a vessel by their paths; it is built when the first is derived."""

    def __init__(self, node: object, sample_time_s: object) -> None:
        self._node = node
        self._sample_time_s = sample_time_s
        self._vessel: parameters.VesselParameters | None = None
        self._completed: SimpleNamespace | None = None  # limits and tuning with derived numbers

    def of(self, path: str, key: str) -> object:
        """The number at a path of the vessel, for the option `key`."""
        given = self._node
        for name in path.split("."):
            given = given.get(name, tuning.AUTO) if isinstance(given, Mapping) else tuning.AUTO
        return _plain(self._derived(path, key)) if _open(given, path) else given

    def _derived(self, path: str, key: str) -> object:
        if not isinstance(self._node, Mapping):
            raise ConfigurationError("vessel: got none, expected an option of the group")
        if "_target_" not in self._node:
            build_as(object, self._node, "vessel")  # it is refused before anything is derived
        if self._vessel is None:
            self._vessel = build_as(parameters.VesselParameters, self._node, "vessel")
        value = _at(self._vessel, path)
        if _open(value, path):
            self._completed = self._completed or self._complete(self._vessel, key)
            value = _at(self._completed, path)
        if _open(value, path):
            raise ConfigurationError(
                f"{key}: got auto, expected a number: vessel.{path} cannot be derived"
            )
        return value

    def _complete(self, vessel: "parameters.VesselParameters", key: str) -> SimpleNamespace:
        period = self._sample_time_s
        if isinstance(period, bool) or not isinstance(period, int | float) or not period > 0.0:
            raise ConfigurationError(f"sample_time_s must be positive, got {period}")
        if not SHORTEST_S <= period <= LONGEST_S:  # or powers of it are no numbers any more
            raise ConfigurationError(
                f"sample_time_s: got {period:g} s, expected {SHORTEST_S:g} to {LONGEST_S:g}"
            )
        try:
            return SimpleNamespace(**derivation.derived(vessel, period))
        except ConfigurationError as error:
            raise ConfigurationError(f"{key}: cannot be derived from vessel {error}") from error


def _at(vessel: object, path: str) -> object:
    """Return the value at a path of a vessel; None if there is no such path."""
    for name in path.split("."):
        vessel = getattr(vessel, name, None)
    return vessel


def _open(value: object, path: str) -> bool:
    """Whether a value is to be derived; null stands for none in `NULLABLE`."""
    return value == tuning.AUTO if path in NULLABLE else value in (None, tuning.AUTO)


def _fill(node: object, key: str, numbers: _Numbers, cls: type | None = None) -> object:
    """Return a node with its numbers filled in; parts without any are not copied.

    `cls` is the class that the node describes if it does not name one itself.
    """
    if isinstance(node, list):
        items = [
            _fill(item, f"{key}[{i}]", numbers) if isinstance(item, INNER) else item
            for i, item in enumerate(node)
        ]
        return node if all(map(is_, items, node)) else items
    if not isinstance(node, dict):
        return node
    cls = _class_of(node, cls)
    marks = tuning.Marks({}, {}) if cls is None else tuning.marks_of(cls)
    filled = {
        name: _fill(item, f"{key}.{name}", numbers, marks.parts.get(name))
        if isinstance(item, INNER)
        else item
        for name, item in node.items()
    }
    for name, mark in marks.marks.items():
        option = f"{key}.{name}"
        value = filled.get(name, tuning.AUTO if cls and _wanted(cls, name) else None)
        if mark.entry is not None and isinstance(value, dict):
            if value.get(mark.entry) == tuning.AUTO:
                number = numbers.of(mark.path(filled), f"{option}.{mark.entry}")
                filled[name] = {**value, mark.entry: number}
        elif mark.entry is None and value == tuning.AUTO:
            filled[name] = numbers.of(mark.path(filled), option)
    same = len(filled) == len(node) and all(map(is_, filled.values(), node.values()))
    return node if same else filled


def _class_of(node: Config, cls: type | None) -> type | None:
    """Return the class that a node names by `_target_`, else the one that is expected."""
    if "_target_" not in node:
        return cls
    try:
        return options.target(node["_target_"])
    except options.OptionError:
        return None  # the error is reported when the part is built


def _wanted(cls: type, name: str) -> bool:
    """Whether an option that is left out is taken from the vessel: its class has no number."""
    field = next(field for field in fields(cls) if field.name == name)
    return field.default in (MISSING, None) and field.default_factory is MISSING


def _plain(value: object) -> object:
    """Return a number, list or mapping as it stands in a configuration."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return value


Choice = Mapping[str, str]
SUITED_GROUPS = ("excitation", "controller")
NONE = "none"  # the controller of an open loop
SUITED: Mapping[str, Sequence[tuple[str, str]]] = {  # the second pair: with or without a controller
    "by force in the plane": (("waypoints", "pid_ff"), ("prbs", NONE)),
    "by force": (("constant_velocity", "pid_ff"), ("prbs", NONE)),
    "by helm": (("heading_changes", "autopilot"), ("rudder_zigzag", NONE)),
    "by other inputs": (("input_prbs", NONE), ("heading_changes", "autopilot")),
}
HELM = "delta"  # the input of `autopilot`


def suited_parts(vessel: Config, words: Sequence[str]) -> Choice:
    """Return the excitation and the controller of a vessel; none for one that is invalid.

    Args:
        vessel: its node.
        words: the overrides of the trial, whose choices it follows.
    """
    named = {key.lstrip("+"): name for key, _, name in (word.partition("=") for word in words)}
    controller = named.get("controller", "")
    closed = controller not in ("", NONE) or _closed(named.get("excitation", ""))
    pairs = SUITED.get(_family(vessel), ())
    fitting = (pair for pair in pairs if not (closed if pair[1] == NONE else controller == NONE))
    return dict(zip(SUITED_GROUPS, next(fitting, ()), strict=False))


def _closed(excitation: str) -> bool:
    """Whether an option of the group always needs a controller."""
    paths = (folder / "excitation" / f"{excitation}.yaml" for folder in (CONF, *user_folders()))
    file = next((path for path in paths if path.is_file()), None)
    try:
        node = yaml.safe_load(file.read_text(encoding="utf-8")) if file else None
        cls = options.target(node.get("_target_")) if isinstance(node, Mapping) else None
    except (options.OptionError, yaml.YAMLError):
        return False  # it is reported when the trial is composed
    return cls is not None and getattr(cls, "open_loop", None) is missions.Mission.open_loop


def _family(vessel: Config) -> str:
    """By what a vessel is commanded; empty for one that is invalid."""
    dofs, inputs = vessel.get("dofs"), vessel.get("inputs")
    if not isinstance(dofs, list):
        return ""
    if not inputs:
        return "by force in the plane" if {*PLANAR} == {*map(str, dofs)} else "by force"
    if HELM in inputs and "yaw" in dofs:
        return "by helm"
    if vessel.get("devices"):
        try:
            built = build_as(parameters.VesselParameters, vessel, "vessel")
        except ConfigurationError:
            return ""  # it is reported when the trial is built
        return "by force in the plane" if built.positioning else "by other inputs"
    return "by other inputs"
