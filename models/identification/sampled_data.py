"""A recording as the outputs and held inputs of a sampled linear model, and their Hankel matrices.

The output y_k is paired with the input that acts over [t_k, t_{k+1}).

The rows of the block Hankel matrices are windows in time, the columns the samples in a window: the
transpose of the literature's matrices. A window never contains a gap in the data, and a bootstrap
may repeat windows. Only a block of rows is in memory at a time, so that the memory does not grow
with the recording.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.linear import triangle, turns
from seatrial.models.notation import ACCELERATIONS, DOFS, PLANAR, VELOCITIES, poses_of
from seatrial.models.recording.recording import Recording, following
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, Array, Codes, Term
from seatrial.models.vessel.kinematics import in_body, spatial_reference_kernel
from seatrial.models.vessel.table import Vessel

Output = Literal["body_pose", "pose"]
MIN_SINGULAR_RATIO = (
    1e-11  # least ratio of smallest to largest singular value of the inputs' Hankel matrix
)


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
    heading: float  # [rad] between the axes of the output and those of the body
    file: Codes | None = None  # (N,) number of the file, of a recording of several


def sampled(
    recording: Recording,
    force: str | None,
    extra: tuple[Term, ...],
    output: Output,
    period_s: float | None,
    span: float,
    forces: tuple[str, ...] | None = None,
    outputs: tuple[str, ...] | None = None,
) -> Sampled:
    """Sample the pose, and the mean of the force and the `extra` terms over each period.

    `forces` are the degrees of freedom of the forces among the inputs, `outputs` poses (`x`) and
    terms (`u`, `u_dot`); None is all forces, and the whole pose. `period_s` is rounded to whole
    samples of the recording, at least one; None is one. `body_pose` sums increments in body axes;
    `pose` is the NED pose, for which the heading must stay within `span` [rad] of its mean. Raises
    IdentificationError otherwise.
    """
    recorded_period = recording.period_s
    samples = max(round((period_s or recorded_period) / recorded_period), 1)
    turns = recording.dofs in (PLANAR, DOFS)
    psi = recording.attitude[:, 2] if turns else np.zeros(1)
    poses = poses_of(recording.dofs)
    forces = recording.dofs if forces is None else forces
    outputs = poses if outputs is None else outputs
    if output == "pose" and set(outputs) & set(poses):
        _check_heading(psi, span)
    edges = np.flatnonzero(recording.piece_starts)[1:]
    terms = basis.evaluate(extra, recording.variables())
    terms = 0.5 * (terms + following(terms))  # the mean over a sample, as of the force
    columns = [recording.dofs.index(dof) for dof in forces]
    acting = np.hstack([recording.held_force(force)[:, 1][:, columns], terms])
    measured = _measured(recording, output, outputs, edges)
    y, u, stretch, file = [], [], [], []
    for number, part in enumerate(np.split(np.arange(len(recording)), edges)):
        rows = len(part) // samples
        y.append(measured[part][: rows * samples : samples])
        u.append(
            acting[part][: rows * samples].reshape(rows, samples, acting.shape[1]).mean(axis=1)
        )
        stretch.append(np.full(rows, number))
        if recording.file is not None:
            file.append(np.full(rows, recording.file[part[0]]))
    body = output == "body_pose" and turns
    return Sampled(
        y=np.vstack(y),
        u=np.vstack(u),
        stretch=np.concatenate(stretch).astype(np.int64),
        period_s=samples * recorded_period,
        extra=extra,
        inputs=(*(f"tau_{dof}" for dof in forces), *(one.name for one in extra)),
        outputs=tuple(f"body {name}" if body and name in poses else name for name in outputs),
        heading=float(np.mean(psi)) if output == "pose" else 0.0,
        file=np.concatenate(file) if file else None,
    )


def _measured(recording: Recording, output: Output, names: tuple[str, ...], edges: Codes) -> Array:
    """The named poses, each contiguous part from its own origin, and terms; shape (N, m)."""
    poses = poses_of(recording.dofs)
    columns: dict[str, Array] = {}
    if set(names) & set(poses):
        parts = np.split(recording.eta, edges)
        if output == "body_pose":
            pose = np.vstack([body_pose(eta, recording.dofs) for eta in parts])
        else:
            pose = np.vstack([eta - eta[0] for eta in parts])
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


def _check_heading(psi: Array, span: float) -> None:
    turned = float(np.max(np.abs(psi - np.mean(psi))))
    if turned > span:
        raise IdentificationError(
            f"a linear model of the NED pose holds near one heading only: the heading deviates by "
            f"{np.degrees(turned):.0f} deg from its mean, expected at most {np.degrees(span):.0f}; "
            f"use identifier.output=body_pose"
        )


class Record(NamedTuple):
    """Normalised data; `stretch` numbers the contiguous parts, `times` are the samples used."""

    y: Array  # (N, m)
    u: Array  # (N, r)
    stretch: Codes  # (N,), not decreasing
    times: Codes  # first samples of the windows used, with repetitions


def stretches(values: Array, stretch: Codes) -> list[Array]:
    """The rows of each contiguous part."""
    return list(np.split(values, np.flatnonzero(np.diff(stretch)) + 1))


def starts(record: Record, length: int) -> Codes:
    """First samples of the windows of `length` samples that lie within one stretch."""
    n = len(record.y) - length + 1
    contiguous = record.stretch[length - 1 :] == record.stretch[: max(n, 0)]
    times = record.times[record.times < n]
    return np.asarray(times[contiguous[times]])


class Window(NamedTuple):
    """A block of the Hankel matrix: x_{k+first} ... x_{k+first+length-1} for a window at k."""

    x: Array  # (N, m)
    first: int
    length: int


def hankel(blocks: list[Window], rows: Codes) -> Array:
    """Transposed block Hankel matrices, side by side, of the windows that start at `rows`."""
    return np.hstack([
        x[rows[:, None] + np.arange(first, first + length)].reshape(len(rows), length * x.shape[1])
        for x, first, length in blocks
    ])  # fmt: skip


def triangular(blocks: list[Window], rows: Codes) -> Array:
    """Lower triangular factor of the LQ factorisation of the stacked block Hankel matrices.

    Raises IdentificationError when there are too few windows, or when the inputs (the first
    block) are not persistently exciting.
    """
    columns = sum(length * x.shape[1] for x, _, length in blocks)
    if len(rows) < columns:
        raise IdentificationError(
            f"got {len(rows)} windows of data, expected at least {columns}: "
            f"use a longer recording, a shorter period, or smaller L and J"
        )
    R = triangle(hankel(blocks, rows[turn]) for turn in turns(len(rows))).T
    inputs = blocks[0].length * blocks[0].x.shape[1]
    excitation = np.linalg.svd(R[:inputs, :inputs], compute_uv=False)
    if excitation[-1] < MIN_SINGULAR_RATIO * excitation[0]:
        raise IdentificationError(
            f"the inputs do not excite all {len(excitation)} directions of L samples: got a "
            f"singular value ratio of {excitation[-1] / excitation[0]:.1e}, expected at least "
            f"{MIN_SINGULAR_RATIO:g}"
        )
    return R


def explained_by_past(record: Record, J: int, feedthrough: bool) -> tuple[Record, Record]:
    """y_k - e_k and e_k, the least-squares prediction from J past samples and its error.

    The first J samples of every stretch are dropped. Raises IdentificationError when there are
    too few windows.
    """
    past = [Window(record.u, 0, J), Window(record.y, 0, J)]
    past += [Window(record.u, J, 1)] if feedthrough else []
    count = sum(window.length * window.x.shape[1] for window in past)
    rows = starts(record, J + 1)
    if len(rows) <= count:
        raise IdentificationError(
            f"got {len(rows)} windows of {J} past samples, expected more than {count}"
        )
    windows = [*past, Window(record.y, J, 1)]
    R = triangle(hankel(windows, rows[turn]) for turn in turns(len(rows)))
    coefficients = np.linalg.lstsq(R[:, :count], R[:, count:], rcond=1e-12)[0]
    every = starts(record._replace(times=np.arange(len(record.y))), J + 1)
    parts = [hankel(past, every[turn]) @ coefficients for turn in turns(len(every))]
    explained, y = np.vstack(parts), record.y[every + J]
    position = np.full(len(record.y), -1)
    position[every + J] = np.arange(len(every))
    times = position[record.times]
    shorter = Record(explained, record.u[every + J], record.stretch[every + J], times[times >= 0])
    return shorter, shorter._replace(y=y - explained)


def check_signals(
    inputs: tuple[str, ...] | None, outputs: tuple[str, ...] | None, nominal: Vessel
) -> None:
    """Raise ConfigurationError for a signal that a recording of the vessel does not have."""
    own = {"inputs": tuple(f"tau_{dof}" for dof in nominal.dofs), "outputs": poses_of(nominal.dofs)}
    known = {"1", *nominal.velocities, *nominal.accelerations, *basis.ATTITUDE, *AIR}
    for option, values in (("inputs", inputs), ("outputs", outputs)):
        for value in set(values or ()) - set(own[option]):
            names = set() if value.startswith("tau_") else varying(value)
            if not names or not names <= known:
                raise ConfigurationError(
                    f"identifier.{option}: got {value}, expected {', '.join(own[option])} or terms "
                    f"that vary of the motion in {', '.join(nominal.dofs)}"
                )


def is_further_input(term: Term) -> bool:
    """Whether a term can be an additional input: it varies and is not already in the model."""
    names = varying(term.name)
    return bool(names) and not names & set(ACCELERATIONS) and term.name not in VELOCITIES


def varying(name: str) -> set[str]:
    """The variables in a term, without the constant."""
    return {basis.VARIABLES[code % basis.N_VARIABLES] for code in basis.term(name).codes if code}


def moves(term: Term) -> bool:
    """Whether a term contains a velocity; a term of the attitude alone is part of the stiffness."""
    return any(
        basis.VARIABLES[code % basis.N_VARIABLES] in (*VELOCITIES, *AIR) for code in term.codes
    )
