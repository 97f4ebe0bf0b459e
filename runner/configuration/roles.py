"""The class of each group's parts: a part may be any class that subclasses its role."""

from types import UnionType

from seatrial.models.control.controller import Controller
from seatrial.models.excitation.missions import Evaluation, Mission
from seatrial.models.identification.problem import Identifier
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.weather.disturbance import Disturbance
from seatrial.runner.record.own_metrics import OwnMetric

ROLES: dict[str, type | UnionType] = {
    "vessel": VesselParameters,
    "disturbance": Disturbance,
    "excitation": Mission | RecordedFile,
    "identifier": Identifier,
    "controller": Controller | None,
    "evaluation": Evaluation | None,
}
METRIC = OwnMetric


def only_validates(excitation: object, evaluation: object) -> bool:
    """Whether a trial has no deployment: a measured recording has no replay of its references."""
    return isinstance(excitation, RecordedFile) and not isinstance(evaluation, Mission)
