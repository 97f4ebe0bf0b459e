"""User-defined metrics: the classes that the option `metrics` names.

A class declares its metric and computes it for a model on the held-out part of the recording, or
for a mission in deployment; docs/howto/plugins.md has an example.
"""

from abc import ABC
from collections.abc import Iterable, Mapping
from typing import ClassVar

from seatrial.models.errors import PartError
from seatrial.models.recording.recording import Recording
from seatrial.models.returned import checked_array, name_of
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.table import Vessel
from seatrial.runner.record.catalogue import Definition, register
from seatrial.runner.record.rows import Metric, metric
from seatrial.runner.record.vocabulary import Stage

STAGES: Mapping[str, Stage] = {"of_model": "validation", "of_voyage": "deployment"}


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


def own_rows(parts: Iterable[OwnMetric], method: str, model: str, *of: object) -> list[Metric]:
    """Compute the user-defined metrics of a model by one of their methods; raises PartError."""
    rows = []
    for part in parts:
        values, where = getattr(part, method)(*of), f"{name_of(part)}.{method}"
        if not isinstance(values, Mapping):
            raise PartError(f"{where}: got a {type(values).__name__}, expected values by axis")
        for dof, value in values.items():
            checked_array(part, f"{method}: {dof}", value, ())
            try:
                rows.append(metric(part.definition.name, STAGES[method], model, dof, value))
            except (KeyError, ValueError) as error:  # another axis or stage than it declares
                raise PartError(f"{where}: {error.args[0]}") from error
    return rows
