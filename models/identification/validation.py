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
from functools import cached_property
from itertools import pairwise
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
from seatrial.models.vessel.kinematics import euler_zyx
from seatrial.models.vessel.plant_table import Flags, PlantTable
from seatrial.models.vessel.pose import Quaternion
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.weather import Weather

TEN = 10
GRIDS = 5  # of starts, for predictions over a time
HORIZONS = ("one_step", "ten_step", "restarts", "free_run")
RESTART_S = 30.0  # longest time between the restarts of the horizon `restarts`
FEWEST_STEPS = 10  # samples between restarts
GROWTHS = 3.0  # times that the error of an unstable model takes to grow by a factor of e
GROWTH_STATES = 50  # recorded states at which the growth is taken
HIDES_BIAS = "one step ahead hides bias: judge by free_run"
DIVERGED_MULTIPLE = 20.0  # limit of the rates, relative to the largest measured velocity
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
    restart_s: float = RESTART_S  # of the horizon `restarts`

    def deviations(self, restart: Flags | None = None) -> tuple[Array, float]:
        """Predicted - measured, (N, 2 n_dof), and the share of rates that had to be limited.

        Attitudes differ by rotation vectors. Predictions begin where `restart` (N,) is true, by
        default where the course restarts.
        """
        states, limited = self._states(self.course.restart if restart is None else restart)
        return deviations(self.course.kinematics, self.course.reached, states), limited

    def _states(self, restart: Flags) -> tuple[Array, float]:
        """Predicted states (N, n_pose + n_dof), and the share of rates that had to be limited."""
        states = np.empty_like(self.course.reached)
        count = predict(self.plant, self.course._replace(restart=restart), False, states)
        return states, count / (4.0 * states.size)

    @cached_property
    def free_run(self) -> tuple[Array, float]:
        """States (N, n_pose + n_dof) of the free run, and the share of limited rates."""
        return self._states(self.course.restart)

    def motion(self) -> Array:
        """Predicted pose and velocity (N, 2 n_dof) of the free run; NaN from where it diverges."""
        states, limited = self.free_run
        motion = self.motion_of(states)
        if limited:
            motion[self.lost()] = np.nan
        return motion

    def motion_of(self, states: Array) -> Array:
        """Pose and velocity (N, 2 n_dof) of states (N, n_pose + n_dof)."""
        pose, n_dof = states, self.course.measured.shape[1] // 2
        if isinstance(self.course.kinematics, Quaternion):
            pose = np.hstack([states[:, :3], euler_zyx(states[:, 3:7])])
        return np.hstack([pose[:, :n_dof], states[:, -n_dof:]])

    def lost(self) -> Flags:
        """True (N,) from the first limited rate of each piece of the free run on."""
        edges = [*np.flatnonzero(self.course.restart).tolist(), len(self.course.reached)]
        lost = np.zeros(len(self.course.reached), dtype=bool)
        for first, last in pairwise(edges):
            held = _held(self.plant, _part(self.course, slice(first, last)))
            lost[first + held : last] = True
        return lost

    def over(self, horizon: str) -> Ahead:
        """Errors over one of the HORIZONS."""
        match horizon:
            case "one_step":
                return self.ahead(1)
            case "ten_step":
                return self.ahead(TEN)
            case "restarts":
                return self.restarted(max(round(self.restart_s / self.course.step_s), 2))
            case _:
                states, limited = self.free_run
                errors = deviations(self.course.kinematics, self.course.reached, states)
                return _ahead(errors[~self.course.restart], limited)

    def restarted(self, every: int) -> Ahead:
        """Errors of a free run that begins anew every `every` samples."""
        restart = self.course.restart | (since(self.course.restart) % every == 0)
        errors, limited = self.deviations(restart)
        return _ahead(errors[~restart], limited)

    def ahead(self, steps: int, grids: int | None = None) -> Ahead:
        """Errors `steps` samples after measured states: after all of them, or on `grids` grids.

        The states of a grid follow each other at steps + 1 samples.
        """
        error_parts, limited = [], 0.0
        shifts = self._shifts(steps, grids)
        for first in shifts:
            states, reached, share = self._from(first, steps)
            course = self.course
            error_parts.append(deviations(course.kinematics, course.reached, states)[reached])
            limited += share
        return _ahead(np.vstack(error_parts), limited / len(shifts))

    def motion_after(self, seconds: float) -> Array:
        """Pose and velocity (N, 2 n_dof) predicted from the state measured `seconds` before.

        Starts are on GRIDS grids; NaN at the other samples, and on a grid that diverges.
        """
        steps = max(round(seconds / self.course.step_s), 1)
        motion = np.full_like(self.course.measured, np.nan)
        for first in self._shifts(steps, GRIDS):
            states, reached, limited = self._from(first, steps)
            if not limited:
                motion[reached] = self.motion_of(states)[reached]
        return motion

    @staticmethod
    def _shifts(steps: int, grids: int | None) -> range:
        """First samples of the grids, each with a start every steps + 1 samples."""
        return range(0, steps + 1, max((steps + 1) // (grids or steps + 1), 1))

    def _from(self, first: int, steps: int) -> tuple[Array, Flags, float]:
        """States predicted on one grid, which of them are `steps` after a start, limited share."""
        elapsed = since(self.course.restart)
        place = (elapsed - first) % (steps + 1)
        states, limited = self._states(self.course.restart | (place == 0))
        return states, (elapsed >= first + steps) & (place == steps), limited

    def held_s(self) -> float:
        """Time [s] that the free run held until a rate had to be limited; its length if none."""
        if not self.free_run[1]:  # the usual case, without the search
            return self.course.step_s * (len(self.course.reached) - 1)
        return self.course.step_s * max(_held(self.plant, self.course) - 1, 0)

    def sensitivity(self, deviation: Array) -> Array:
        """How two free runs from states that are `deviation` (2 n_dof,) apart differ, (n_dof,).

        Root mean square of the velocities over that of the measured motion about its mean. Near one
        the first state decides the run, not the model: even the true one is as wrong as others.
        """
        count = int(np.count_nonzero(self.course.restart))
        moved = self.course.with_offset(np.tile(deviation, (count, 1)))
        other, _ = Prediction(self.plant, moved)._states(moved.restart)
        n_dof = len(deviation) // 2
        apart = (other - self.free_run[0])[:, -n_dof:]
        size = np.std(self.course.measured[:, n_dof:], axis=0)
        rms = np.sqrt(np.mean(np.square(apart), axis=0))
        return np.asarray(np.divide(rms, size, out=np.zeros(n_dof), where=size > 0.0))

    def mean_motion(self) -> Array:
        """RMSE (2 n_dof,) of a model that always predicts the mean of the measured motion."""
        return spread(self.course)


def _held(plant: PlantTable, course: Course) -> int:
    """Number of samples that a free run holds until a rate has to be limited."""
    states = np.empty_like(course.reached)

    def lost(n: int) -> bool:
        """Whether a rate of the first n samples had to be limited."""
        return bool(predict(plant, _part(course, slice(0, n)), False, states[:n]))

    return bisect_left(range(1, len(states) + 1), True, key=lost)


def _part(course: Course, rows: slice) -> Course:
    """Consecutive samples of a course."""
    weather = Weather(*(part[rows] for part in course.weather))
    return course._replace(
        acting=course.acting[rows], weather=weather, measured=course.measured[rows],
        reached=course.reached[rows], start=course.start[rows], restart=course.restart[rows],
    )  # fmt: skip


def _ahead(rest: Array, limited: float) -> Ahead:
    if not len(rest):
        unknown = np.full(rest.shape[1], np.nan)
        return Ahead(unknown, limited, unknown)
    return Ahead(np.sqrt(np.mean(np.square(rest), axis=0)), limited, np.std(rest, axis=0))


def bounded_course(
    recording: Recording,
    thruster: SecondOrderLag | None,
    force: str | None,
    horizon: int | None,
    attitude: str,
) -> Course:
    """The course of a recording; a prediction that exceeds the limits of its rates has diverged.

    They are many times the largest velocity, and that velocity within one sample: a large force may
    well accelerate a light model.
    """
    limit = max(LEAST_LIMIT, DIVERGED_MULTIPLE * float(np.max(np.abs(recording.nu))))
    acceleration = max(limit, limit / recording.period_s)
    return course_of(recording, thruster, force, horizon, limit, attitude, acceleration)


def prediction(
    model: Vessel,
    recording: Recording,
    thruster: SecondOrderLag | None,
    force: str | None = None,
    horizon: int | None = None,
    restart_s: float = RESTART_S,
) -> Prediction:
    """The prediction of a recording by RK4, with a new start every `horizon` samples.

    Raises InertiaError when the inertia of the model is not positive definite, and
    IdentificationError when a term needs a quantity that is not predicted, such as the heading in
    surge alone.
    """
    course = bounded_course(recording, thruster, force, horizon, model.attitude)
    return predicted_by(model, course, restart_s)


def predicted_by(model: Vessel, course: Course, restart_s: float = RESTART_S) -> Prediction:
    """The prediction of a course; raises the errors of `prediction`."""
    try:
        plan = predicted_layout(model, model.theta != 0.0)
    except ConfigurationError as error:
        raise IdentificationError(str(error)) from error
    inverse, realistic = plan.inverse_inertia(model.theta[None])
    if not realistic[0]:
        raise InertiaError("the inertia of the model is not positive definite")
    return Prediction(plan.plant(model.theta, inverse[..., 0]), course, restart_s)


def restart_length(nominal: Vessel, recording: Recording) -> float:
    """Time [s] between restarts over which the errors of a model say more of it than of chance.

    A vessel that is unstable on a straight course amplifies every error of the state: over many
    times 1 / g even the exact model is as wrong as any other. g is the largest real part of the
    eigenvalues of d nu_dot / d nu, where positive, of the nominal model at recorded states with
    their inputs and wind, on average.
    """
    rows = np.unique(np.linspace(0, len(recording) - 1, GROWTH_STATES).round().astype(int))
    part = recording.part(rows)
    nu, n_dof = part.nu, len(recording.dofs)
    steps = 1e-4 * np.maximum(np.std(recording.nu, axis=0), 1e-3)
    jacobian = np.empty((len(nu), n_dof, n_dof))
    for k, step in enumerate(steps):
        ahead, behind = (
            nominal.forward(
                np.zeros_like(nu), nu + sign * step * np.eye(n_dof)[k], part.attitude, part.wind,
                part.inputs,
            )
            for sign in (1.0, -1.0)
        )  # fmt: skip
        jacobian[:, :, k] = (ahead - behind) / (2.0 * step)
    growth = float(np.mean(np.maximum(np.max(np.linalg.eigvals(jacobian).real, axis=1), 0.0)))
    shortest = FEWEST_STEPS * recording.period_s
    return min(RESTART_S, max(GROWTHS / growth, shortest)) if growth > 0.0 else RESTART_S
