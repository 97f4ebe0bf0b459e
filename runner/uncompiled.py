"""Loops in Python, for controllers from elsewhere: how much longer they take than compiled ones."""

import logging

import numpy as np

from seatrial.models.compiled import is_compiled
from seatrial.models.control.controller import Controller
from seatrial.models.errors import name_of
from seatrial.models.simulation.dynamics import advance
from seatrial.models.simulation.loop import compiled_step_s
from seatrial.models.simulation.registry import CONTROLLERS, Parameters, State
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.parameters import Plant
from seatrial.runner.config import Trial
from seatrial.runner.plugins import is_own

log = logging.getLogger(__name__)
SLOW = (
    "controller {}: its step is Python, so the loop is not compiled: "
    "{:.2g} ms a step, {:.0f} times as long"
)
_said: set[str] = set()  # controllers of which this has been said


def slowdown(
    controller: Controller | None,
    control: tuple[Parameters, State],
    plant: Plant,
    voyage: Voyage,
    trial: Trial,
) -> float | None:
    """Return how many times longer a voyage took than in a compiled loop, and log it once.

    None for a compiled loop, without a compiler, and for the controllers of this package.
    """
    if controller is None or is_own(name := name_of(controller)):
        return None
    compiled = is_compiled(CONTROLLERS[type(control[0])]) or not is_compiled(advance)
    if compiled or not len(voyage.step_times):
        return None
    took = float(np.median(voyage.step_times))
    expected = compiled_step_s(plant, voyage.weather, trial.sample_time_s, trial.integration_step_s)
    if name not in _said:
        _said.add(name)
        log.info(SLOW.format(name, 1e3 * took, took / expected))
    return took / expected
