"""From the resolved configuration of one trial to checked, frozen objects.

A node of the configuration names its class with `_target_`: a frozen dataclass of the role of its
group, in any module (configuration/roles.py). Its keys are the dataclass's fields, its values are
checked against their annotations by pydantic (configuration/options.py) and against their ranges in
the class's own `__post_init__`. Every error names the key, what was got and what was expected.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, TypeVar

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegativeInt, Positive, check_ranges
from seatrial.models.vessel.tuning import FromVessel
from seatrial.runner import database
from seatrial.runner.database.terminal import refuse_passwords

if TYPE_CHECKING:  # what is slow to import
    from seatrial.models.control.controller import Controller
    from seatrial.models.excitation.missions import Evaluation, Mission
    from seatrial.models.identification.adaptive import Update
    from seatrial.models.identification.problem import Identifier
    from seatrial.models.recording.recorded_file import RecordedFile
    from seatrial.models.vessel.parameters import VesselParameters
    from seatrial.models.weather.disturbance import Disturbance
    from seatrial.runner.configuration import harbours, options, recording_map, roles
    from seatrial.runner.record.own_metrics import OwnMetric
else:
    import lazy_loader

    recording_map = lazy_loader.load(
        "seatrial.runner.configuration.recording_map", suppress_warning=True
    )
    harbours = lazy_loader.load("seatrial.runner.configuration.harbours", suppress_warning=True)
    options = lazy_loader.load("seatrial.runner.configuration.options", suppress_warning=True)
    roles = lazy_loader.load("seatrial.runner.configuration.roles", suppress_warning=True)

LARGEST_INTEGER = 2**63 - 1  # that databases hold
T = TypeVar("T")
Node = Mapping[str, object]


@dataclass(frozen=True)
class Limits:
    """The largest size of a trial and of a sweep, checked before any work (trials/budget.py).

    `samples` is the number of integration steps of one simulation, about a million of which take a
    second. `memory` [GB] null is 80 % of the machine's. `trials` is the number in one sweep.
    """

    samples: Positive = 1e11
    memory: Positive | None = None
    trials: Positive = 1e6

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class PlantChange:
    """A change of the plant in the deployment, from `at_s` [s] on, to `scale` x the nominal."""

    at_s: Positive
    scale: Positive

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class PlantOptions:
    """The true plant: `scale` x the nominal coefficient table."""

    scale: Annotated[Positive, FromVessel("plant_scale")]
    change: PlantChange | None = None

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class SweepLabels:
    """Labels of the sweep that a trial belongs to; they do not change its results."""

    name: str | None = None
    tags: tuple[str, ...] = ()
    note: str | None = None

    def __bool__(self) -> bool:
        """Whether there is a label."""
        return self != SweepLabels()


@dataclass(frozen=True)
class Database:
    """The address of the logbook; None: a SQLite file in the folder of results."""

    url: str | None

    def __post_init__(self) -> None:
        refuse_passwords([self.url or ""])


@dataclass(frozen=True)
class Settings:
    """The options of a trial in the structure of the configuration; an empty group is None."""

    vessel: object
    disturbance: object
    excitation: object
    identifier: object
    controller: object
    evaluation: object
    seed: NotNegativeInt
    sample_time_s: Positive  # control and logging period
    integration_step_s: Positive  # of the plant's simulation
    plant: PlantOptions
    results_dir: Path
    database: Database
    update: object = None
    metrics: tuple[object, ...] = ()
    horizons_s: tuple[Positive, ...] | None = None  # of predictions beside the free run
    limits: Limits = Limits()  # of its size
    deploy_unphysical: bool = False  # whether a model that creates energy is deployed too
    model_error: bool = True  # whether it is calibrated, of a model with a distribution
    rerun: bool = False
    dry_run: bool = False
    sweep: SweepLabels = field(default_factory=SweepLabels)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.integration_step_s > self.sample_time_s:
            raise ConfigurationError(
                f"integration_step_s must not be above sample_time_s = {self.sample_time_s:g}, "
                f"got {self.integration_step_s:g}"
            )


@dataclass(frozen=True, kw_only=True)
class Trial(Settings):
    """One checked trial: its options with their parts, and what it is called.

    `names` are the options chosen from each group; `config` is the resolved configuration of the
    trial. Controller and evaluation are None if the node of their group is empty.
    """

    vessel: "VesselParameters"
    disturbance: "Disturbance"
    excitation: "Mission | RecordedFile"
    identifier: "Identifier"
    controller: "Controller | None"
    evaluation: "Evaluation | None"
    update: "Update | None"  # of the model during the deployment
    metrics: "tuple[OwnMetric, ...]"  # user-defined metrics
    names: Mapping[str, str]
    config: Node
    samples: int | None = None  # to train, to test and to deploy with, at most; None: all

    def __post_init__(self) -> None:
        for group in ("vessel", "disturbance", "excitation", "identifier"):
            if getattr(self, group) is None:
                raise ConfigurationError(f"{group}: got none, expected an option of the group")

    @property
    def database_url(self) -> str:
        """The address of the logbook; by default a SQLite file in the folder of results."""
        return self.database.url or database.engine.file_url(self.results_dir / "results.db")


def build_trial(config: Node, names: Mapping[str, str]) -> Trial:
    """Build the trial of a resolved configuration; raises ConfigurationError if it is invalid."""
    for name, node in config.items():
        check_finite(node, str(name))
    update, nodes = config.get("update"), dict(config)
    if isinstance(update, Mapping):
        nodes["update"] = {**update, "_target_": "seatrial.models.identification.adaptive.Update"}
    nodes["excitation"] = recording_map.with_map(nodes["excitation"])
    nodes["evaluation"] = harbours.with_harbours(nodes.get("evaluation"))
    for group, role in roles.ROLES.items():  # before anything of another role is made
        _check_role(nodes.get(group), role, group)
    metrics = nodes.get("metrics")
    for i, node in enumerate(metrics if isinstance(metrics, list | tuple) else ()):
        _check_role(node, roles.METRIC, f"metrics[{i}]")
    settings = build_as(Settings, nodes, "")
    parts = vars(settings)
    if roles.only_validates(settings.excitation, settings.evaluation):
        parts = {**parts, "controller": None, "evaluation": None}
        names = {**names, "controller": "none", "evaluation": "none"}
    return Trial(**parts, names=names, config=config)


def _check_role(node: object, role: "type | UnionType", key: str) -> None:
    if not isinstance(node, Mapping) or "_target_" not in node:
        return
    try:
        cls = options.target(node["_target_"])
    except options.OptionError as error:
        raise ConfigurationError(error.at(key)) from error
    if not issubclass(cls, role):
        raise ConfigurationError(
            f"{key}._target_: got {cls.__name__}, expected a class for this group"
        )


def check_finite(value: object, key: str = "") -> None:
    """Raise ConfigurationError for an infinite number or NaN, in keys that are not used as well."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            check_finite(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            check_finite(item, f"{key}[{i}]")
    elif isinstance(value, float) and not isfinite(value):
        raise ConfigurationError(f"{key}: got {value}, expected a finite number")
    elif isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        raise ConfigurationError(f"{key}: got an integer of {value.bit_length()} bits, expected 64")


def build_as(cls: type[T], node: object, key: str) -> T:
    """Build a `cls` from a node; errors are reported for the option `key`.

    Without a class (`object`) the node names one by `_target_`, and an empty node is None.
    """
    try:
        result = options.part(cls, node)
    except options.OptionError as error:
        raise ConfigurationError(error.at(key)) from error
    assert isinstance(result, cls)
    return result
