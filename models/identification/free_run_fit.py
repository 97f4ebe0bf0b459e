"""Fit of free runs: the parameters whose predictions are nearest to what was measured.

    minimise sum_k |W (y_k - y_hat_k(p, x_0))|^2 + tau sum_j (dp_j / s_j)^2

with the change dp = p - p_nominal of the free parameters, and the initial states x_0 of the
predictions, which begin again at intervals. It is the maximum-likelihood estimate for white noise
of the output, Ljung (1999), section 7.4. W is given, or one over the root mean square of each
residual, found in a few rounds; tau is the number of samples that say as much as one independent
sample (`structured.inflation`).

Initial states are estimated, since starting at measured or smoothed velocities biases the inertia
by one to two percent, and projected out of the Jacobian (QR), Golub and Pereyra (1973). The steps
are those of Gauss and Newton with Levenberg's damping, each a quadratic program with the bounds
and the physical constraints. A long free run from a poor model has minima far from the true
parameters, a short one has few: so short predictions are fitted first, and grow for as long as the
shorter ones hold. Where a small error of the state decides a long run, as under a constant force,
its minima say nothing of the model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.cross_validation import FAR, NEGLIGIBLE_ERROR
from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.free_run import predicted_layout
from seatrial.models.identification.physical_constraints import PhysicalConstraints, solve
from seatrial.models.identification.predictor import Predictor, states_of
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import ResidualOptions, turns
from seatrial.models.identification.structured import Structure, inflation
from seatrial.models.identification.uncertainty import (
    ParameterSpread,
    long_run_share,
    parameter_covariance,
)
from seatrial.models.identification.validation import bounded_course, restart_length
from seatrial.models.notation import DOFS, velocities_of
from seatrial.models.packs import WIDTH
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.signals import MAX_CUTOFF, noise_floor
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

DIFFERENCE_STEP = 1e-6  # of finite differences, relative to the size of a parameter
FIRST_LENGTH = 1.0 / 3.0  # of the first segments over that of the last ones
TRIES = 6  # of a step, each with ten times the damping
LEAST_DAMPING = 1e-12  # of what the data do not determine
FIRST_DAMPING = 1e-3  # after a step that was no better
MIN_RESIDUAL = 1e-9  # least residual that counts as noise, relative to the spread of a state
SLOW_SHARE = 1.1  # of `Fit.slow`, from which residuals of velocities depend on each other
WIDE = 0.25  # of all samples: the bandwidth of residuals with a slow part
SLOW_S = 3.0  # [s] beyond which residuals of white noise do not depend on each other


class Effort(NamedTuple):
    """How far a fit is carried."""

    weightings: int  # rounds in which the weights are found
    steps: int  # of Gauss and Newton in one round
    enough: float  # relative decrease of the cost below which the steps end


Length = TypeVar("Length")  # of predictions, in samples or seconds
QUICK, USUAL = Effort(1, 5, 1e-4), Effort(3, 5, 1e-4)


class Point(NamedTuple):
    """Parameters and initial states, and what the predictions leave unexplained."""

    change: Array  # (m,)
    start: Array  # (n_starts, 2 n_dof) initial minus measured states
    rest: Array  # (N, n) measured - predicted


class FreeRuns:
    """Residuals of a predictor as a function of parameters, of sizes (m,), and initial states.

    `estimated` are the states, of poses, then velocities, that are unknown where a prediction
    begins (None: the velocities).
    """

    def __init__(
        self, predictor: Predictor, size: Array, estimated: Sequence[int] | None = None
    ) -> None:
        n = len(predictor.free.nominal.dofs)
        self.predictor, self.size = predictor, size
        self.estimated = list(range(n, 2 * n) if estimated is None else estimated)
        self.begin = np.flatnonzero(predictor.course.restart)
        self.evaluations = 0
        self._latest: tuple[Point, tuple[Array, Array]] | None = None

    def point(self, change: Array, start: Array) -> Point:
        """The residuals at a change (m,) of the nominal parameters and at initial states."""
        self.evaluations += 1
        rest = -self.predictor.mismatch(self.predictor.free.values + change, start)
        return Point(change, start, rest)

    def slopes(self, point: Point) -> tuple[Array, Array]:
        """Derivatives of the prediction by parameters (N, n, m) and by starts (N, n, n_estimated).

        A point at which no step was better is asked for again. Where a forward difference cannot be
        simulated a backward one is used; raises IdentificationError if neither can be.
        """
        if self._latest is None or self._latest[0] is not point:
            spread = self.predictor.spread[self.estimated]
            sizes = DIFFERENCE_STEP * np.concatenate([self.size, spread])
            slopes = self._differences(point, sizes, np.arange(len(sizes)))
            refused = np.flatnonzero(~np.isfinite(slopes[0, 0]))
            slopes[..., refused] = self._differences(point, -sizes, refused)
            if not np.all(np.isfinite(slopes)):
                raise IdentificationError(
                    "the fit has reached an inertia that is hardly positive definite: use fewer "
                    "parameters, or bounds"
                )
            m = len(self.size)
            self._latest = point, (slopes[..., :m], slopes[..., m:])
        return self._latest[1]

    def _differences(self, point: Point, sizes: Array, chosen: NDArray[np.int64]) -> Array:
        """Slopes (N, n, len(chosen)) by steps of `sizes` (m + n_estimated,), of those `chosen`."""
        m, slopes = len(self.size), np.empty((len(chosen), *point.rest.shape))
        steps = np.diag(sizes)[chosen]
        points = self.predictor.free.values + point.change + steps[:, :m]
        starts = np.repeat(point.start[None], len(chosen), axis=0)
        starts[..., self.estimated] += steps[:, None, m:]
        self.evaluations += len(chosen)
        angles = [j for j, unit in enumerate(self.predictor.compared.units) if unit == "rad"]
        for part in turns(len(chosen), WIDTH):  # so that few states are in memory
            change = self.predictor.mismatches(points[part], starts[part]) + point.rest
            if angles:  # a rotation vector jumps at half a turn
                change[np.any(np.abs(change[..., angles]) > np.pi, axis=-1)] = 0.0
            np.divide(change, sizes[chosen[part], None, None], out=slopes[part])
        return slopes.transpose(1, 2, 0)

    def project(self, by_start: Array, values: Array) -> tuple[Array, Array]:
        """Values (N, n, c) without what the starts explain, as (N n, c), and the starts.

        The starts' coefficients have shape (n_starts, n_estimated, c); a start without an effect,
        such as a position on velocities, is zero.
        """
        flat, effect = values.reshape(-1, values.shape[2]), np.any(by_start != 0.0, axis=(0, 1))
        coefficients = np.zeros((len(self.begin), len(effect), values.shape[2]))
        if not np.any(effect):
            return flat, coefficients
        left, n = np.empty_like(flat), values.shape[1]
        for k, (a, b) in enumerate(zip(self.begin, [*self.begin[1:], len(values)], strict=True)):
            rows = slice(n * a, n * b)
            Q, R = np.linalg.qr(by_start[a:b, :, effect].reshape(n * (b - a), -1))
            along = Q.T @ flat[rows]
            left[rows] = flat[rows] - Q @ along
            coefficients[k, effect] = np.linalg.lstsq(R, along, rcond=None)[0]
        return left, coefficients

    def root_mean_square(self, point: Point) -> Array:
        """Of the residuals, (n,), at least what counts as noise."""
        rms = np.sqrt(np.mean(point.rest**2, axis=0))
        return np.asarray(np.maximum(rms, MIN_RESIDUAL * self.predictor.compared.spread))


class Stage(NamedTuple):
    """Predictions of one length and how they are fitted."""

    runs: FreeRuns
    effort: Effort = USUAL
    scale: Array | None = None  # (n,) or (N, n) of the residuals; None: found from them
    start: Array | None = None  # (n_starts, 2 n_dof) initial minus measured states; None: zero
    slow_share: float = SLOW_SHARE  # of the residual's slow part, above which the bandwidth is wide


@dataclass(frozen=True, eq=False)
class Fit:
    """A converged fit, and what its covariance is computed from."""

    runs: FreeRuns
    point: Point
    active: tuple[str, ...]  # names of the constraints that bind
    scale: Array  # (n,) of the residuals, or (N, n): one over the weights
    tau: float  # samples that say as much as one independent sample
    deviation: Array  # (m,) of the prior, infinite where there is none
    slow_share: float  # see `Stage`
    before: int = 0  # evaluations with predictions of other lengths
    notes: tuple[str, ...] = ()  # what is to be said of the length of the predictions

    @property
    def change(self) -> Array:
        """p - p_nominal, shape (m,)."""
        return self.point.change

    @property
    def parameters(self) -> Array:
        """p, shape (m,)."""
        return np.asarray(self.runs.predictor.free.values + self.change)

    @property
    def evaluations(self) -> int:
        """Free runs so far."""
        return self.before + self.runs.evaluations

    @cached_property
    def rest(self) -> Array:
        """Residuals (N, n) over their scale."""
        return np.asarray(self.point.rest / self.scale)

    @cached_property
    def jacobian(self) -> Array:
        """J (N n, m) over the scale of the residuals, without what the starts explain."""
        J, S = (slopes / self.scale[..., None] for slopes in self.runs.slopes(self.point))
        return self.runs.project(S, J)[0]

    @cached_property
    def slow(self) -> float:
        """Variance of the residual at low frequency over that of white noise, the largest.

        Above one the residual is not the noise of the measurement alone: a disturbance is not in
        the model, or the fit has ended in a minimum far from the truth.
        """
        share = long_run_share(self.rest, SLOW_S / self.runs.predictor.course.step_s)
        return float(np.max(share))

    @property
    def prior(self) -> Array:
        """Precision (m,) of the prior inside the inverse of the covariance."""
        return np.asarray(self.deviation**-2.0)

    def spread(self, nominal: Vessel) -> ParameterSpread:
        """The distribution of the parameters of a nominal model."""
        free = self.runs.predictor.free
        return ParameterSpread(nominal, free, self.parameters, self.covariance, self.prior)

    @cached_property
    def covariance(self) -> Array:
        """Covariance (m, m) of the parameters; an active constraint does not narrow it."""
        unknowns = len(self.change) + len(self.runs.begin) * len(self.runs.estimated)
        width = WIDE * len(self.rest) if self.slow > self.slow_share else None
        return parameter_covariance(self.jacobian, self.rest, self.prior, self.tau, unknowns, width)


def grown(
    lengths: Sequence[Length], stage: Callable[[Length, bool], Stage], change: Array, other: Array,
    deviation: Array, constraints: PhysicalConstraints | None,
) -> Fit:  # fmt: skip
    """Fit predictions of growing lengths, each from the last fit, or from `other` if it is better.

    It ends before a length whose fit is `_lost`. `stage` gives that of a length, the last one or
    not; `change` and `other` are feasible changes (m,) of the nominal parameters, `deviation` (m,)
    that of the prior, infinite where there is none.
    """
    before, result = 0, None
    for i, length in enumerate(lengths):
        last = stage(length, i == len(lengths) - 1)
        longer = replace(fit(last, [change, other], deviation, constraints), before=before)
        change, before = longer.change, longer.evaluations
        if result is not None and _lost(longer, result):
            kept = stage(lengths[i - 1], True)
            steps = np.max(np.diff(kept.runs.begin, append=len(longer.rest)))
            length_s = kept.runs.predictor.course.step_s * steps
            note = f"fitted to free runs of {length_s:.3g} s: longer ones lose the motion"
            kept_fit = fit(kept, [result.change, other], deviation, constraints)
            return replace(kept_fit, before=before, notes=(note,))
        result = longer
    assert result is not None
    return result


def _lost(longer: Fit, shorter: Fit) -> bool:
    """Whether a fit of longer predictions worsens the shorter ones by more than it betters its own.

    By many times, too. The shorter ones begin at the states of their fit, its own at measured ones.
    """

    def error(runs: Fit, start: Array, of: Fit) -> float:
        return _squares(runs.runs.point(of.change, start).rest / runs.scale)

    own, measured = shorter.point, np.zeros_like(longer.point.start)
    before, after = _squares(own.rest / shorter.scale), error(shorter, own.start, longer)
    spread = np.broadcast_to(shorter.runs.predictor.compared.spread, own.rest.shape)
    if after <= max(FAR * before, NEGLIGIBLE_ERROR * _squares(spread / shorter.scale)):
        return False
    return after * error(longer, measured, longer) > before * error(longer, measured, shorter)


def fit(
    stage: Stage, candidates: Sequence[Array], deviation: Array, constraints: PhysicalConstraints |
    None,
) -> Fit:  # fmt: skip
    """Fit one stage from the best of several candidates; see `grown`."""
    runs, effort, given, start, _ = stage
    if start is None:
        start = np.zeros((len(runs.begin), len(runs.predictor.spread)))
    points = [runs.point(candidate, start) for candidate in candidates]
    scale = runs.predictor.compared.spread if given is None else given
    point = min(points, key=lambda p: _squares(p.rest / scale))
    tau, active = 1.0, tuple[str, ...]()
    for _ in range(effort.weightings if given is None else 1):
        if given is None:
            scale, tau = runs.root_mean_square(point), inflation(point.rest)
        prior = tau / deviation**2
        point, active = _converged(runs, point, active, scale, prior, constraints, effort)
    if given is None:
        scale, tau = runs.root_mean_square(point), inflation(point.rest)
    return Fit(runs, point, active, scale, tau, deviation, stage.slow_share)


def _squares(rest: Array) -> float:
    """Sum of squares; infinite where the model cannot be simulated."""
    return float(np.nan_to_num(np.sum(rest**2), nan=np.inf, posinf=np.inf))


def _converged(
    runs: FreeRuns, point: Point, active: tuple[str, ...], scale: Array, prior: Array, constraints:
    PhysicalConstraints | None, effort: Effort,
) -> tuple[Point, tuple[str, ...]]:  # fmt: skip
    """Steps until the cost hardly decreases, with a scale of the residuals and a prior (m,).

    `active` are the constraints that bind at the point; they stay if no step is better.
    """
    damping, weight = LEAST_DAMPING, 1.0 / scale[..., None]

    def cost(at: Point) -> float:
        return _squares(at.rest / scale) + float(prior @ at.change**2)

    for _ in range(effort.steps):
        J, S = (weight * slopes for slopes in runs.slopes(point))
        values = np.concatenate([J, weight * point.rest[..., None]], axis=2)
        left, along = runs.project(S, values)
        gram = left.T @ left
        H, g = gram[:-1, :-1] + np.diag(prior), gram[:-1, -1] - prior * point.change
        size = np.where(np.diag(H) > 0.0, np.diag(H), runs.size**-2.0)
        before = cost(point)
        for _ in range(TRIES):
            step, binding = solve(H + damping * np.diag(size), g, constraints, point.change)
            start = point.start.copy()
            start[:, runs.estimated] += along[..., -1] / (1.0 + damping) - along[..., :-1] @ step
            moved = runs.point(point.change + step, start)
            if cost(moved) < before:
                break
            damping = max(10.0 * damping, FIRST_DAMPING)
        else:
            break
        point, active, damping = moved, binding, max(damping / 10.0, LEAST_DAMPING)
        if before - cost(point) < effort.enough * before:
            break
    return point, active


def refined(
    options: ResidualOptions, problem: Problem, lag: SecondOrderLag | None, model: Structure,
    change: Array, prior: float, result: Identified,
) -> Identified:  # fmt: skip
    """A table refined by the velocities of free runs over segments, short ones first.

    The fit begins at a change (m,) of the nominal parameters of the `model`; `prior` is the
    standard deviation of a parameter over its size.
    """
    free, deviation, nominal = model.free, prior * model.size, problem.nominal
    whole_s = options.segment_s or restart_length(free.nominal, problem.training)

    def stage(length_s: float, last: bool) -> Stage:
        predictor = segments(problem.training, free, lag, options.force, length_s)
        return Stage(FreeRuns(predictor, deviation), USUAL if last else QUICK)

    lengths = FIRST_LENGTH * whole_s, whole_s
    fit = grown(lengths, stage, change, np.zeros_like(change), deviation, model.constraints)
    residual = free.residual(fit.parameters).on(result.residual.terms)
    rows = [Diagnostic("active_constraint", "all", 1.0, label=name) for name in fit.active]
    rows += [Diagnostic("evaluations", "all", float(fit.evaluations))]
    result = replace(
        result, model=nominal + residual, residual=residual, notes=(*result.notes, *fit.notes),
        diagnostics=(*result.diagnostics, *rows),
    )  # fmt: skip
    if problem.compared:
        return result
    errors = free.std_error(fit.covariance)
    kept = [free.nominal.terms.index(term) for term in residual.terms]
    return replace(result, std_error=errors[kept], spread=fit.spread(nominal))


def segments(
    recording: Recording, free: FreeParameters, lag: SecondOrderLag | None, force: str | None,
    segment_s: float,
) -> Predictor:  # fmt: skip
    """The predictor of the velocities of a recording in segments of `segment_s` [s].

    A segment keeps the attitude at which it begins: noise in it turns restoring and constant forces
    for as long as the segment lasts. So angles are smoothed at the frequency where noise begins.
    """
    if angles := [k for k, dof in enumerate(recording.dofs) if dof in DOFS[3:]]:
        eta, period_s = recording.eta.copy(), recording.period_s
        eta[:, angles] = np.unwrap(eta[:, angles], axis=0)
        floor = noise_floor(eta[:, angles], recording.piece_starts, period_s)
        if floor.cutoff_hz is not None and floor.cutoff_hz < MAX_CUTOFF * 0.5 / period_s:
            eta[:, angles] = recording.lowpassed(eta[:, angles], floor.cutoff_hz)
            recording = replace(recording, eta=eta)
    table, every = free.nominal, max(round(segment_s / recording.period_s), 2)
    course = bounded_course(recording, lag, force, every, table.attitude)
    predictor = Predictor(free, predicted_layout(table, free.support), course, "rk4")
    outputs = states_of(table.dofs, predictor.spread, velocities_of(table.dofs))
    return replace(predictor, outputs=outputs)
