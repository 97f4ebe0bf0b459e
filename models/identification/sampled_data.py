"""A recording as the outputs and held inputs of a sampled linear model.

The output y_k is paired with the input that acts over [t_k, t_{k+1}).
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS, DOFS, PLANAR, VELOCITIES, poses_of
from seatrial.models.recording.recording import Recording, following
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, Array, Codes, Term
from seatrial.models.vessel.kinematics import in_body, spatial_reference_kernel
from seatrial.models.vessel.table import Vessel

FORCE = "tau_"  # begins the name of an input that is a force, such as tau_surge
UNEVEN = 1e-3  # of a period, by which the sample time of a measured recording may miss it


@dataclass(frozen=True, eq=False)
class Sampled:
    """Outputs (N, m) and inputs (N, r) of contiguous stretches, sampled every `period_s` [s].

    The first inputs are the forces, the others are terms of the motion or the attitude.
    """

    y: Array
    u: Array
    stretch: Codes  # (N,) index of the contiguous stretch
    period_s: float
    extra: tuple[Term, ...]  # the terms among the inputs
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    file: Codes | None = None  # (N,) number of the file, of a recording of several

    def parts(self) -> list[tuple[Array, Array]]:
        """Outputs and inputs of each contiguous stretch."""
        return stretches(self.y, self.u, self.stretch)


def stretches(y: Array, u: Array, stretch: Codes) -> list[tuple[Array, Array]]:
    """The rows of outputs and inputs for each contiguous stretch by its number (N,)."""
    edges = np.flatnonzero(np.diff(stretch)) + 1
    return list(zip(np.split(y, edges), np.split(u, edges), strict=True))


def forces_of(dofs: tuple[str, ...]) -> tuple[str, ...]:
    """The names of the forces in all degrees of freedom, as inputs."""
    return tuple(FORCE + dof for dof in dofs)


def sampled(
    recording: Recording,
    force: str | None,
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    period_s: float | None,
) -> Sampled:
    """Sample the outputs, and the mean of each input over a period.

    `inputs` are forces (`tau_surge`) and terms, `outputs` poses (`x`) in body axes and terms (`u`,
    `u_dot`). Raises ConfigurationError unless `period_s` is a multiple of the sample time (None:
    the sample time).
    """
    count, dofs = samples_in(period_s, recording.period_s), recording.dofs
    forces = [name for name in inputs if name.startswith(FORCE)]
    extra = basis.terms(name for name in inputs if name not in forces)
    pieces = np.split(np.arange(len(recording)), np.flatnonzero(recording.piece_starts)[1:])
    whole = np.concatenate([piece[: len(piece) // count * count] for piece in pieces])
    rows = whole[::count]
    terms = basis.evaluate(extra, recording.variables())
    terms = 0.5 * (terms + following(terms))  # the mean over a sample, as of the force
    columns = [dofs.index(name.removeprefix(FORCE)) for name in forces]
    acting = np.hstack([recording.held_force(force)[:, 1][:, columns], terms])[whole]
    poses = poses_of(dofs) if dofs in (PLANAR, DOFS) else ()  # elsewhere body axes are those of NED
    return Sampled(
        y=_measured(recording, outputs)[rows],
        u=acting.reshape(len(rows), count, acting.shape[1]).mean(axis=1),
        stretch=np.cumsum(recording.piece_starts)[rows] - 1,
        period_s=count * recording.period_s,
        extra=extra,
        inputs=(*forces, *(term.name for term in extra)),
        outputs=tuple(f"body {name}" if name in poses else name for name in outputs),
        file=None if recording.file is None else recording.file[rows],
    )


def samples_in(period_s: float | None, sample_time_s: float) -> int:
    """Samples of a recording in a period [s], None: one.

    Raises ConfigurationError, with the nearest multiples of the sample time, unless it is one.
    """
    ratio = 1.0 if period_s is None else period_s / sample_time_s
    if abs(round(ratio) - ratio) > UNEVEN * ratio:
        below = max(int(ratio), 1)
        nearest = " or ".join(f"{count * sample_time_s:g}" for count in (below, below + 1))
        raise ConfigurationError(
            f"identifier.period_s: got {period_s:g} s, expected a multiple of the recording's "
            f"sample time {sample_time_s:g} s, such as {nearest}"
        )
    return round(ratio)


def _measured(recording: Recording, names: tuple[str, ...]) -> Array:
    """The named poses, each contiguous part from its own origin, and terms; shape (N, m)."""
    poses, columns = poses_of(recording.dofs), dict[str, Array]()
    if set(names) & set(poses):
        parts = np.split(recording.eta, np.flatnonzero(recording.piece_starts)[1:])
        pose = np.vstack([body_pose(eta, recording.dofs) for eta in parts])
        columns |= dict(zip(poses, pose.T, strict=True))
    others = [name for name in names if name not in poses]
    values = basis.evaluate(basis.terms(others), recording.variables())
    columns |= dict(zip(others, values.T, strict=True))
    return np.column_stack([columns[name] for name in names])


def body_pose(eta: Array, dofs: tuple[str, ...]) -> Array:
    """Sum of pose increments in body axes, from 0: J^-1 delta eta, J half-way; shape (N, n_dof).

    Its rate is the body velocity at any attitude. eta (N, n_dof) is (x, y, psi) in the plane, (x,
    y, z, phi, theta, psi) in six degrees of freedom; in other degrees of freedom J is the identity.
    """
    steps, middle = np.diff(eta, axis=0), 0.5 * (eta[1:] + eta[:-1])
    if dofs == PLANAR:
        steps[:, :2] = in_body(steps[:, :2], middle[:, 2])
    elif dofs == DOFS:
        unused = np.empty(len(dofs))
        for position, step in zip(middle, steps, strict=True):
            path = np.column_stack([position, step, np.zeros(len(dofs))])
            spatial_reference_kernel(path, step, unused)
    return np.vstack([np.zeros(len(dofs)), np.cumsum(steps, axis=0)])


def check_signals(
    inputs: tuple[str, ...] | None, outputs: tuple[str, ...] | None, nominal: Vessel
) -> None:
    """Raise ConfigurationError for a signal that a recording of the vessel does not have."""
    own = {"inputs": forces_of(nominal.dofs), "outputs": poses_of(nominal.dofs)}
    known = {"1", *nominal.velocities, *nominal.accelerations, *basis.ATTITUDE, *AIR}
    for option, values in (("inputs", inputs), ("outputs", outputs)):
        for value in set(values or ()) - set(own[option]):
            names = set() if value.startswith(FORCE) else varying(basis.term(value))
            if not names or not names <= known:
                raise ConfigurationError(
                    f"identifier.{option}: got {value}, expected {', '.join(own[option])} or terms "
                    f"that vary of the motion in {', '.join(nominal.dofs)}"
                )


def is_further_input(term: Term) -> bool:
    """Whether a term can be an additional input: it varies and is not already in the model."""
    names = varying(term)
    return bool(names) and not names & set(ACCELERATIONS) and term.name not in VELOCITIES


def moves(term: Term) -> bool:
    """Whether a term contains a velocity; a term of the attitude alone is part of the stiffness."""
    return bool(varying(term) & {*VELOCITIES, *AIR})


def varying(term: Term) -> set[str]:
    """The variables in a term, without the constant."""
    return {basis.VARIABLES[code % basis.N_VARIABLES] for code in term.codes if code}
