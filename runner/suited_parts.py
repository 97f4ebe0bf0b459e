"""The excitation and the controller of a vessel that the defaults of a trial do not suit.

A lap of way-points under PID control is for a vessel by force in the plane, or one whose devices
give any force. Other vessels choose from the groups what is in `SUITED`, unless the command line
or an experiment does.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.runner.config import build_as
from seatrial.runner.vocabulary import Config

if TYPE_CHECKING:  # what is slow to import
    from seatrial.models.vessel import parameters
else:
    import lazy_loader

    parameters = lazy_loader.load("seatrial.models.vessel.parameters", suppress_warning=True)

Choice = Mapping[str, str]
SUITED: Mapping[str, Choice] = {
    "by force": {"excitation": "constant_velocity"},
    "by helm": {"excitation": "heading_changes", "controller": "autopilot"},
    "by other inputs": {"excitation": "input_prbs", "controller": "none"},
}
HELM = "delta"  # the input of `autopilot`


def suited_parts(vessel: Config) -> Choice:
    """Return the options by group; none for a vessel that the defaults suit, or that is invalid."""
    dofs, inputs = vessel.get("dofs"), vessel.get("inputs")
    if not isinstance(dofs, list):
        return {}
    if not inputs:
        return {} if {*PLANAR} == {*map(str, dofs)} else SUITED["by force"]
    if HELM in inputs and "yaw" in dofs:
        return SUITED["by helm"]
    if vessel.get("devices"):
        try:
            built = build_as(parameters.VesselParameters, vessel, "vessel")
        except ConfigurationError:
            return {}  # it is reported when the trial is built
        return {} if built.positioning else SUITED["by other inputs"]
    return SUITED["by other inputs"]
