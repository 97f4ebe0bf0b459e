"""Options that are taken from the vessel: `auto` in a configuration becomes a number.

The classes mark such options (seatrial.models.vessel.tuning.FromVessel). A number that the vessel
gives is copied, any other is derived from its inertia, drag, limits and length. So the stored
configuration of a trial holds the numbers that were used.

The excitation and the controller of a vessel, where a command does not name both.

A vessel takes the first pair of `SUITED` that agrees with what is named. A lap of way-points under
PID control is for a vessel by force in the plane, or one whose devices give any force.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, asdict, dataclass, fields
from functools import cached_property, partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any

import yaml
from annotated_types import Ge, Le

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Positive
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

NULLABLE = ("tuning.windage", "thruster", "driven_by")  # of a vessel, where null is a value


def filled(config: Config) -> dict[str, object]:
    """Return a resolved configuration with the numbers of its vessel.

    Raises ConfigurationError if a number cannot be derived.
    """
    numbers = _Numbers(config.get("vessel"), config.get("sample_time_s"))
    result: dict[str, object] = _fill(dict(config), "", numbers, Settings)
    return result


@dataclass(frozen=True)
class _Period:
    sample_time_s: Annotated[Positive, Ge(1e-9), Le(1e9)]  # powers of others are no numbers


class _Numbers:
    """The numbers of a vessel by their paths; it is built when the first is derived."""

    def __init__(self, node: object, sample_time_s: object) -> None:
        self._node, self._sample_time_s = node, sample_time_s
        self._completed: SimpleNamespace | None = None  # limits and tuning with derived numbers

    @cached_property
    def _vessel(self) -> "parameters.VesselParameters":
        if not isinstance(self._node, Mapping):
            raise ConfigurationError("vessel: got none, expected an option of the group")
        return build_as(parameters.VesselParameters, self._node, "vessel")

    def of(self, path: str, key: str) -> object:
        """The number at a path of the vessel, for the option `key`."""
        for source in ("_node", "_vessel", "_derived"):
            value: Any = self._derived(key) if source == "_derived" else getattr(self, source)
            for name in path.split("."):
                inner = value.get if isinstance(value, Mapping) else partial(getattr, value)
                value = inner(name, tuning.AUTO)
            if value != tuning.AUTO and (value is not None or path in NULLABLE):
                return json.loads(json.dumps(value, default=asdict))  # as in a configuration
        expected = f"expected a number: vessel.{path} cannot be derived"
        by = ", ".join(self._vessel.inputs)
        why = f": {self._vessel.name} is commanded by {by}" if by else ""
        raise ConfigurationError(f"{key}: got auto, {expected}{why}")

    def _derived(self, key: str) -> SimpleNamespace:
        period = build_as(_Period, {"sample_time_s": self._sample_time_s}, "").sample_time_s
        try:
            if self._completed is None:
                self._completed = SimpleNamespace(**derivation.derived(self._vessel, period))
        except ConfigurationError as error:
            raise ConfigurationError(f"{key}: cannot be derived from vessel {error}") from error
        return self._completed


def _fill(node: object, key: str, numbers: _Numbers, cls: type | None = None) -> Any:
    """Return a node with its numbers filled in.

    `cls` is the class that the node describes if it does not name one itself. An option that is
    left out is filled in if its class has no number for it.
    """
    if isinstance(node, list):
        return [_fill(item, f"{key}[{i}]", numbers) for i, item in enumerate(node)]
    if not isinstance(node, dict):
        return node
    try:
        cls = options.target(node["_target_"]) if "_target_" in node else cls
    except options.OptionError:
        cls = None  # the error is reported when the part is built
    marks, parts = vars(tuning.marks_of(cls)).values() if cls else ({}, {})
    result = {
        name: _fill(item, f"{key}.{name}".lstrip("."), numbers, parts.get(name))
        for name, item in node.items()
    }
    for field in fields(cls) if cls and marks else ():
        if (mark := marks.get(field.name)) is None:
            continue
        inner = result if mark.entry is None else result.get(field.name)
        wanted = field.default in (MISSING, None) and field.default_factory is MISSING
        absent = tuning.AUTO if wanted and mark.entry is None else None
        name = mark.entry or field.name
        if isinstance(inner, dict) and inner.get(name, absent) == tuning.AUTO:
            option = ".".join(filter(None, (key, field.name, mark.entry)))
            inner[name] = numbers.of(mark.path(result), option)
    return result


Choice = Mapping[str, str]
SUITED_GROUPS = ("excitation", "controller", "evaluation")
NONE, REPLAY = "none", "replay"  # the controller of an open loop, the evaluation by the excitation
# The second row: with or without a controller.
SUITED: Mapping[str, Sequence[tuple[str, str, str]]] = {
    "by force in the plane": (("waypoints", "pid_ff", REPLAY), ("prbs", NONE, REPLAY)),
    "by force": (("constant_velocity", "pid_ff", REPLAY), ("prbs", NONE, REPLAY)),
    "by helm": (("rudder_zigzag", "autopilot", "heading_changes"), ("rudder_zigzag", NONE, REPLAY)),
    "by other inputs": (("input_prbs", NONE, REPLAY), ("heading_changes", "autopilot", REPLAY)),
}
HELM = "delta"  # the input of `autopilot`


def suited_parts(vessel: Config, words: Sequence[str]) -> Choice:
    """Return excitation, controller and evaluation of a vessel; none for one that is invalid.

    An excitation that is named is evaluated by itself.

    Args:
        vessel: its node.
        words: the overrides of the trial, whose choices it follows.
    """
    named = {key.lstrip("+"): name for key, _, name in (word.partition("=") for word in words)}
    controller = named.get("controller", "")
    closed = controller not in ("", NONE) or _closed(named.get("excitation", ""))
    rows = SUITED.get(_family(vessel), ())
    fitting = (row for row in rows if not (closed if row[1] == NONE else controller == NONE))
    chosen = dict(zip(SUITED_GROUPS, next(fitting, ()), strict=False))
    return chosen | {"evaluation": REPLAY} if chosen and "excitation" in named else chosen


def _closed(excitation: str) -> bool:
    """Whether an option of the group always needs a controller."""
    for folder in (CONF, *user_folders()):
        # What is wrong with a file is reported when the trial is composed.
        with suppress(OSError, TypeError, KeyError, options.OptionError, yaml.YAMLError):
            file = folder / "excitation" / f"{excitation}.yaml"
            cls = options.target(yaml.safe_load(file.read_text(encoding="utf-8"))["_target_"])
            return getattr(cls, "open_loop", None) is missions.Mission.open_loop
    return False


def _family(vessel: Config) -> str:
    """By what a vessel is commanded; empty for one that is invalid."""
    dofs, inputs = vessel.get("dofs"), vessel.get("inputs")
    if not isinstance(dofs, list):
        return ""
    if not inputs:
        return "by force in the plane" if {*PLANAR} == {*map(str, dofs)} else "by force"
    if HELM in inputs and "yaw" in dofs:
        return "by helm"
    with suppress(ConfigurationError):  # which is reported when the trial is built
        is_positioned = (
            vessel.get("devices")
            and build_as(parameters.VesselParameters, vessel, "vessel").positioning
        )
        return "by force in the plane" if is_positioned else "by other inputs"
    return ""
