"""Instruments: the motion of a noise-free simulation under the recorded force.

Ljungberg's instruments Z(k) are the regressors of a model that is simulated with the same inputs:
they are correlated with the true motion and independent of the measurement noise. The closed-loop
simulation is used with a controller that applies the recorded force. In a recording under feedback
the force depends on past noise, but white noise at an instant is independent of a motion caused by
earlier forces.

The heading is measured, not simulated, since a simulated heading drifts, and its sine and cosine
would lose their correlation with the true ones. The wind is the mean of the measured wind in NED.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError, Diverged, IdentificationError
from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import CONTROLLERS, GUIDANCE, REFERENCES
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, in_ned
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather

DIVERGED_MULTIPLE = (
    20.0  # a simulation beyond this multiple of the largest measured velocity has diverged
)
STEP_S = 0.1  # longest integration step


class Playback(NamedTuple):
    """Recorded forces for every control period [N, Nm], shape (N, n_dof)."""

    forces: Array


class Adrift(NamedTuple):
    """Guidance and reference of an uncontrolled vessel."""

    gain: float = 0.0


@lean_kernel
def _apply_recorded_force(
    table: Playback, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """Apply the next recorded force; state (1,) is the number of forces applied."""
    k = int(state[0])
    for i in range(tau.shape[0]):
        tau[i], tau_fb[i] = table.forces[k, i], 0.0
    state[0] = k + 1.0


@lean_kernel
def _constant_setpoint(table: Adrift, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    for i in range(setpoint.shape[0]):
        setpoint[i] = table.gain


@lean_kernel
def _hold_setpoint(table: Adrift, state: Array, setpoint: Array) -> None:
    for i in range(state.shape[0]):
        state[i, 0] = setpoint[i]


CONTROLLERS[Playback] = _apply_recorded_force
GUIDANCE[Adrift] = _constant_setpoint
REFERENCES[Adrift] = _hold_setpoint


class Simulated(NamedTuple):
    """A recording with simulated motion in place of the measured one."""

    motion: Recording
    first: NDArray[np.bool_]  # (N,) measured states at which the simulation starts
    newest: float  # share of the stretches in which the motion is that of the first model


def simulated_motion(
    recording: Recording, models: Sequence[Vessel], force: str | None, restart_s: float | None
) -> Simulated:
    """The recording with the simulated motion of a model in place of the measured one.

    The simulation starts at the measured state in every stretch without a gap, and again every
    `restart_s` [s]. These samples have measurement noise and cannot be instruments. Each stretch
    is simulated by the first of the models that can be. Raises IdentificationError when none can.
    """
    wind = mean_wind(recording)
    limits = DIVERGED_MULTIPLE * np.max(np.abs(recording.nu), axis=0)
    limits = np.maximum(limits, 1e-3 * np.max(limits) + 1e-12)
    motions, first, newest = [], [], []
    for piece in stretches(recording, restart_s):
        which, motion = _by_the_first_able(piece, models, force, wind, limits)
        motions.append(motion)
        newest.append(which == 0)
        first.append(np.arange(len(piece)) == 0)
    nu, nu_dot = (np.concatenate(parts) for parts in zip(*motions, strict=True))
    heading = recording.attitude[:, 2]
    air = None if wind is None else in_body(np.tile(wind, (len(heading), 1)), heading)
    moved = replace(recording, nu=nu, nu_dot=nu_dot, wind=air)
    return Simulated(moved, np.concatenate(first), float(np.mean(newest)))


def _by_the_first_able(
    piece: Recording, models: Sequence[Vessel], force: str | None, wind: Array | None, limits: Array
) -> tuple[int, tuple[Array, Array]]:
    """The first of the models that can be simulated, with its velocity and acceleration."""
    *newer, last = models
    for which, model in enumerate(newer):
        with suppress(IdentificationError):
            return which, _moved(piece, model, force, wind, limits)
    return len(newer), _moved(piece, last, force, wind, limits)


def _moved(
    piece: Recording, model: Vessel, force: str | None, wind: Array | None, limits: Array
) -> tuple[Array, Array]:
    """Velocity and acceleration (N, n_dof) of a simulation of one stretch."""
    if model.forces_commanded:
        return _simulate(piece, model, force, wind, tuple(limits.tolist()))
    return _steered(piece, model, limits)


def stretches(recording: Recording, restart_s: float | None) -> list[Recording]:
    """The stretches without a gap, split into pieces of at least `restart_s` [s]."""
    pieces = recording.pieces()
    if restart_s is None:
        return pieces
    length = max(round(restart_s / recording.period_s), 2)
    parts = []
    for piece in pieces:
        edges = list(range(0, max(len(piece) - length, 0) + 1, length))
        ends = [*edges[1:], len(piece)]
        parts += [piece.part(slice(a, b)) for a, b in zip(edges, ends, strict=True)]
    return parts


def mean_wind(recording: Recording) -> Array | None:
    """Mean of the measured wind in NED [m/s], shape (2,); None if it was not measured."""
    if recording.wind is None:
        return None
    north_east = in_ned(recording.wind, recording.attitude[:, 2])
    return np.asarray(np.mean(north_east, axis=0))


def _steered(piece: Recording, model: Vessel, limits: Array) -> tuple[Array, Array]:
    """Velocity and acceleration of a model under the recorded inputs, (N, n_dof) each."""
    try:
        model.plant_table()
        course = course_of(piece, None, None, None, np.inf, model.attitude)
        with np.errstate(all="ignore"):
            motion = free_run(model, course, "rk4")
    except ConfigurationError as error:
        raise IdentificationError(f"the instruments cannot be simulated: {error}") from error
    nu = motion[:, len(model.dofs) :]
    if not np.all(np.abs(nu) <= limits):
        raise IdentificationError(
            "the simulation of the instruments diverges under the recorded inputs: a shorter "
            "restart_s keeps it near the measured motion"
        )
    attitude = attitude_of(model.dofs, motion[:, : len(model.dofs)])
    return nu, model.forward(np.zeros_like(nu), nu, attitude, piece.wind, piece.inputs)


def _simulate(
    piece: Recording,
    model: Vessel,
    force: str | None,
    wind: Array | None,
    limits: tuple[float, ...],
) -> tuple[Array, Array]:
    """Velocity and acceleration of a model from the first measured state on, (N, n_dof) each."""
    # A recorded acting force is that at the end of a period, exact if it follows the command
    # without lag; a force filtered by a known lag is continuous, so its mean is used.
    at_end = piece.force(force) is piece.tau_actual
    forces = piece.held_force(force)[:, 2 if at_end else 1]
    n, n_dof = forces.shape
    still = np.zeros((n, n_dof))
    weather = Weather(still, still, still, still)
    if wind is not None:
        weather = weather._replace(wind_ned=np.tile(wind, (n, 1)))
    adrift = Adrift()
    try:
        voyage = sail(
            Plant(model, None, limits), weather, (adrift, np.zeros(1)), adrift,
            (Playback(np.ascontiguousarray(forces)), np.zeros(1)), piece.eta[0],
            piece.period_s, min(STEP_S, piece.period_s), piece.nu[0],
        )  # fmt: skip
    except (Diverged, ConfigurationError) as error:
        raise IdentificationError(
            f"the simulation of the instruments fails under the recorded force: {error}; "
            f"a shorter restart_s keeps it near the measured motion"
        ) from error
    return voyage.log.nu, voyage.log.nu_dot
