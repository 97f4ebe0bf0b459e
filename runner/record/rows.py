"""The rows that a trial hands over for storage; the catalogue defines the metrics among them.

Numbers are in SI units and angles in radians unless `unit` says otherwise. NaN is stored as NULL.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.record.catalogue import declared
from seatrial.runner.record.vocabulary import Stage, Stream


@dataclass(frozen=True)
class Metric:
    """One figure of merit of a run."""

    stage: Stage
    model: str  # nominal, identified or plant
    dof: str  # surge, sway, heave, roll, pitch, yaw, position, heading or all
    name: str
    value: float | None
    unit: str


@dataclass(frozen=True)
class Coefficient:
    """One entry of a model: a hydrodynamic derivative, or an element of a matrix.

    `true_value` is the coefficient of the plant, if the plant is known.
    """

    model: str  # nominal, residual, identified (= nominal + residual) or plant
    dof: str
    term: str
    value: float | None
    std_error: float | None
    true_value: float | None
    unit: str


@dataclass(frozen=True)
class Series:
    """Columns of equal length, each of shape (n,), with the unit of each; stored as one file."""

    kind: str  # recording, residual, deployment_nominal, deployment_identified, ...
    columns: Mapping[str, NDArray[Any]]
    units: Mapping[str, str]

    def __post_init__(self) -> None:
        shapes = {column.shape for column in self.columns.values()}
        if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
            raise ValueError(f"series {self.kind}: expected columns of one length, got {shapes}")
        if odd := sorted(self.columns.keys() ^ self.units.keys()):
            raise ValueError(f"series {self.kind}: no column or no unit for {', '.join(odd)}")

    @property
    def n_rows(self) -> int:
        """The length of the columns."""
        return len(next(iter(self.columns.values()), ()))


@dataclass(frozen=True)
class Results:
    """The results of a run, which are stored beside its row."""

    metrics: Sequence[Metric] = ()
    coefficients: Sequence[Coefficient] = ()
    diagnostics: Sequence[Diagnostic] = ()  # rows of the table `diagnostic`
    series: Sequence[Series] = ()
    note: str | None = None
    drawn: Sequence[Stream] | None = None  # random streams that the results depend on, if known

    def __add__(self, other: "Results") -> "Results":
        return Results(
            [*self.metrics, *other.metrics],
            [*self.coefficients, *other.coefficients],
            [*self.diagnostics, *other.diagnostics],
            [*self.series, *other.series],
            self.note or other.note,
            self.drawn or other.drawn,
        )


def metric(name: str, stage: Stage, model: str, dof: str, value: SupportsFloat) -> Metric:
    """Return a metric with the unit that the catalogue declares.

    Raises KeyError for an undeclared name, and for a degree of freedom without a unit; ValueError
    for a stage that does not store the metric.
    """
    definition = declared(name)
    if stage not in definition.stages:
        expected = " or ".join(definition.stages)
        raise ValueError(f"metric {name}: got stage {stage}, expected {expected}")
    return Metric(stage, model, dof, name, float(value), definition.unit_of(dof))


def metrics(
    stage: Stage, model: str, dofs: Iterable[str], values: Mapping[str, object]
) -> list[Metric]:
    """Return the metrics of a model.

    The values by name are numbers of the whole vessel, arrays of shape (n_dof,), or mappings from
    other degrees of freedom to numbers.
    """
    rows = []
    for name, value in values.items():
        by_dof: Any = value
        if not isinstance(value, Mapping):
            by_dof = dict(zip(dofs, by_dof, strict=True)) if np.ndim(by_dof) else {"all": value}
        rows += [metric(name, stage, model, dof, number) for dof, number in by_dof.items()]
    return rows
