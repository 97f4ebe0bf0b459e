"""User-defined metrics: the classes that the option `metrics` names.

A class declares its metric and computes it for a model on the held-out part of the recording, or
for a mission in deployment:

    @dataclass(frozen=True)
    class LargestSpeed(OwnMetric):
        definition = Definition(
            "speed_max", ("deployment",), {"surge": "m/s"}, "lower", "Largest speed", "max |u|"
        )

        def of_voyage(self, voyage: Voyage) -> Mapping[str, float]:
            return {"surge": float(np.max(np.abs(voyage.log.nu[:, 0])))}
"""

from abc import ABC
from collections.abc import Mapping, Sequence
from typing import ClassVar

from seatrial.models.errors import PartError
from seatrial.models.recording.recording import Recording
from seatrial.models.returned import checked_array, name_of
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.table import Vessel
from seatrial.runner.record.catalogue import Definition, register
from seatrial.runner.record.rows import Metric, metric
from seatrial.runner.record.vocabulary import Stage


class OwnMetric(ABC):
    """A user-defined metric. Its methods return one value per degree of freedom."""

    definition: ClassVar[Definition]

    def __init_subclass__(cls) -> None:
        """Register the metric, so that tables know it in every program that imports its module."""
        super().__init_subclass__()
        if "definition" in vars(cls):
            register(cls.definition)

    def of_model(self, held_out: Recording, model: Vessel) -> Mapping[str, float]:
        """Compute the metric of a model on the held-out part of a recording; empty by default."""
        return {}

    def of_voyage(self, voyage: Voyage) -> Mapping[str, float]:
        """Compute the metric of a mission in deployment; empty by default."""
        return {}


def validation_rows(
    parts: Sequence[OwnMetric], held_out: Recording, models: Mapping[str, Vessel]
) -> list[Metric]:
    """Compute the user-defined metrics of every model."""
    return [
        row
        for part in parts
        for name, model in models.items()
        for row in _rows(part, "validation", name, part.of_model(held_out, model))
    ]


def deployment_rows(parts: Sequence[OwnMetric], voyage: Voyage, model: str) -> list[Metric]:
    """Compute the user-defined metrics of a mission in deployment."""
    return [
        row for part in parts for row in _rows(part, "deployment", model, part.of_voyage(voyage))
    ]


def _rows(part: OwnMetric, stage: Stage, model: str, values: Mapping[str, float]) -> list[Metric]:
    method = "of_model" if stage == "validation" else "of_voyage"
    if not isinstance(values, Mapping):
        got = type(values).__name__
        raise PartError(f"{name_of(part)}.{method}: got a {got}, expected values by axis")
    for dof, value in values.items():
        checked_array(part, f"{method}: {dof}", value, ())
    name = register(part.definition).name
    try:
        return [metric(name, stage, model, dof, value) for dof, value in values.items()]
    except (KeyError, ValueError) as error:  # another axis or stage than it declares
        raise PartError(f"{name_of(part)}.{method}: {error.args[0]}") from error
