"""Metrics of a trial as rows of the logbook; what they are is in the catalogue."""

from collections.abc import Iterable

from seatrial.models.vessel.basis import Array
from seatrial.runner.database.records import Metric
from seatrial.runner.record.catalogue import declared
from seatrial.runner.vocabulary import Stage


def metric(name: str, stage: Stage, model: str, dof: str, value: float) -> Metric:
    """A row with the unit that the catalogue declares.

    Raises KeyError for a name that is not declared, and for a degree of freedom that it has no
    unit for; ValueError for a stage that does not store it.
    """
    definition = declared(name)
    if stage not in definition.stages:
        expected = " or ".join(definition.stages)
        raise ValueError(f"metric {name}: got stage {stage}, expected {expected}")
    return Metric(stage, model, dof, name, float(value), definition.unit_of(dof))


def per_dof(
    name: str, stage: Stage, model: str, dofs: Iterable[str], values: Array
) -> list[Metric]:
    """One metric a degree of freedom; `values` has shape (n_dof,)."""
    return [metric(name, stage, model, dof, value) for dof, value in zip(dofs, values, strict=True)]
