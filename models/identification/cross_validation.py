"""Cross-validation by free runs over blocks, or files, that were left out of the estimation.

A model is identified without one block of the training part at a time, and predicts that block:
free runs under the recorded force that begin again at the measured state every `horizon_s`. White
noise of the measured velocities is smoothed first: a run that begins at a single noisy sample may
leave the motion that was identified. Errors are relative to the spread over the training part,

    NRMSE = rms(nu_simulated - nu) / std(nu),    FIT = 100 (1 - NRMSE) %    of each axis.

A model that always predicts the mean motion has an NRMSE of one: an axis on which neither of two
models does better decides nothing between them, so models are compared by the mean over the axes
of NRMSE^2, each at most one. *Worse* and *better* mean by more than one standard error of the
difference, paired over the blocks, which are the same for all. Of several models the first one
listed that is not worse than the best is chosen: Hastie, Tibshirani and Friedman (2009), The
Elements of Statistical Learning, section 7.10.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError, RecordingError
from seatrial.models.identification.problem import Identified, Identifier, NoIdentifier, Problem
from seatrial.models.identification.validation import prediction, restart_length
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.signals import smoothing_for
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

FOLDS = 5  # of three a single one that is predicted badly hides what the others say
SEED = 0  # of estimates on blocks, so that the choice draws nothing from the trial's stream
SIMPLER = 0.04  # relative excess of the squared error that decides nothing
NEGLIGIBLE_ERROR = 1e-6  # mean squared error, over the variance, that cannot be told from none
FAR = 2.0  # times the squared error of another, which is no matter of chance
LEAST_MOTION = 2.0  # least standard deviation of a velocity that moves, over that of its noise
MIN_DEVIATION = 1e-9  # [m/s, rad/s] standard deviation below which nothing moved
UNUSABLE = (IdentificationError, ConfigurationError, RecordingError)  # what an identifier may say


class FoldErrors(NamedTuple):
    """Errors of the blocks left out, over the variance of each velocity of the training part.

    Blocks, or files, count alike: they, not their samples, are what is independent. Of a single
    block its free runs take the place of blocks.
    """

    squares: Array  # (n_blocks, n_axes) mean square error of the free runs of each
    weights: Array  # (n_blocks,) 1, of free runs their samples

    @property
    def nrmse(self) -> Array:
        """Root mean square error over the standard deviation, per axis (n_axes,)."""
        return np.asarray(np.sqrt(np.average(self.squares, axis=0, weights=self.weights)))

    @property
    def capped(self) -> Array:
        """Squares (n_blocks, n_axes), scaled to a mean of one on each axis that exceeds it."""
        return np.asarray(self.squares / np.maximum(self.nrmse, 1.0) ** 2)

    @property
    def error(self) -> float:
        """Mean over the axes of NRMSE^2, each at most one."""
        return float(np.mean(np.minimum(self.nrmse, 1.0) ** 2))

    def worse_axes(self, other: "FoldErrors") -> NDArray[np.bool_]:
        """Which axes (n_axes,) are worse than those of another."""
        own, reference = self.nrmse**2, other.nrmse**2
        error = _standard_error(self.squares - other.squares, self.weights)
        # an error of many times the other is none of chance: one run that explodes has a standard
        # error as large as itself
        uncertain = np.minimum(error, (FAR - 1.0) * reference)
        least = np.maximum(uncertain, SIMPLER * reference) + NEGLIGIBLE_ERROR
        return np.asarray(own - reference > least)

    def worse(self, other: "FoldErrors") -> bool:
        """Whether the error is worse than that of another."""
        difference = np.mean(self.capped - other.capped, axis=1, keepdims=True)
        error = float(_standard_error(difference, self.weights)[0])
        uncertain = min(error, (FAR - 1.0) * other.error)
        least = max(uncertain, SIMPLER * other.error, NEGLIGIBLE_ERROR - other.error)
        return self.error - other.error > least


def _standard_error(difference: Array, weights: Array) -> Array:
    """Standard error (k,) of the mean of differences (n, k), with weights (n,)."""
    n = len(difference)
    if n < 2:
        return np.zeros(difference.shape[1])
    share = weights / np.sum(weights)
    variance = share**2 @ (difference - share @ difference) ** 2
    return np.asarray(np.sqrt(variance * n / (n - 1)))


class BlockScore(NamedTuple):
    """How an identifier predicts the blocks left out; axes that lose have their nominal equation.

    `models` are those without each block, with these nominal equations.
    """

    errors: FoldErrors
    nominal_axes: tuple[int, ...]
    models: tuple[Vessel, ...]


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """The blocks of a problem's training part, and how they are predicted.

    `horizon_s` [s] is the length of a free run (None: by how fast errors grow, `restart_length`).
    """

    problem: Problem
    folds: int = FOLDS
    horizon_s: float | None = None
    force: str | None = None

    @cached_property
    def axes(self) -> list[int]:
        """Degrees of freedom whose velocity moved by more than its noise."""
        training = self.problem.training
        least = np.maximum(LEAST_MOTION * training.noise.deviation, MIN_DEVIATION)
        return np.flatnonzero(np.std(training.nu, axis=0) > least).tolist()

    @cached_property
    def problems(self) -> tuple[Problem, ...]:
        """The problem without each of the blocks, of which only the model is wanted."""
        training = self.problem.training
        parts = (training.part(s.train) for s in training.folds(self.folds))
        return tuple(
            replace(self.problem, training=part, validation=part, compared=True) for part in parts
        )

    @cached_property
    def smoothed(self) -> Recording:
        """The training part with its velocities as the regressions smooth them (`smoothing`)."""
        training = self.problem.training
        cutoff_hz = smoothing_for(training.noise.cutoff_hz, training.period_s).signals_hz
        if cutoff_hz is None:
            return training
        return replace(training, nu=training.lowpassed(training.nu, cutoff_hz))

    @cached_property
    def blocks(self) -> tuple[Recording, ...]:
        """The blocks that are predicted, with smoothed velocities."""
        smooth = self.smoothed
        return tuple(smooth.part(s.test) for s in smooth.folds(self.folds))

    @cached_property
    def _every(self) -> int:
        """Samples between the restarts."""
        training = self.problem.training
        length = self.horizon_s or restart_length(self.problem.nominal, training)
        return max(round(length / training.period_s), 2)

    @cached_property
    def nominal(self) -> FoldErrors:
        """Errors of the nominal model; those of the mean motion if it cannot be simulated."""
        try:
            return self.errors([self.problem.nominal] * len(self.blocks))
        except UNUSABLE:
            n = len(self.blocks)
            return FoldErrors(np.ones((n, len(self.axes))), np.ones(n))

    def models(self, identifier: Identifier) -> list[Vessel]:
        """Models that were identified without each block; raises an error of UNUSABLE."""
        if isinstance(identifier, NoIdentifier):
            return [self.problem.nominal] * len(self.problems)
        identifier.check(self.problem.nominal, self.problem.thruster, measured=False)
        return [
            identifier.identify(problem, np.random.default_rng(SEED)).model
            for problem in self.problems
        ]

    def errors(self, models: Sequence[Vessel]) -> FoldErrors:
        """Errors of models on the blocks, each of one that was identified without its block.

        Raises IdentificationError when one of them cannot be simulated.
        """
        runs = [self.runs(*pair) for pair in zip(models, self.blocks, strict=True)]
        if len(runs) == 1:
            return runs[0]
        return FoldErrors(np.stack([own.nrmse**2 for own in runs]), np.ones(len(runs)))

    def runs(self, model: Vessel, recording: Recording) -> FoldErrors:
        """Errors of free runs of a model over a recording; where rates are limited they are large.

        Raises IdentificationError when the model cannot be simulated.
        """
        predicted = prediction(model, recording, self.problem.thruster, self.force, self._every)
        deviations, _ = predicted.deviations()
        restart, axes = predicted.course.restart, self.axes
        errors = deviations[:, len(model.dofs) :][:, axes]
        variance = np.var(self.problem.training.nu[:, axes], axis=0)
        begin = np.flatnonzero(restart)
        length = np.diff(np.append(begin, len(restart)))
        squares = np.add.reduceat(errors**2, begin, axis=0) / variance
        kept = length > 1  # the first sample of a run is the measured state itself
        return FoldErrors(squares[kept] / (length[kept, None] - 1.0), length[kept] - 1.0)

    def score(self, models: Sequence[Vessel], together: bool = False) -> BlockScore:
        """The errors of models of each block (or of one block), axis by axis beside the nominal.

        An axis keeps its nominal equation if it is worse with its own, or if neither model beats
        the mean motion on it and the own equation is not better beyond chance: a nominal one may be
        far worse than the mean. The rest is judged again, since the equations act on each other. A
        model with other parameters of its devices is not mixed. Equations that belong `together`,
        as of a state-space model, are all nominal where they are worse as a whole, or where neither
        model beats the mean motion on some axis.
        """
        table, nominal, lost = self.problem.nominal, self.nominal, list[int]()
        every, mixed = range(len(table.dofs)), tuple(models)
        fallen = BlockScore(nominal, tuple(every), (table,) * len(models))
        while True:
            try:
                errors = self.errors(mixed)
            except UNUSABLE:  # the model cannot be simulated
                return fallen
            no_skill = (errors.nrmse > 1.0) & (nominal.nrmse > 1.0)
            if together:
                fails = np.any(no_skill) or errors.worse(nominal)
                return fallen if fails else BlockScore(errors, (), mixed)
            worse = errors.worse_axes(nominal) | (no_skill & ~nominal.worse_axes(errors))
            new = [k for k, bad in zip(self.axes, worse, strict=True) if bad and k not in lost]
            if not new:
                return BlockScore(errors, tuple(sorted(lost)), mixed)
            lost += new
            if any(model.devices != table.devices for model in models):
                lost = list(every)
            mixed = tuple(mixed_table(model, table, lost) for model in models)


def mixed_table(model: Vessel, nominal: Vessel, axes: Sequence[int]) -> Vessel:
    """A model with the nominal equations of some axes; all of them: the nominal model."""
    if len(axes) == len(nominal.dofs):
        return nominal
    terms = model.terms + tuple(term for term in nominal.terms if term not in model.terms)
    theta = model.on(terms).theta.copy()
    theta[:, list(axes)] = nominal.on(terms).theta[:, list(axes)]
    return replace(model, terms=terms, theta=theta)


def one_standard_error_rule(errors: Mapping[str, FoldErrors]) -> str:
    """The first name whose error is not worse than the least one."""
    best = min(errors, key=lambda name: errors[name].error)
    return next(name for name in errors if not errors[name].worse(errors[best]))


def scores_of(
    alternatives: Mapping[str, Identifier], validation: CrossValidation, reasons: dict[str, str]
) -> dict[str, BlockScore]:
    """The scores of alternatives, such as values of an option; why one has none is in `reasons`."""
    scores = {}
    for name, identifier in alternatives.items():
        try:
            scores[name] = validation.score(validation.models(identifier))
        except UNUSABLE as error:
            reasons[name] = str(error)
    return scores


def best_of(
    alternatives: Mapping[str, Identifier], validation: CrossValidation, rng: np.random.Generator
) -> Identified:
    """Identify with the alternative that predicts the blocks left out best.

    Raises IdentificationError when none of them predicts the blocks.
    """
    if len(alternatives) == 1:
        return next(iter(alternatives.values())).identify(validation.problem, rng)
    reasons: dict[str, str] = {}
    scores = scores_of(alternatives, validation, reasons)
    if not scores:
        name, reason = next(iter(reasons.items()))
        raise IdentificationError(f"no alternative predicts the training part: {name}: {reason}")
    errors = {name: score.errors for name, score in scores.items()}
    chosen = one_standard_error_rule(errors)
    result = alternatives[chosen].identify(validation.problem, rng)
    found = (*result.diagnostics, *error_diagnostics(errors, validation, chosen))
    note = choice(chosen, errors[chosen], validation)
    return replace(
        result, diagnostics=found, notes=(*result.notes, note), fold_models=scores[chosen].models
    )


def choice(name: str, errors: FoldErrors, validation: CrossValidation) -> str:
    """What was chosen, with its errors beside those of the nominal model, in one line."""
    dofs = validation.problem.nominal.dofs
    rows = zip(validation.axes, errors.nrmse, validation.nominal.nrmse, strict=True)
    own = ", ".join(f"{dofs[k]} {error:.2f} ({other:.2f})" for k, error, other in rows)
    what = "NRMSE of blocks left out (of the nominal model; 1 is the mean motion)"
    return f"chosen: {name}; {what}: {own}"


def error_diagnostics(
    errors: Mapping[str, FoldErrors], validation: CrossValidation, chosen: str
) -> tuple[Diagnostic, ...]:
    """FIT of every alternative per axis, its mean NRMSE, and the choice."""
    dofs, rows = validation.problem.nominal.dofs, list[Diagnostic]()
    for i, (name, own) in enumerate(errors.items()):
        for k, fit in zip(validation.axes, 100.0 * (1.0 - own.nrmse), strict=True):
            rows.append(Diagnostic("left_out_fit", dofs[k], float(fit), "%", i, label=name))
        error = float(np.sqrt(own.error))
        rows.append(Diagnostic("left_out_error", "all", error, "", i, label=name))
        rows.append(Diagnostic("chosen", "all", float(name == chosen), "", i, label=name))
    return tuple(rows)
