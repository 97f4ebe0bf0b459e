"""Instruments: the motion of a noise-free simulation under the recorded force.

Ljungberg's instruments Z(k) are the regressors of a model that is simulated with the same inputs:
they are correlated with the true motion and independent of the measurement noise. In a recording
under feedback the force depends on past noise, but white noise at an instant is independent of a
motion caused by earlier forces.

The heading is measured, not simulated, since a simulated heading drifts, and its sine and cosine
would lose their correlation with the true ones. The wind is the mean of the measured wind in NED.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.free_run import Course, course_of, free_run
from seatrial.models.identification.residual import evaluated
from seatrial.models.identification.validation import DIVERGED_MULTIPLE
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, in_ned
from seatrial.models.vessel.plant_table import Flags
from seatrial.models.vessel.table import Vessel

STEP_S = 0.1  # longest integration step


class Simulated(NamedTuple):
    """A recording with simulated motion in place of the measured one."""

    motion: Recording
    first: Flags  # (N,) measured states at which the simulation starts
    newest: float  # share of the stretches in which the motion is that of the first model


def simulated_motion(
    recording: Recording, models: Sequence[Vessel], force: str | None, restart_s: float | None
) -> Simulated:
    """The recording with the simulated motion of a model in place of the measured one.

    The simulation starts at the measured state in every stretch without a gap, and again every
    `restart_s` [s]. These samples have measurement noise and cannot be instruments. Each stretch
    is simulated by the first of the models that can be. Raises IdentificationError when none can.
    """
    wind, first = None, stretch_starts(recording, restart_s)
    if recording.wind is not None:
        wind = np.mean(in_ned(recording.wind, recording.attitude[:, 2]), axis=0)
    begin, fastest = np.flatnonzero(first), DIVERGED_MULTIPLE * np.max(np.abs(recording.nu), axis=0)
    limits = np.maximum(fastest, 1e-3 * np.max(fastest) + 1e-12)
    nu, nu_dot = np.empty_like(recording.nu), np.empty_like(recording.nu)
    left, shares = np.full(len(begin), True), []
    for model in models:
        try:
            motion = _moved(recording, model, force, wind, first)
            inside = np.all(np.abs(motion[0]) <= limits, axis=1)
        except ConfigurationError as error:
            why, inside = f"cannot be simulated: {error}", np.full(len(first), False)
        else:
            why = "diverge under the recorded force or inputs: try a shorter restart_s"
        able = left & np.logical_and.reduceat(inside, begin)
        rows = np.repeat(able, np.diff(begin, append=len(first)))
        if np.any(able):
            nu[rows], nu_dot[rows] = (values[rows] for values in motion)
        left &= ~able
        shares.append(float(np.mean(able)))
        if not np.any(left):
            break
    else:
        raise IdentificationError(f"the instruments {why}")
    heading = recording.attitude[:, 2]
    air = None if wind is None else in_body(np.tile(wind, (len(heading), 1)), heading)
    moved = replace(recording, nu=nu, nu_dot=nu_dot, wind=air)
    return Simulated(moved, first, shares[0])


def stretch_starts(recording: Recording, restart_s: float | None) -> Flags:
    """True (N,) where a stretch without a gap begins, or a part of it of `restart_s` [s]."""
    first = recording.piece_starts.copy()
    if restart_s is not None:
        length = max(round(restart_s / recording.period_s), 2)
        edges = [*np.flatnonzero(first).tolist(), len(first)]
        for a, b in pairwise(edges):
            first[a : max(b - length, a) + 1 : length] = True
    return first


def _moved(
    recording: Recording, model: Vessel, force: str | None, wind: Array | None, first: Flags
) -> tuple[Array, Array]:
    """Velocity and acceleration (N, n_dof) of a model from the measured states at `first` on.

    Raises ConfigurationError for a model that cannot be simulated.
    """
    n, commanded, every = len(model.dofs), model.forces_commanded, 1
    model.plant_table()
    course = course_of(recording, None, None, None, np.inf, model.attitude)
    course = course._replace(restart=first)
    if commanded:
        course, every = _held(course, _held_force(recording, force), wind)
    with np.errstate(all="ignore"):
        motion = free_run(model, course, "rk4")[::every]
        nu, attitude = motion[:, n:], attitude_of(model.dofs, motion[:, :n])
        acting, air = np.zeros_like(nu), recording.wind
        if commanded:  # the acceleration is that before a command takes effect
            acting[1:] = _held_force(recording, force)[:-1]
            acting[first] = 0.0
            air = None if wind is None else in_body(np.tile(wind, (len(nu), 1)), attitude[:, 2])
        moved = replace(recording, nu=nu, attitude=attitude, wind=air, tau=acting)
        (nu_dot,) = evaluated(
            moved, lambda at: model.forward(at.tau, at.nu, at.attitude, at.wind, at.inputs)
        )
    return nu, nu_dot


def _held_force(piece: Recording, force: str | None) -> Array:
    """The recorded force over each sample [N, Nm], (N, n_dof).

    A recorded acting force is that at the end of a period, exact if it follows the command without
    lag; a force filtered by a known lag is continuous, so its mean is used.
    """
    at_end = piece.force(force) is piece.tau_actual
    return np.asarray(piece.held_force(force)[:, 2 if at_end else 1])


def _held(course: Course, forces: Array, wind: Array | None) -> tuple[Course, int]:
    """The course under held forces (N, n_dof) and a wind in NED, and its steps in a sample."""
    every = max(int(np.ceil(course.step_s / STEP_S - 1e-9)), 1)
    measured, reached, acting = (
        np.repeat(values, every, axis=0) for values in (course.measured, course.reached, forces)
    )
    restart = np.zeros(len(acting), dtype=np.bool_)
    restart[::every] = course.restart
    weather = course.weather._replace(wind_body=np.zeros((0, 2)))
    if wind is not None:
        weather = weather._replace(wind_ned=np.tile(wind, (len(acting), 1)))
    return course._replace(
        acting=np.ascontiguousarray(np.repeat(acting[:, None], 3, axis=1)), weather=weather,
        measured=measured, reached=reached, start=reached, restart=restart,
        step_s=course.step_s / every,
    ), every  # fmt: skip
