"""Prediction errors of a model on a recording: a few steps ahead, over restarts, in a free run.

Every prediction begins at a measured state and is driven by the recorded force. The one-step
prediction of a biased model is also nearly right, since the measured state corrects it at every
sample; ten steps, predictions of 30 s and a free run, from the first sample to the last, show the
bias. All are computed on the held-out part, so no identifier is evaluated on the data it was fitted
to. A prediction whose rates had to be limited has diverged: its errors have no meaning.

Scores without unit compare the errors e with the measured signal y, per axis: the root mean square
error over the standard deviation of y (NRMSE), FIT = 100 (1 - NRMSE) %, R^2 = 1 - NRMSE^2 and the
variance accounted for, VAF = 100 (1 - var(e) / var(y)) %. A model that always predicts the mean of
y has a FIT of 0. Ljung (1999), System Identification, section 16.4.
"""

from bisect import bisect_left
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
    since,
    spread,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.plant_table import Flags, PlantTable
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.weather import Weather

TEN = 10
HORIZONS = ("one_step", "ten_step", "restarts", "free_run")
RESTART_S = 30.0  # between the restarts of the horizon `restarts`
HIDES_BIAS = "one step ahead hides bias: judge by free_run"
RUNAWAY = 20.0  # limit of the rates, relative to the largest measured velocity
LEAST_LIMIT = 10.0  # least limit of the rates, as in Hoyer (2021), section 6.4


class InertiaError(IdentificationError):
    """A model that cannot be simulated, because its inertia is not positive definite."""


class Ahead(NamedTuple):
    """Errors of the predictions over one horizon, per axis: pose, then velocity (2 n_dof,)."""

    rmse: Array
    limited: float  # share of the rates that had to be limited; above 0 the model diverges
    std: Array  # of the errors, without their mean

    @property
    def diverged(self) -> bool:
        """Whether a rate had to be limited."""
        return self.limited > 0.0


class Scores(NamedTuple):
    """Scores per axis without unit, shape (2 n_dof,); NaN for an axis that does not move."""

    fit: Array  # [%]
    r2: Array
    vaf: Array  # [%]


def scores(ahead: Ahead, spread: Array) -> Scores:
    """Scores of the errors beside the standard deviations of the measured signals (2 n_dof,)."""
    moved = np.where(spread > 0.0, spread, np.nan)
    nrmse = ahead.rmse / moved
    return Scores(
        100.0 * (1.0 - nrmse), 1.0 - np.square(nrmse), 100.0 * (1.0 - np.square(ahead.std / moved))
    )


def combined(score: Array) -> float:
    """Mean of a score over the axes that moved, as nonlinearbenchmark.org combines them.

    The FIT of all axes is so 100 (1 - mean NRMSE) %; NaN if no axis moved.
    """
    known = score[~np.isnan(score)]
    return float(np.mean(known)) if len(known) else float("nan")


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

    def over(self, horizon: str) -> Ahead:
        """Errors over one of the HORIZONS."""
        match horizon:
            case "one_step":
                return self.ahead(1)
            case "ten_step":
                return self.ahead(TEN)
            case "restarts":
                return self.ahead(None, max(round(RESTART_S / self.course.step_s), 2))
            case _:
                return self.ahead(None)

    def ahead(self, steps: int | None, every: int | None = None) -> Ahead:
        """Errors `steps` samples after every measured state; None: those of the free run.

        A free run begins anew every `every` samples, by default only where the course restarts.
        """
        restart = self.course.restart
        elapsed = since(restart)
        if steps is None:
            if every is not None:
                restart = restart | (elapsed % every == 0)
            errors, limited = self.deviations(restart)
            return _ahead(errors[~restart], limited)
        error_parts, limited = [], 0.0
        for first in range(steps + 1):  # the samples that are `steps` after such a restart
            errors, share = self.deviations(restart | ((elapsed - first) % (steps + 1) == 0))
            reached = (elapsed >= first + steps) & ((elapsed - first) % (steps + 1) == steps)
            error_parts.append(errors[reached])
            limited += share
        return _ahead(np.vstack(error_parts), limited / (steps + 1))

    def held_s(self) -> float:
        """Time [s] that the free run held until a rate had to be limited; its length if none."""
        states = np.empty_like(self.course.reached)

        def lost(n: int) -> bool:
            """Whether a rate of the first n samples had to be limited."""
            return bool(predict(self.plant, _first(self.course, n), False, states[:n]))

        if not lost(len(states)):  # the usual case, without the search
            return self.course.step_s * (len(states) - 1)
        held = bisect_left(range(1, len(states) + 1), True, key=lost)
        return self.course.step_s * max(held - 1, 0)

    def mean_motion(self) -> Array:
        """RMSE (2 n_dof,) of a model that always predicts the mean of the measured motion."""
        return spread(self.course)


def _first(course: Course, n: int) -> Course:
    """The first n samples of a course."""
    weather = Weather(*(part[:n] for part in course.weather))
    return course._replace(
        acting=course.acting[:n], weather=weather, measured=course.measured[:n],
        reached=course.reached[:n], start=course.start[:n], restart=course.restart[:n],
    )  # fmt: skip


def _ahead(rest: Array, limited: float) -> Ahead:
    if not len(rest):
        unknown = np.full(rest.shape[1], np.nan)
        return Ahead(unknown, limited, unknown)
    return Ahead(np.sqrt(np.mean(np.square(rest), axis=0)), limited, np.std(rest, axis=0))


def rate_limit(recording: Recording) -> float:
    """Limit of the rates [m/s, rad/s, per second again], beyond which a prediction has diverged."""
    return max(LEAST_LIMIT, RUNAWAY * float(np.max(np.abs(recording.nu))))


def prediction(
    model: Vessel,
    recording: Recording,
    thruster: SecondOrderLag | None,
    force: str | None = None,
    horizon: int | None = None,
) -> Prediction:
    """The prediction of a recording by RK4, with a new start every `horizon` samples.

    Raises InertiaError when the inertia of the model is not positive definite, and
    IdentificationError when a term needs a quantity that is not predicted, such as the heading in
    surge alone.
    """
    course = course_of(recording, thruster, force, horizon, rate_limit(recording), model.attitude)
    try:
        plan = predicted_layout(model, model.theta != 0.0)
    except ConfigurationError as error:
        raise IdentificationError(str(error)) from error
    inverse, realistic = plan.inverse_inertia(model.theta[None])
    if not realistic[0]:
        raise InertiaError("the inertia of the model is not positive definite")
    return Prediction(plan.plant(model.theta, inverse[..., 0]), course)
