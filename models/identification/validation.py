"""Prediction errors of a model on a recording: one step, ten steps and a free run ahead.

Every prediction begins at a measured state and is driven by the recorded force. The one-step
prediction of a biased model is also nearly right, since the measured state corrects it at every
sample; ten steps and a free run, from the first sample to the last, show the bias. All three are
computed on the held-out part, so no identifier is evaluated on the data it was fitted to.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.free_run import (
    Course,
    course_of,
    deviations,
    predict,
    predicted_layout,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.plant_table import Flags, PlantTable
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

TEN = 10
AHEAD: dict[str, int | None] = {"one_step": 1, "ten_step": TEN, "free_run": None}
HIDES_BIAS = "one step ahead hides bias: judge by free_run"
RUNAWAY = 20.0  # limit of the rates, relative to the largest measured velocity
LEAST_LIMIT = 10.0  # least limit of the rates, as in Hoyer (2021), section 6.4


class Ahead(NamedTuple):
    """Errors of the predictions of a given number of steps."""

    rmse: Array  # (2 n_dof,) pose, then velocity
    limited: float  # share of the rates that had to be limited; above 0 the model diverges


@dataclass(frozen=True, eq=False)
class Prediction:
    """A model and the recording that it predicts."""

    plant: PlantTable
    course: Course

    def deviations(self, restart: Flags | None = None) -> tuple[Array, float]:
        """Predicted - measured, (N, 2 n_dof), and the share of rates that had to be limited.

        Attitudes differ by rotation vectors. Predictions begin where `restart` (N,) is true, by
        default where the course restarts.
        """
        course = self.course if restart is None else self.course._replace(restart=restart)
        states = np.empty_like(course.reached)
        count = predict(self.plant, course, False, states)
        return deviations(course.kinematics, course.reached, states), count / (4.0 * states.size)

    def ahead(self, steps: int | None) -> Ahead:
        """Errors `steps` samples after every measured state; None: those of the free run."""
        restart = self.course.restart
        if steps is None:
            errors, limited = self.deviations()
            return _ahead(errors[~restart], limited)
        index = np.arange(len(restart))
        since = index - np.maximum.accumulate(np.where(restart, index, 0))
        error_parts, limited = [], 0.0
        for first in range(steps + 1):  # the samples that are `steps` after such a restart
            errors, share = self.deviations(restart | ((since - first) % (steps + 1) == 0))
            reached = (since >= first + steps) & ((since - first) % (steps + 1) == steps)
            error_parts.append(errors[reached])
            limited += share
        return _ahead(np.vstack(error_parts), limited / (steps + 1))


def _ahead(rest: Array, limited: float) -> Ahead:
    if not len(rest):
        return Ahead(np.full(rest.shape[1], np.nan), limited)
    return Ahead(np.sqrt(np.mean(np.square(rest), axis=0)), limited)


def prediction(
    model: Vessel,
    recording: Recording,
    thruster: SecondOrderLag | None,
    force: str | None = None,
    horizon: int | None = None,
) -> Prediction:
    """The prediction of a recording by RK4, with a new start every `horizon` samples.

    Raises IdentificationError when the inertia of the model is not positive definite, or when a
    term needs a quantity that is not predicted, such as the heading in surge alone.
    """
    limit = max(LEAST_LIMIT, RUNAWAY * float(np.max(np.abs(recording.nu))))
    course = course_of(recording, thruster, force, horizon, limit, model.attitude)
    try:
        plan = predicted_layout(model.terms, model.dofs, model.theta != 0.0)
    except ConfigurationError as error:
        raise IdentificationError(str(error)) from error
    inverse, realistic = plan.inverse_inertia(model.theta[None])
    if not realistic[0]:
        raise IdentificationError("the inertia of the model is not positive definite")
    return Prediction(plan.plant(model.theta, inverse[..., 0]), course)
