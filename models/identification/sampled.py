"""A recording as the outputs and held inputs of a sampled linear model.

The output y_k is paired with the input that acts over [t_k, t_{k+1}).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models import basis
from models.basis import Array, Codes, Term
from models.errors import IdentificationError
from models.recording import Recording
from models.vessel import PLANAR, poses_of

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
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    heading: float | None  # [rad] mean heading of a vessel in the plane


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
    planar = recording.dofs == PLANAR
    heading = float(np.mean(recording.eta[:, 2])) if planar else None
    if output == "pose" and heading is not None:
        _check_heading(recording.eta[:, 2], heading, span)
    edges = np.flatnonzero(np.diff(recording.t) > GAP * recorded_period) + 1
    terms = _held(basis.evaluate(extra, recording.variables()))
    acting = np.hstack([held_force(recording, force), terms])
    y, u, stretch = [], [], []
    for number, part in enumerate(np.split(np.arange(len(recording)), edges)):
        eta = recording.eta[part]
        pose = body_pose(eta) if planar and output == "body_pose" else eta - eta[0]
        rows = len(part) // every
        y.append(pose[: rows * every : every])
        u.append(acting[part][: rows * every].reshape(rows, every, -1).mean(axis=1))
        stretch.append(np.full(rows, number))
    names = poses_of(recording.dofs)
    body = output == "body_pose" and planar
    return Sampled(
        y=np.vstack(y),
        u=np.vstack(u),
        stretch=np.concatenate(stretch).astype(np.int64),
        period_s=every * recorded_period,
        inputs=(*(f"tau_{dof}" for dof in recording.dofs), *(one.name for one in extra)),
        outputs=tuple(f"body {name}" if body and name != "psi" else name for name in names),
        heading=heading,
    )


def body_pose(eta: Array) -> Array:
    """Planar pose summed in body axes, from 0: R(psi)' delta (x, y), psi half-way; shape (N, 3).

    Its rate is the body velocity, whatever the heading.
    """
    steps = np.diff(eta, axis=0)
    middle = 0.5 * (eta[1:, 2] + eta[:-1, 2])
    c, s = np.cos(middle), np.sin(middle)
    ahead = c * steps[:, 0] + s * steps[:, 1]
    abeam = c * steps[:, 1] - s * steps[:, 0]
    increments = np.column_stack([ahead, abeam, steps[:, 2]])
    return np.vstack([np.zeros(3), np.cumsum(increments, axis=0)])


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


def _check_heading(psi: Array, mean: float, span: float) -> None:
    turned = float(np.max(np.abs(psi - mean)))
    if turned > span:
        raise IdentificationError(
            f"a linear model of the NED pose holds near one heading only: the heading turns "
            f"{np.degrees(turned):.0f} deg from its mean, expected at most {np.degrees(span):.0f}; "
            f"use identifier.output=body_pose"
        )
