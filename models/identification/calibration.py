"""Calibration of the model error: how far a model is from what it was not fitted to.

What the data leave open of the parameters does not contain that the model has the wrong terms. So
files, or blocks of a single one, are left out in turn, and models that were identified without them
run freely over them. Their errors e calibrate a distribution

    p ~ N(p_hat, ((C^-1 - P) / kappa^2 + P)^-1)        the parameters,
    a_k = phi a_(k-1) + sqrt(1 - phi^2) w_k,  phi = exp(-h / T),  T = 2 s,
    nu_dot = f(nu, p) + lambda sqrt((m^2 + rho^2) / 2) a   an acceleration, lambda of each axis,

with C the covariance of the parameters, P the precision of a prior within it (the data alone count
less), w standard normal, rho^2 = (M^-1 tau)^2 + (M^-1 F(nu))^2 the accelerations by inputs and by
the hull along the run, and m^2 the mean of rho^2 over the training part. The noise of the
measurement is that of the starting state and of what is compared. kappa^2 and lambda maximise the
likelihood of e by Student's t with four degrees of freedom (one bad file must not decide), files
weighted alike; then k, the .90 quantile of |e| / (1.645 s), scales all deviations s. Their size is
that of runs which deviate by DEVIATION_SHARE of it (`manoeuvre_sheet`).
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.cross_validation import FOLDS, UNUSABLE, mixed_table
from seatrial.models.identification.free_run import Course, deviations
from seatrial.models.identification.model_error import ModelError
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.identification.validation import Prediction, bounded_course, predicted_by
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.recording.signals import noise_floor
from seatrial.models.simulation.manoeuvre_sheet import DEVIATION_SHARE
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

NO_MODEL_ERROR = "no_model_error"  # the diagnostic, whose label is the reason
KAPPA2 = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
FREEDOM = 4.0  # of Student's t
LEVEL = 0.9  # at which k makes the deviations right
CALIBRATION_RUNS = 40  # runs by which deviations are found
LEAST_DRAWS, MOST_STEPS = 10, 2_000_000  # for a long recording; samples of all runs
LAMBDA = (1e-4, 10.0)
TRIED = 0.1  # lambda of the runs that show what an acceleration does; the deviations are linear
MOST_SAMPLES = 20_000  # of the training part
MOST_ROWS = 10_000  # of the likelihood: neighbouring errors are nearly equal
LEAST_DEVIATION = 1e-9  # over that of the motion
STILL = 1e-12  # [m, rad, m/s, rad/s] of an axis that does not move at all
MOST_DIVERGED = 0.1  # of the drawn runs


def squared_accelerations(
    model: Vessel, nu: Array, attitude: Array, acting: Array, wind: Array | None
) -> Array:
    """rho^2 = (M^-1 tau)^2 + (M^-1 F(nu))^2, shape (N, n_dof) [(m/s^2)^2, (rad/s^2)^2].

    nu (N, n_dof) [m/s, rad/s] is the body velocity, the attitude (phi, theta, psi) (N, 3) [rad],
    the wind that of the air in body axes (N, 2) [m/s]; acting are forces (N, n_dof) [N, Nm], or the
    inputs (N, n_inputs) of a vessel that has them.
    """
    still = np.zeros_like(nu)
    hull = replace(model, devices={}).forward(still, nu, attitude, wind)
    if model.inputs:
        whole = model.forward(still, nu, attitude, wind, acting)
    else:
        whole = model.forward(acting, nu, attitude, wind)
    return np.asarray(hull**2 + (whole - hull) ** 2)


@dataclass(frozen=True, eq=False)
class NearbyRuns:
    """The free run of a model over a recording, and runs that deviate a little from it."""

    own: Prediction
    model: Vessel
    recording: Recording

    @cached_property
    def rho2(self) -> Array:
        """rho^2 (N, n_dof) along the model's own run."""
        n = len(self.recording.dofs)
        motion = self.own.motion_of(self.own.free_run[0])
        return self.squares(motion[:, n:], attitude_of(self.recording.dofs, motion[:, :n]))

    def squares(self, nu: Array, attitude: Array) -> Array:
        """rho^2 (N, n_dof) of any motion under what acts in the recording."""
        acting = self.own.course.acting[:, 0]
        return squared_accelerations(self.model, nu, attitude, acting, self.recording.wind)

    def drawn(self, error: ModelError, seed: int, start: bool = True) -> Course:
        """A course by DEVIATION_SHARE of drawn offsets of the starts, and of accelerations."""
        course, rng = self.own.course, np.random.default_rng(seed)
        if start:
            shape = int(np.count_nonzero(course.restart)), course.measured.shape[1]
            offset = error.scale * error.noise * rng.standard_normal(shape)
            course = course.with_offset(DEVIATION_SHARE * offset)
        process = DEVIATION_SHARE * error.accelerations(self.rho2, course.step_s, rng)
        process = np.ascontiguousarray(process)  # another layout would be compiled again
        return course._replace(weather=course.weather._replace(process=process))

    def variance(self, runs: Iterable[Prediction]) -> Array:
        """Mean square (N, 2 n_dof) of the deviations of runs, which are DEVIATION_SHARE of it.

        A run that diverges is left out; infinite where more than MOST_DIVERGED do, or the own one.
        """
        if self.own.free_run[1]:
            return np.full_like(self.own.course.measured, np.inf)
        count, diverged, total = 0, 0, np.zeros_like(self.own.course.measured)
        for run in runs:
            if run.free_run[1]:
                diverged += 1
                continue
            states, reached = self.own.free_run[0], run.free_run[0]
            total += deviations(self.own.course.kinematics, states, reached) ** 2
            count += 1
        if not count or diverged > MOST_DIVERGED * (count + diverged):
            return np.full_like(self.own.course.measured, np.inf)
        return total / (count * DEVIATION_SHARE**2)


def nearby_runs(model: Vessel, recording: Recording, thruster: SecondOrderLag | None) -> NearbyRuns:
    """The runs near that of a model over a recording; raises the errors of `prediction`."""
    course = bounded_course(recording, thruster, None, None, model.attitude)
    return NearbyRuns(predicted_by(model, course), model, recording)


def drawn_runs(
    identified: Identified, runs: NearbyRuns, count: int = CALIBRATION_RUNS
) -> Iterator[Prediction]:
    """Draw predictions from the distribution, always by the same random numbers.

    They deviate by DEVIATION_SHARE of what was drawn from the model's own run; without a model
    error the parameters alone are drawn. A drawn model that cannot be simulated is left out.
    """
    error, models = identified.model_error, identified.draws(count, DEVIATION_SHARE)
    if identified.spread is None:
        models = iter([identified.model] * (0 if error is None else count))
    return predictable(
        (model, runs.own.course if error is None else runs.drawn(error, i))
        for i, model in enumerate(models)
    )


def predictable(cases: Iterable[tuple[Vessel, Course]]) -> Iterator[Prediction]:
    """Predictions of courses by those of the models that can be simulated."""
    for model, course in cases:
        try:
            yield predicted_by(model, course)
        except IdentificationError:
            continue


def bands(
    identified: Identified, recording: Recording, thruster: SecondOrderLag | None
) -> Array | None:
    """Standard deviation of measured minus predicted pose and velocity in the free run.

    Shape (N, 2 n_dof), SI units; of attitudes in six degrees of freedom that of a rotation vector.
    None without a distribution; infinite where the run or the drawn ones diverge. Raises
    IdentificationError when the model cannot be simulated (`prediction`).
    """
    error = identified.model_error
    if error is None and identified.spread is None:
        return None
    runs = nearby_runs(identified.model, recording, thruster)
    count = int(np.clip(MOST_STEPS // len(recording), LEAST_DRAWS, CALIBRATION_RUNS))
    variance = runs.variance(drawn_runs(identified, runs, count))
    if error is not None:
        variance += (error.scale * error.noise) ** 2
    return np.asarray(np.sqrt(variance))


def calibrated(identifier: Identifier, problem: Problem, identified: Identified) -> Identified:
    """The result with its model error, or with the reason why there is none (NO_MODEL_ERROR).

    The identifier identifies the folds of the training part, unless the result holds their models.
    A result without a distribution and models of folds stays as it is.
    """
    if identified.spread is None and not identified.fold_models:
        return identified
    try:
        error = _calibrate(identifier, problem, identified)
    except UNUSABLE as reason:
        diagnostic = Diagnostic(NO_MODEL_ERROR, "all", 1.0, label=str(reason))
        return replace(identified, diagnostics=(*identified.diagnostics, diagnostic))
    diagnostics = (*identified.diagnostics, *error.diagnostics(problem.nominal.dofs))
    return replace(identified, model_error=error, diagnostics=diagnostics)


def _calibrate(identifier: Identifier, problem: Problem, identified: Identified) -> ModelError:
    training, fold = folded(problem.training, len(identified.fold_models))
    models = list(identified.fold_models)
    for k in range(0 if models else int(np.max(fold)) + 1):
        part = training.part(fold != k)
        known = replace(problem, training=part, validation=part, compared=True)
        models.append(identifier.identify(known, np.random.default_rng(0)).model)
    nominal, own = problem.nominal, np.any(identified.residual.theta, axis=0)
    if identified.model.devices == nominal.devices and not np.all(own):  # as in the result
        models = [mixed_table(each, nominal, np.flatnonzero(~own).tolist()) for each in models]
    runs = nearby_runs(identified.model, training, problem.thruster)
    if runs.own.free_run[1]:
        raise IdentificationError("its free run diverges over the training part")
    restart = runs.own.course.restart | (np.diff(fold, prepend=-1) != 0)
    runs = replace(runs, own=Prediction(runs.own.plant, runs.own.course._replace(restart=restart)))
    errors = np.full_like(runs.own.course.measured, np.nan)  # each fold by the model without it
    for k, model in enumerate(models):
        with suppress(IdentificationError):
            predicted = predicted_by(model, runs.own.course)
            found, limited = predicted.deviations()
            if limited:
                found[predicted.lost()] = np.nan
            errors[fold == k] = found[fold == k]
    kept = np.all(np.isfinite(errors), axis=1) & ~restart
    if not np.any(kept):
        raise IdentificationError("every model diverges over what was left out of its training")
    rows = np.flatnonzero(kept)[:: max(int(np.sum(kept)) // MOST_ROWS, 1)]
    number = (fold if training.file is None else training.file)[rows]
    weight = 1.0 / np.bincount(number)[number]
    share = float(np.sum(kept)) / float(np.sum(~restart))
    return replace(_most_likely(identified, runs, errors[rows], rows, weight), share=share)


def _most_likely(
    identified: Identified, runs: NearbyRuns, errors: Array, rows: NDArray[np.int64], weight: Array
) -> ModelError:
    """The model error that makes errors (n, 2 n_dof) of the samples `rows` (n,) most likely."""
    training, course = runs.recording, runs.own.course
    pose = noise_floor(training.eta, training.piece_starts, training.period_s)
    noise = np.concatenate([pose.deviation, training.noise.deviation])
    mean_square = np.mean(runs.squares(training.nu, training.attitude), axis=0)
    n = len(training.dofs)

    def moved(force: Array, start: bool) -> Array:
        """Variance (n, 2 n_dof) of runs over courses that are drawn, by lambda (n_dof,)."""
        error = ModelError(1.0, force, 1.0, mean_square, noise)
        courses = (runs.drawn(error, i, start) for i in range(CALIBRATION_RUNS))
        return runs.variance(Prediction(runs.own.plant, each) for each in courses)[rows]

    fixed = moved(np.zeros(n), True) + noise**2
    by_force = np.stack([moved(each, False) for each in TRIED * np.eye(n)]) / TRIED**2
    fixed += (LEAST_DEVIATION * np.std(course.measured, axis=0)) ** 2 + STILL**2
    if not np.all(np.isfinite(fixed + np.sum(by_force, axis=0))):
        raise IdentificationError("runs that begin or are accelerated a little apart diverge")
    best, known, spread = (np.inf, 1.0, np.zeros(n), fixed), fixed, identified.spread
    for kappa2 in KAPPA2 if spread is not None else KAPPA2[:1]:
        if spread is not None:
            rng = np.random.default_rng(0)
            drawn = (
                (spread.draw(identified, rng, DEVIATION_SHARE, kappa2), course)
                for _ in range(CALIBRATION_RUNS)
            )
            known = runs.variance(predictable(drawn))[rows] + fixed
        if not np.all(np.isfinite(known)):  # drawn models diverge, and will the more with more
            break
        loss, force = _best_force(errors, known, by_force, weight)
        if loss >= best[0]:  # there is one minimum
            break
        best = loss, kappa2, force, known
    loss, kappa2, force, known = best
    if not np.isfinite(loss):
        raise IdentificationError("models drawn from its distribution diverge")
    ratio = np.abs(errors) / (
        scipy.special.ndtri(0.5 + 0.5 * LEVEL)
        * np.sqrt(known + np.tensordot(force**2, by_force, 1))
    )
    weights = np.repeat(weight, ratio.shape[1])
    scale = np.quantile(ratio.ravel(), LEVEL, weights=weights, method="inverted_cdf")
    return ModelError(kappa2, force, float(scale), mean_square, noise)


def folded(training: Recording, carried: int = 0) -> tuple[Recording, NDArray[np.int64]]:
    """The first samples of each file or block, at most MOST_SAMPLES of all, and their folds (N,).

    Folds are those of `carried` models that are known already. Else they are groups of files by
    turns, so that none has all of the small motions, or blocks of a single recording.
    """
    part, fold = np.zeros(len(training), dtype=np.int64), np.zeros(len(training), dtype=np.int64)
    for k, split in enumerate(training.folds(carried or FOLDS)):
        part[split.test] = fold[split.test] = k
    if training.file is not None and training.file[0] != training.file[-1]:
        part = np.unique(training.file, return_inverse=True)[1]
        fold = fold if carried else part % FOLDS
    number = np.arange(len(part)) - np.searchsorted(part, part)  # from the beginning of its part
    kept = number < MOST_SAMPLES // (part[-1] + 1)
    return training.part(kept), fold[kept]


def _best_force(e: Array, known: Array, by_force: Array, weight: Array) -> tuple[float, Array]:
    """The least loss by Student's t, and the lambda (n_dof,) that have it.

    Errors e (n, k), their variances without acceleration and (n_dof, n, k) with a lambda of one of
    an axis, weights (n,).
    """

    def loss(logarithm: Array) -> tuple[float, Array]:
        own = np.exp(2.0 * logarithm)
        variance = known + np.tensordot(own, by_force, 1)
        each = np.log(variance) + (FREEDOM + 1.0) * np.log1p(e**2 / (FREEDOM * variance))
        slope = weight[:, None] / variance
        slope *= 1.0 - (FREEDOM + 1.0) * e**2 / (FREEDOM * variance + e**2)
        gradient = 2.0 * own * np.tensordot(by_force, slope, ((1, 2), (0, 1)))
        return float(np.sum(weight @ each)), gradient

    start, bounds = np.full(len(by_force), np.log(TRIED)), [np.log(LAMBDA)] * len(by_force)
    found = scipy.optimize.minimize(loss, start, jac=True, bounds=bounds)
    return float(found.fun), np.exp(found.x)
