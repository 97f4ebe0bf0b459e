"""Selection by free runs over blocks that were left out of the estimation.

Every alternative is identified without one block of the training part at a time, and predicts that
block: free runs under the recorded force that begin again at the measured state every `horizon_s`.
White noise of the measured velocities is smoothed first: a run that begins at a single noisy sample
may leave the motion that was identified, and what no model predicts hides how they differ. Errors
are relative to the spread of each velocity over the training part; per axis

    NRMSE = rms(nu_simulated - nu) / std(nu),    FIT = 100 (1 - NRMSE) %.

Identifiers are compared by the mean of NRMSE^2 over the axes, and paired over the free runs, since
the blocks are the same for all. Of those that exceed the least by no more than one standard error
of the difference, or by hardly anything, the first one listed is chosen: Hastie, Tibshirani and
Friedman (2009), section 7.10. Of alternatives of one identifier by itself it is the first one that
exceeds the least by hardly anything.

One-step errors of the force, by which orders and penalties are usually chosen, do not see whether a
model runs away; an order or a method chosen on the test part is evaluated on the data that chose
it: Jervan (2020), chapter 6.

An identified model that is on no axis worse than knowing nothing.

Every block of the training part is predicted by free runs of a model that was identified without
it, and of the nominal one (`blocked_free_run`). An axis that is predicted worse keeps its nominal
equation; then the rest is judged again, since the equations act on each other.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import NamedTuple

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError, RecordingError
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.identification.spread import TableSpread
from seatrial.models.identification.validation import RESTART_S, prediction
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import smoothing_for
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

BLOCK_FOLDS = 3
SEED = 0  # of estimates on blocks, so that the choice draws nothing from the trial's stream
SIMPLER = 0.04  # relative excess of the squared error that a simpler alternative may have
NEGLIGIBLE_ERROR = 1e-6  # mean squared error, over the variance, that cannot be told from none
FAR = 2.0  # times the squared error of another, which is no matter of chance
MOTION = 2.0  # least standard deviation of a velocity that moves, over that of its noise
MIN_DEVIATION = 1e-9  # [m/s, rad/s] standard deviation below which nothing moved
UNUSABLE = (IdentificationError, ConfigurationError, RecordingError)  # what an alternative may say


class LeftOut(NamedTuple):
    """Errors on the blocks left out, over the variance of each velocity of the training part."""

    squares: Array  # (n_runs, n_axes) mean square error of each free run
    samples: Array  # (n_runs,) samples of each
    models: tuple[Vessel, ...] = ()  # that were identified without each block

    @property
    def nrmse(self) -> Array:
        """Root mean square error over the standard deviation, per axis (n_axes,)."""
        return np.asarray(np.sqrt(np.average(self.squares, axis=0, weights=self.samples)))

    @property
    def error(self) -> float:
        """Mean of NRMSE^2 over the axes."""
        return float(np.mean(self.nrmse**2))

    def excess(self, other: "LeftOut") -> tuple[Array, Array]:
        """Mean of own minus other NRMSE^2 per axis (n_axes,), and its standard error."""
        difference = self.squares - other.squares
        mean = np.average(difference, axis=0, weights=self.samples)
        if len(difference) < 2:
            return mean, np.zeros_like(mean)
        share = self.samples / np.sum(self.samples)
        variance = np.einsum("r,rk->k", share**2, (difference - mean) ** 2)
        return mean, np.sqrt(variance * len(difference) / (len(difference) - 1))

    def exceeds(self, other: "LeftOut", deviations: float = 1.0) -> bool:
        """Whether the error is larger by more than `deviations` standard errors and what matters.

        An error of more than FAR times the other is: one run that explodes has a standard error
        as large as itself.
        """
        overall = LeftOut(np.mean(self.squares, axis=1, keepdims=True), self.samples)
        reference = LeftOut(np.mean(other.squares, axis=1, keepdims=True), other.samples)
        mean, error = overall.excess(reference)
        uncertain = min(deviations * float(error[0]), (FAR - 1.0) * other.error)
        return float(mean[0]) > max(
            uncertain, SIMPLER * other.error, NEGLIGIBLE_ERROR - other.error
        )


@dataclass(frozen=True, eq=False)
class Blocks:
    """The blocks of a problem's training part, and how they are predicted."""

    problem: Problem
    folds: int = BLOCK_FOLDS
    horizon_s: float = RESTART_S
    force: str | None = None

    @cached_property
    def axes(self) -> list[int]:
        """Degrees of freedom whose velocity moved by more than its noise."""
        training = self.problem.training
        moved = np.std(training.nu, axis=0) > np.maximum(
            MOTION * training.noise.deviation, MIN_DEVIATION
        )
        return np.flatnonzero(moved).tolist()

    @property
    def every_axis(self) -> list[int]:
        """All degrees of freedom."""
        return list(range(len(self.problem.nominal.dofs)))

    def worse(self, left_out: LeftOut, reference: LeftOut) -> str | None:
        """What is lost, or FAR worse than a reference; None: nothing."""
        lost = self.lost(left_out, reference)
        worse = [
            f"{self.problem.nominal.dofs[k]} {own:.3g} instead of {other:.3g}"
            for k, own, other in zip(self.axes, left_out.nrmse, reference.nrmse, strict=True)
            if k in lost or own**2 > FAR * other**2 + NEGLIGIBLE_ERROR
        ]
        return f"worse than the nominal model: NRMSE in {', '.join(worse)}" if worse else None

    def lost(self, left_out: LeftOut, reference: LeftOut) -> list[int]:
        """The axes that are worse than a reference by more than one standard error."""
        mean, error = left_out.excess(reference)
        allowed = np.maximum(error, SIMPLER * reference.nrmse**2 + NEGLIGIBLE_ERROR)
        return [k for k, own, most in zip(self.axes, mean, allowed, strict=True) if own > most]

    def judge(self, identifier: Identifier) -> LeftOut:
        """Errors of an identifier on every block left out.

        Raises an error of UNUSABLE when it cannot identify, or its model cannot be simulated.
        """
        identifier.check(self.problem.nominal, self.problem.thruster, measured=False)
        return self.errors(
            [
                identifier.identify(problem, np.random.default_rng(SEED)).model
                for problem in self.problems
            ]
        )

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """The problem without each of the blocks, of which only the model is wanted."""
        training = self.problem.training
        parts = (training.part(s.train) for s in training.folds(self.folds))
        return tuple(
            replace(self.problem, training=part, validation=part, compared=True) for part in parts
        )

    @cached_property
    def left_out(self) -> tuple[Recording, ...]:
        """The blocks, with smoothed velocities."""
        smooth = self.smoothed
        return tuple(smooth.part(s.test) for s in smooth.folds(self.folds))

    @cached_property
    def smoothed(self) -> Recording:
        """The training part with its velocities as the regressions smooth them (`smoothing`)."""
        training = self.problem.training
        cutoff_hz = smoothing_for(training.noise.cutoff_hz, training.period_s).signals_hz
        if cutoff_hz is None:
            return training
        return replace(training, nu=training.lowpassed(training.nu, cutoff_hz))

    def errors(self, models: Sequence[Vessel]) -> LeftOut:
        """Errors of models on the blocks, each of one that was identified without its block.

        Raises IdentificationError when one of them cannot be simulated.
        """
        errors = [
            self.runs(model, block) for model, block in zip(models, self.left_out, strict=True)
        ]
        squares, samples = (np.concatenate([each[k] for each in errors]) for k in range(2))
        return LeftOut(squares, samples, tuple(models))

    def runs(self, model: Vessel, recording: Recording) -> LeftOut:
        """Errors of free runs of a model over a recording; where rates are limited they are large.

        Raises IdentificationError when the model cannot be simulated.
        """
        every = max(round(self.horizon_s / recording.period_s), 2)
        predicted = prediction(model, recording, self.problem.thruster, self.force, every)
        deviations, _ = predicted.deviations()
        restart, axes = predicted.course.restart, self.axes
        errors = deviations[:, len(model.dofs) :][:, axes]
        variance = np.var(self.problem.training.nu[:, axes], axis=0)
        begin = np.flatnonzero(restart)
        length = np.diff(np.append(begin, len(restart)))
        squares = np.add.reduceat(errors**2, begin, axis=0) / variance
        kept = length > 1  # the first sample of a run is the measured state itself
        return LeftOut(squares[kept] / (length[kept, None] - 1.0), length[kept] - 1.0)


def first_within(errors: dict[str, LeftOut]) -> str:
    """The first name whose error hardly exceeds the least one."""
    best = min(errors, key=lambda name: errors[name].error)
    return next(name for name in errors if not errors[name].exceeds(errors[best]))


def first_equal(errors: dict[str, LeftOut]) -> str:
    """The first name whose error is hardly above the least one, whatever chance may explain.

    For choices of terms of one model: under a force without its term every free run is poor, and
    the few in which a model with it goes astray make the standard error as large as the gain.
    """
    least = min(left_out.error for left_out in errors.values())
    most = (1.0 + SIMPLER) * least + NEGLIGIBLE_ERROR
    return next(name for name, left_out in errors.items() if left_out.error <= most)


@dataclass(frozen=True, eq=False)
class Contest:
    """Candidates compared by free runs over blocks left out, each with its best alternative.

    Alternatives of one candidate are compared by their quick forms, the candidates themselves as
    they are. After `budget_s` [s] no further estimate begins.
    """

    candidates: Mapping[str, Mapping[str, Identifier]]  # alternatives, the preferred first
    blocks: Blocks
    reference: LeftOut | None = None  # what an admissible candidate must predict better than
    budget_s: float | None = None

    def run(self) -> tuple[dict[str, LeftOut], dict[str, str]]:
        """Errors of the admissible alternatives in their order, and why others were left out."""
        began, errors, reasons = perf_counter(), dict[str, LeftOut](), dict[str, str]()
        for alternatives in self.candidates.values():
            if self.budget_s is not None and perf_counter() - began > self.budget_s:
                reasons |= dict.fromkeys(alternatives, f"the budget of {self.budget_s:g} s is over")
                continue
            name = self._best(alternatives, reasons)
            judged = self._judge(name, alternatives[name].without_bootstrap(), reasons)
            if judged is None:
                continue
            refused = self.reference and self._refusal(judged, self.reference)
            if refused:
                reasons[name] = refused
            else:
                errors[name] = judged
        return errors, reasons

    def _refusal(self, judged: LeftOut, reference: LeftOut) -> str | None:
        """Why a candidate is not admissible beside the reference; None: it is.

        It must be worse on no axis, and better on the whole by more than chance.
        """
        worse = self.blocks.worse(judged, reference)
        if worse or reference.exceeds(judged):
            return worse
        own, other = np.sqrt([judged.error, reference.error])
        return f"no better than the nominal model, beyond chance: NRMSE {own:.3g} and {other:.3g}"

    def _best(self, alternatives: Mapping[str, Identifier], reasons: dict[str, str]) -> str:
        """The alternative with the best quick form; the first one if none can be judged."""
        if len(alternatives) == 1:
            return next(iter(alternatives))
        quick = {
            name: judged
            for name, identifier in alternatives.items()
            if (judged := self._judge(name, identifier.quick(), reasons)) is not None
        }
        best = first_within(quick) if quick else next(iter(alternatives))
        for name, judged in quick.items():
            reasons[name] = f"quick estimate: NRMSE {np.sqrt(judged.error):.3g}"
        reasons.pop(best, None)
        return best

    def _judge(self, name: str, identifier: Identifier, reasons: dict[str, str]) -> LeftOut | None:
        try:
            return self.blocks.judge(identifier)
        except UNUSABLE as error:
            reasons[name] = str(error)
            return None


def best_of(
    alternatives: Mapping[str, Identifier], blocks: Blocks, rng: np.random.Generator
) -> Identified:
    """Identify with the alternative that predicts the blocks left out best.

    Raises IdentificationError when none of them predicts the blocks.
    """
    candidates = {name: {name: identifier} for name, identifier in alternatives.items()}
    if len(candidates) == 1:
        return next(iter(alternatives.values())).identify(blocks.problem, rng)
    errors, reasons = Contest(candidates, blocks).run()
    if not errors:
        name, reason = next(iter(reasons.items()))
        raise IdentificationError(f"no alternative predicts the training part: {name}: {reason}")
    chosen = first_equal(errors)
    result = alternatives[chosen].identify(blocks.problem, rng)
    diagnostics = (*result.diagnostics, *error_diagnostics(errors, blocks, chosen))
    return replace(result, diagnostics=diagnostics, fold_models=errors[chosen].models)


def error_diagnostics(
    errors: dict[str, LeftOut], blocks: Blocks, chosen: str
) -> tuple[Diagnostic, ...]:
    """FIT of every alternative per axis, its mean NRMSE, and the choice."""
    dofs, rows = blocks.problem.nominal.dofs, []
    for i, (name, left_out) in enumerate(errors.items()):
        fits = zip(blocks.axes, 100.0 * (1.0 - left_out.nrmse), strict=True)
        rows += [
            Diagnostic("left_out_fit", dofs[k], float(fit), "%", i, label=name) for k, fit in fits
        ]
        rows.append(
            Diagnostic("left_out_error", "all", float(np.sqrt(left_out.error)), "", i, label=name)
        )
        rows.append(Diagnostic("chosen", "all", float(name == chosen), "", i, label=name))
    return tuple(rows)


WORSE_THAN_NOMINAL = "worse_than_nominal"  # the diagnostic of an axis
RUNAWAY_ERROR = 2.0  # error over the spread of the motion: twice that of its mean


@dataclass(frozen=True, eq=False)
class TrainingPart(Blocks):
    """The whole training part in place of blocks, to judge a model that is fitted to it."""

    @cached_property
    def left_out(self) -> tuple[Recording, ...]:
        """The training part, with smoothed velocities."""
        return (self.smoothed,)


class Runaway(TrainingPart):
    """Judges a regression: an axis is lost that is worse than the nominal model and runs away.

    A regression minimises the error of the force, so its free runs over the same part may be a
    little worse; with twice the error of the mean motion they say that it has failed.
    """

    def lost(self, left_out: LeftOut, reference: LeftOut) -> list[int]:
        """The axes that are worse than a reference, and whose error is above RUNAWAY."""
        nrmse = dict(zip(self.axes, left_out.nrmse, strict=True))
        return [k for k in super().lost(left_out, reference) if nrmse[k] > RUNAWAY_ERROR]


def held_to_nominal(part: TrainingPart, result: Identified) -> Identified:
    """The result with the nominal equation of each axis that it predicts worse where it was fitted.

    Free runs over the training part are compared. It costs no further estimate, and finds models
    that run away or whose regression has failed, not those that are fitted too closely.
    """
    return guarded_by([result.model], part, result)


def guarded(
    blocks: Blocks, estimate: Callable[[Problem], Vessel], result: Identified
) -> Identified:
    """The result with the nominal equation of each axis that is predicted worse with its own.

    `estimate` returns the model of a part of the recording.
    """
    try:
        models = [estimate(problem) for problem in blocks.problems]
    except UNUSABLE:
        return with_nominal_axes(
            result, blocks.problem.nominal, blocks.every_axis, WORSE_THAN_NOMINAL
        )
    return guarded_by(models, blocks, result)


def guarded_by(models: Sequence[Vessel], blocks: Blocks, result: Identified) -> Identified:
    """The same for models that were identified without each of the blocks.

    An axis that did not move, or of which the nominal model cannot be simulated, is not judged.
    """
    nominal = blocks.problem.nominal
    if not blocks.axes:
        return result
    try:
        reference = blocks.errors([nominal] * len(blocks.left_out))
    except UNUSABLE:
        return result
    lost: list[int] = []
    while new := [k for k in _lost(blocks, models, nominal, lost, reference) if k not in lost]:
        lost += new
    changed = with_nominal_axes(result, nominal, lost, WORSE_THAN_NOMINAL)
    if lost and unphysical(changed.model, nominal, blocks.problem.training.nu) is not None:
        return with_nominal_axes(result, nominal, blocks.every_axis, WORSE_THAN_NOMINAL)
    return changed


def _lost(
    blocks: Blocks, models: Sequence[Vessel], nominal: Vessel, lost: list[int], reference: LeftOut
) -> list[int]:
    """The axes on which models are worse; all where they cannot be simulated."""
    mixed = [mixed_table(model, nominal, lost) for model in models]
    try:
        return blocks.lost(blocks.errors(mixed), reference)
    except UNUSABLE:
        return blocks.every_axis


def mixed_table(model: Vessel, nominal: Vessel, axes: Sequence[int]) -> Vessel:
    """A model with the nominal equations of some axes."""
    terms = model.terms + tuple(term for term in nominal.terms if term not in model.terms)
    theta = model.on(terms).theta.copy()
    theta[:, list(axes)] = nominal.on(terms).theta[:, list(axes)]
    return replace(model, terms=terms, theta=theta)


def with_nominal_axes(
    result: Identified, nominal: Vessel, axes: Sequence[int], diagnostic: str
) -> Identified:
    """A result with the nominal equations of some axes, each with a `diagnostic`."""
    if not axes:
        return result

    def without(table: Array, value: float) -> Array:
        changed = table.copy()
        changed[:, list(axes)] = value
        return changed

    residual = replace(result.residual, theta=without(result.residual.theta, 0.0))
    dofs = nominal.dofs
    return replace(
        result,
        model=nominal + residual,
        residual=residual,
        std_error=None if result.std_error is None else without(result.std_error, np.nan),
        spread=result.spread if isinstance(result.spread, TableSpread) else None,
        diagnostics=(*result.diagnostics, *(Diagnostic(diagnostic, dofs[k], 1.0) for k in axes)),
    )
