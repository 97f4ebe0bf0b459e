"""Refinement of a table by free runs over segments, with the initial velocities free.

    minimise sum_k |W (nu_k - nu_hat_k(p, nu_0))|^2 + tau sum_j (dp_j / s_j)^2

Every segment begins at the measured pose and at an initial velocity of its own, which is estimated
and projected out of the Jacobian (QR): starting at measured or smoothed velocities biases the
inertia by one to two percent. W is one over the root mean square of each residual, found in a few
rounds, and the prior is that of the structured regression. Measurement noise is in the output
alone, where it does not bias. The steps are those of Gauss and Newton with Levenberg's damping,
each a quadratic program with the physical constraints.

Segments of a third of the length come first: a long free run from a poor model has minima far from
the true parameters, a short one has few.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.free_run import predicted_layout
from seatrial.models.identification.linear import turns
from seatrial.models.identification.physical_constraints import PhysicalConstraints, solve
from seatrial.models.identification.predictor import Predictor
from seatrial.models.identification.residual import ResidualOptions
from seatrial.models.identification.structured import Structure, inflation
from seatrial.models.identification.uncertainty import SegmentSpread
from seatrial.models.identification.validation import bounded_course
from seatrial.models.notation import DOFS
from seatrial.models.packs import WIDTH
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import MAX_CUTOFF, noise_floor
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.thruster import SecondOrderLag

DIFFERENCE_STEP = 1e-6  # of finite differences, relative to the prior's deviation of a parameter
NEWTON_STEPS = 5  # of Gauss and Newton for one weighting
WEIGHTINGS = 3
SHORTER = 1.0 / 3.0  # length of the first segments over that of the last ones
TRIES = 6  # of a step, each with ten times the damping
FIRST_DAMPING = 1e-3  # the first
ENOUGH = 1e-4  # relative decrease below which the steps end
MIN_RESIDUAL = 1e-9  # least residual that counts as noise, relative to the spread of a velocity


@dataclass(frozen=True, eq=False)
class _Point:
    change: Array  # (m,)
    start: Array  # (n_segments, n_dof) initial minus measured velocities
    rest: Array  # (N, n_dof) measured - predicted velocities


class _Segments:
    """Velocity residuals of a predictor's segments as a function of parameters and starts."""

    def __init__(self, predictor: Predictor, deviation: Array) -> None:
        self.predictor, self.deviation = predictor, deviation
        self.begin = np.flatnonzero(predictor.course.restart)
        self.n_dof = len(predictor.free.nominal.dofs)
        self.spread = predictor.spread[self.n_dof :]
        self.evaluations = 0
        self._latest: tuple[_Point, tuple[Array, Array]] | None = None

    def point(self, change: Array, start: Array | None = None) -> _Point:
        start = np.zeros((len(self.begin), self.n_dof)) if start is None else start
        self.evaluations += 1
        offset = np.hstack([np.zeros_like(start), start])
        states = self.predictor.predict(self.predictor.free.values + change, offset)
        measured = self.predictor.course.measured[:, self.n_dof :]
        return _Point(change, start, measured - states[:, -self.n_dof :])

    def slopes(self, point: _Point) -> tuple[Array, Array]:
        """Derivatives of the prediction by parameters (N, n_dof, m) and starts (N, n_dof, n_dof).

        A point at which no step was better is asked for again.
        """
        if self._latest is None or self._latest[0] is not point:
            self._latest = point, self._slopes(point)
        return self._latest[1]

    def _slopes(self, point: _Point) -> tuple[Array, Array]:
        """If the inertia after a forward step is not positive definite, a backward one is used."""
        sizes = np.concatenate([DIFFERENCE_STEP * self.deviation, DIFFERENCE_STEP * self.spread])
        ahead = self._after(point, sizes)
        refused = np.flatnonzero(~np.isfinite(ahead[:, 0, 0]))
        if len(refused):
            sizes[refused] *= -1.0
            ahead[refused] = self._after(point, sizes, refused)
        slopes = (point.rest - ahead) / sizes[:, None, None]
        m = len(point.change)
        return slopes[:m].transpose(1, 2, 0), slopes[m:].transpose(1, 2, 0)

    def _after(self, point: _Point, sizes: Array, chosen: NDArray[np.int64] | None = None) -> Array:
        """Residuals (n, N, n_dof) after a step of each size (m + n_dof,), or of those `chosen`."""
        m = len(point.change)
        chosen = np.arange(len(sizes)) if chosen is None else chosen
        steps = np.diag(sizes)[chosen]
        points = self.predictor.free.values + point.change + steps[:, :m]
        starts = point.start + steps[:, None, m:]
        self.evaluations += len(chosen)
        offsets = np.concatenate([np.zeros_like(starts), starts], axis=2)
        measured = self.predictor.course.measured[:, self.n_dof :]
        rest = np.empty((len(points), *measured.shape))
        for part in turns(len(points), WIDTH):  # so that few states are in memory
            states = self.predictor.predict_many(points[part], offsets[part])
            rest[part] = measured - states[:, :, -self.n_dof :]
        return rest

    def project(self, by_start: Array, values: Array) -> tuple[Array, Array]:
        """Values (N, n_dof, c) without what the starts explain, as (N n_dof, c), and the starts.

        The starts' coefficients have shape (n_segments, n_dof, c).
        """
        left, coefficients = np.empty_like(values), []
        for a, b in zip(self.begin, [*self.begin[1:], len(values)], strict=True):
            Q, R = np.linalg.qr(by_start[a:b].reshape(-1, self.n_dof))
            flat = values[a:b].reshape(-1, values.shape[2])
            along = Q.T @ flat
            left[a:b] = (flat - Q @ along).reshape(values[a:b].shape)
            coefficients.append(np.linalg.lstsq(R, along, rcond=None)[0])
        return left.reshape(-1, values.shape[2]), np.array(coefficients)


@dataclass(frozen=True, eq=False)
class Refined:
    """Refined parameters, and what their covariance is computed from."""

    runs: _Segments
    point: _Point
    active: tuple[str, ...]  # names of constraints that bind
    rms: Array  # (n_dof,) of the residuals
    tau: float  # samples that say as much as one independent sample
    before: int = 0  # evaluations with shorter segments

    @property
    def change(self) -> Array:
        """p - p_nominal, shape (m,)."""
        return self.point.change

    @property
    def evaluations(self) -> int:
        """Free runs so far."""
        return self.before + self.runs.evaluations

    @cached_property
    def spread(self) -> SegmentSpread:
        """The spread of the parameters."""
        weight, prior = 1.0 / self.rms, self.tau / self.runs.deviation**2
        J, S = (weight[:, None] * slopes for slopes in self.runs.slopes(self.point))
        left, _ = self.runs.project(S, J)
        inverse = np.asarray(np.linalg.inv(left.T @ left + np.diag(prior)), dtype=np.float64)
        rest, size = weight * self.point.rest, self.point.rest.size
        unknowns = len(self.change) + self.point.start.size
        freedom = size / max(size - unknowns, 1)
        gains = (left @ inverse).reshape(J.shape)
        return SegmentSpread(inverse, gains, rest, self.runs.begin, freedom, self.tau * prior)


def segments(
    recording: Recording,
    free: FreeParameters,
    lag: SecondOrderLag | None,
    force: str | None,
    segment_s: float,
) -> Predictor:
    """The predictor of a recording in segments of `segment_s` [s]."""
    recording = with_smooth_angles(recording)
    table, every = free.nominal, max(round(segment_s / recording.period_s), 2)
    course = bounded_course(recording, lag, force, every, table.attitude)
    return Predictor(free, predicted_layout(table, free.support), course, "rk4")


def with_smooth_angles(recording: Recording) -> Recording:
    """The recording with a low-pass filter of its angles, at the frequency where noise begins.

    A segment keeps the attitude at which it begins: noise in it turns restoring and constant forces
    for as long as the segment lasts.
    """
    angles = [k for k, dof in enumerate(recording.dofs) if dof in DOFS[3:]]
    if not angles:
        return recording
    turned = np.unwrap(recording.eta[:, angles], axis=0)
    floor = noise_floor(turned, recording.piece_starts, recording.period_s)
    if floor.cutoff_hz is None or floor.cutoff_hz >= MAX_CUTOFF * 0.5 / recording.period_s:
        return recording
    eta = recording.eta.copy()
    eta[:, angles] = recording.lowpassed(turned, floor.cutoff_hz)
    return replace(recording, eta=eta)


def refined_by_segments(
    options: ResidualOptions,
    recording: Recording,
    lag: SecondOrderLag | None,
    model: Structure,
    change: Array,
    prior: float,
) -> Refined:
    """Refine the parameters from `change` (m,), over short segments and then over whole ones.

    `prior` is the standard deviation of a parameter over its size.
    """
    evaluations, deviation = 0, prior * model.size
    for length, weightings in ((SHORTER, 1), (1.0, WEIGHTINGS)):
        assert options.segment_s is not None
        duration_s = length * options.segment_s
        predictor = segments(recording, model.free, lag, options.force, duration_s)
        refined = refine(predictor, change, deviation, model.constraints, weightings)
        refined = replace(refined, before=evaluations)
        change, evaluations = refined.change, refined.evaluations
    return refined


def refine(
    predictor: Predictor,
    change: Array,
    deviation: Array,
    constraints: PhysicalConstraints | None,
    weightings: int = WEIGHTINGS,
) -> Refined:
    """Refine the parameters from `change` (m,), or from the nominal ones if they predict better.

    `predictor` begins a segment at each of its restarts; `deviation` (m,) is the prior's.
    """
    runs = _Segments(predictor, deviation)
    starts = [runs.point(change), runs.point(np.zeros_like(change))]
    point = min(starts, key=lambda p: _squares(p.rest, 1.0 / runs.spread))
    rms, tau = _scale(point, runs), inflation(point.rest)
    active: tuple[str, ...] = ()
    for _ in range(weightings):
        prior = tau / deviation**2
        point, active = _converge(runs, point, active, 1.0 / rms, prior, constraints)
        rms, tau = _scale(point, runs), inflation(point.rest)
    return Refined(runs, point, active, rms, tau)


def _scale(point: _Point, runs: _Segments) -> Array:
    rms = np.sqrt(np.mean(point.rest**2, axis=0))
    return np.asarray(np.maximum(rms, MIN_RESIDUAL * runs.spread))


def _squares(rest: Array, weight: Array) -> float:
    """Weighted sum of squares; infinite where the model cannot be simulated."""
    total = float(np.sum((weight * rest) ** 2))
    return total if np.isfinite(total) else float("inf")


def _converge(
    runs: _Segments,
    point: _Point,
    active: tuple[str, ...],
    weight: Array,
    prior: Array,
    constraints: PhysicalConstraints | None,
) -> tuple[_Point, tuple[str, ...]]:
    """Steps until the cost hardly decreases, with weights (n_dof,) and a prior (m,).

    `active` are the constraints that bind at the point; they stay if no step is better.
    """
    damping = 0.0

    def cost(at: _Point) -> float:
        return _squares(at.rest, weight) + float(prior @ at.change**2)

    for _ in range(NEWTON_STEPS):
        J, S = (weight[:, None] * slopes for slopes in runs.slopes(point))
        values = np.concatenate([J, (weight * point.rest)[..., None]], axis=2)
        left, along = runs.project(S, values)
        gram = left.T @ left
        H, g = gram[:-1, :-1] + np.diag(prior), gram[:-1, -1] - prior * point.change
        before = cost(point)
        for _ in range(TRIES):
            damped = H + damping * np.diag(np.diag(H))
            step, binding = solve(damped, g, constraints, point.change)
            start = point.start + along[..., -1] - along[..., :-1] @ step
            moved = runs.point(point.change + step, start)
            if cost(moved) < before:
                break
            damping = max(10.0 * damping, FIRST_DAMPING)
        else:
            break
        point, active, damping = moved, binding, damping / 10.0
        if before - cost(point) < ENOUGH * before:
            break
    return point, active
