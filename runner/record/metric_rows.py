"""Metrics of a trial as rows of the logbook; the catalogue defines them."""

from collections.abc import Iterable

from seatrial.models.vessel.basis import Array
from seatrial.runner.database.records import Metric
from seatrial.runner.record.catalogue import declared
from seatrial.runner.vocabulary import Stage


def metric(name: str, stage: Stage, model: str, dof: str, value: float) -> Metric:
    """Return a metric with the unit that the catalogue declares.

    Raises KeyError for an undeclared name, and for a degree of freedom without a unit; ValueError
    for a stage that does not store the metric.
    """
    definition = declared(name)
    if stage not in definition.stages:
        expected = " or ".join(definition.stages)
        raise ValueError(f"metric {name}: got stage {stage}, expected {expected}")
    return Metric(stage, model, dof, name, float(value), definition.unit_of(dof))


def per_dof(
    name: str, stage: Stage, model: str, dofs: Iterable[str], values: Array
) -> list[Metric]:
    """Return one metric per degree of freedom; `values` has shape (n_dof,)."""
    return [metric(name, stage, model, dof, value) for dof, value in zip(dofs, values, strict=True)]
