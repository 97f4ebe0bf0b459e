"""A recording as the outputs and held inputs of a sampled linear model.

The output y_k is paired with the input that acts over [t_k, t_{k+1}).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from seatrial.models.errors import IdentificationError
from seatrial.models.notation import DOFS, PLANAR, poses_of
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Codes, Term
from seatrial.models.vessel.kinematics import in_body, spatial_reference_kernel

Output = Literal["body_pose", "pose"]
GAP = 1.5  # periods between samples that belong to different stretches


@dataclass(frozen=True, eq=False)
class Sampled:
    """Outputs (N, m) and inputs (N, r) of contiguous stretches, sampled every `period_s` [s].

    The first m inputs are the forces, the others terms of the motion or the attitude.
    """

    y: Array
    u: Array
    stretch: Codes  # (N,), counted from 0
    period_s: float
    extra: tuple[Term, ...]  # the terms
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    heading: float  # [rad] between the axes of the output and those of the body


def sampled(
    recording: Recording,
    force: str | None,
    extra: tuple[Term, ...],
    output: Output,
    period_s: float | None,
    span: float,
) -> Sampled:
    """The pose, and the mean force and `extra` terms over each period.

    `period_s` is rounded to whole samples and never shorter than the recording's; None keeps
    that. `body_pose` sums increments in body axes; `pose` is the NED pose, for which the heading
    must stay within `span` [rad] of its mean: IdentificationError otherwise.
    """
    recorded_period = float(np.median(np.diff(recording.t)))
    every = max(round((period_s or recorded_period) / recorded_period), 1)
    turns = recording.dofs in (PLANAR, DOFS)
    psi = recording.attitude[:, 2] if turns else np.zeros(1)
    if output == "pose":
        _check_heading(psi, span)
    edges = np.flatnonzero(np.diff(recording.t) > GAP * recorded_period) + 1
    terms = _held(basis.evaluate(extra, recording.variables()))
    acting = np.hstack([held_force(recording, force), terms])
    y, u, stretch = [], [], []
    for number, part in enumerate(np.split(np.arange(len(recording)), edges)):
        eta = recording.eta[part]
        pose = body_pose(eta, recording.dofs) if output == "body_pose" else eta - eta[0]
        rows = len(part) // every
        y.append(pose[: rows * every : every])
        u.append(acting[part][: rows * every].reshape(rows, every, acting.shape[1]).mean(axis=1))
        stretch.append(np.full(rows, number))
    names = poses_of(recording.dofs)
    body = output == "body_pose" and turns
    return Sampled(
        y=np.vstack(y),
        u=np.vstack(u),
        stretch=np.concatenate(stretch).astype(np.int64),
        period_s=every * recorded_period,
        extra=extra,
        inputs=(*(f"tau_{dof}" for dof in recording.dofs), *(one.name for one in extra)),
        outputs=tuple(f"body {name}" if body else name for name in names),
        heading=float(np.mean(psi)) if output == "pose" else 0.0,
    )


def body_pose(eta: Array, dofs: tuple[str, ...]) -> Array:
    """Pose summed in body axes, from 0: J^-1 delta eta, J half-way; shape (N, n_dof).

    Its rate is the body velocity, whatever the attitude. eta is (x, y, psi) in the plane, (x, y,
    z, phi, theta, psi) in six degrees of freedom; on other axes nothing turns.
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


def held_force(recording: Recording, force: str | None) -> Array:
    """Mean force over the period that follows each sample [N, Nm], shape (N, n_dof).

    The command is held, so it is its own mean; an acting force is known at the samples and is
    taken as a straight line between them.
    """
    chosen = recording.force(force)
    return chosen if chosen is recording.tau else _held(chosen)


def _held(values: Array) -> Array:
    """Mean of sampled values over the period that follows each sample."""
    return np.asarray(0.5 * (values + np.vstack([values[1:], values[-1:]])))


def _check_heading(psi: Array, span: float) -> None:
    turned = float(np.max(np.abs(psi - np.mean(psi))))
    if turned > span:
        raise IdentificationError(
            f"a linear model of the NED pose holds near one heading only: the heading turns "
            f"{np.degrees(turned):.0f} deg from its mean, expected at most {np.degrees(span):.0f}; "
            f"use identifier.output=body_pose"
        )
