"""From the resolved configuration of one trial to checked, frozen objects.

A node of the configuration names its class with `_target_`: a frozen dataclass of the role of its
group, in any module. Its keys are the dataclass's fields, its values are checked against their
annotations, with their ranges, by pydantic (configuration/options.py). Every error names the key,
what was got and what was expected.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from annotated_types import Le

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegativeInt, Positive
from seatrial.models.vessel.tuning import FromVessel
from seatrial.runner import database
from seatrial.runner.database.terminal import refuse_passwords
from seatrial.runner.record.vocabulary import GROUPS

if TYPE_CHECKING:  # what is slow to import
    from seatrial.models.control import controller as controllers
    from seatrial.models.excitation import missions
    from seatrial.models.identification import adaptive, problem
    from seatrial.models.recording import recorded_file
    from seatrial.models.vessel import parameters
    from seatrial.models.weather import disturbance as disturbances
    from seatrial.runner.configuration import named_files, options
    from seatrial.runner.record import own_metrics
else:  # each by its literal name, which the digest of the sources looks for
    import lazy_loader

    controllers = lazy_loader.load("seatrial.models.control.controller", suppress_warning=True)
    missions = lazy_loader.load("seatrial.models.excitation.missions", suppress_warning=True)
    adaptive = lazy_loader.load("seatrial.models.identification.adaptive", suppress_warning=True)
    problem = lazy_loader.load("seatrial.models.identification.problem", suppress_warning=True)
    recorded_file = lazy_loader.load(
        "seatrial.models.recording.recorded_file", suppress_warning=True
    )
    parameters = lazy_loader.load("seatrial.models.vessel.parameters", suppress_warning=True)
    disturbances = lazy_loader.load("seatrial.models.weather.disturbance", suppress_warning=True)
    options = lazy_loader.load("seatrial.runner.configuration.options", suppress_warning=True)
    named_files = lazy_loader.load(
        "seatrial.runner.configuration.named_files", suppress_warning=True
    )
    own_metrics = lazy_loader.load("seatrial.runner.record.own_metrics", suppress_warning=True)

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


@dataclass(frozen=True)
class PlantChange:
    """A change of the plant in the deployment, from `at_s` [s] on, to `scale` x the nominal."""

    at_s: Positive
    scale: Positive


@dataclass(frozen=True)
class PlantOptions:
    """The true plant: `scale` x the nominal coefficient table."""

    scale: Annotated[Positive, FromVessel("plant_scale")]
    change: PlantChange | None = None


@dataclass(frozen=True)
class SweepLabels:
    """Labels of the sweep that a trial belongs to; they do not change its results."""

    name: str | None = None
    tags: tuple[str, ...] = ()
    note: str | None = None


@dataclass(frozen=True)
class Database:
    """The address of the logbook; None: a SQLite file in the folder of results."""

    url: str | None

    def __post_init__(self) -> None:
        refuse_passwords([self.url or ""])


@dataclass(frozen=True)
class Settings:
    """The options of a trial with their parts, in the structure of the configuration."""

    vessel: "parameters.VesselParameters"
    disturbance: "disturbances.Disturbance"
    excitation: "missions.Mission | recorded_file.RecordedFile"
    identifier: "problem.Identifier"
    controller: "controllers.Controller | None"
    evaluation: "missions.Evaluation | None"
    seed: Annotated[NotNegativeInt, Le(2**63 - 1)]  # which databases hold
    sample_time_s: Positive  # control and logging period
    integration_step_s: Positive  # of the plant's simulation
    plant: PlantOptions
    results_dir: Path
    database: Database
    update: "adaptive.Update | None" = None  # of the model during the deployment
    metrics: "tuple[own_metrics.OwnMetric, ...]" = ()  # user-defined metrics
    horizons_s: tuple[Positive, ...] | None = None  # of predictions beside the free run
    limits: Limits = Limits()  # of its size
    deploy_unphysical: bool = False  # whether a model that creates energy is deployed too
    model_error: bool = True  # whether it is calibrated, of a model with a distribution
    rerun: bool = False
    dry_run: bool = False
    sweep: SweepLabels = SweepLabels()

    def __post_init__(self) -> None:
        if self.integration_step_s > self.sample_time_s:
            raise ConfigurationError(
                f"integration_step_s must not be above sample_time_s = {self.sample_time_s:g}, "
                f"got {self.integration_step_s:g}"
            )


@dataclass(frozen=True, kw_only=True)
class Trial(Settings):
    """One checked trial; a group without a part is None.

    `names` are the options chosen from each group; `config` is the resolved configuration of the
    trial.
    """

    names: Mapping[str, str]
    config: Node
    samples: int | None = None  # to train, to test and to deploy with, at most; None: all

    @property
    def database_url(self) -> str:
        """The address of the logbook; by default a SQLite file in the folder of results."""
        return self.database.url or database.engine.file_url(self.results_dir / "results.db")


def build_trial(config: Node, names: Mapping[str, str]) -> Trial:
    """Build the trial of a resolved configuration; raises ConfigurationError if it is invalid.

    A measured recording without a mission to evaluate has no deployment.
    """
    nodes = {**config, **{group: config.get(group) or None for group in GROUPS}}
    nodes["excitation"] = named_files.with_map(nodes["excitation"])
    nodes["evaluation"] = named_files.with_harbours(nodes["evaluation"])
    parts = vars(build_as(Settings, nodes, ""))
    is_recording = isinstance(parts["excitation"], recorded_file.RecordedFile)
    if is_recording and not isinstance(parts["evaluation"], missions.Mission):
        parts = {**parts, "controller": None, "evaluation": None}
        names = {**names, "controller": "none", "evaluation": "none"}
    return Trial(**parts, names=names, config=config)


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
