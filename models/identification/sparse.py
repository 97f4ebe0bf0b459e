"""Sparse regression of the lack of fit, by the optimizers of pysindy.

    stlsq  min |y - X w|^2 + penalty |w|^2, terms with |w_j| < threshold left out, repeated:
           Brunton, Proctor and Kutz (2016), PNAS 113, 3932-3937
    sr3    min |y - X w|^2 / 2 + lambda |s|_0 + |w - s|^2 / (2 relaxation), lambda so that s_j is
           zero below the threshold: Champion, Zheng, Aravkin, Brunton and Kutz (2020), IEEE
           Access 8, 169259-169271

y is the lack of fit of one degree of freedom, X are the terms; both are standardised, so w_j is the
share of a term in the lack of fit and one threshold serves all terms and vessels. The term 1 is the
intercept, which is never left out. By default the threshold of each degree of freedom is chosen on
blocks left out of the training part: the largest one whose error exceeds the least by at most one
standard error of the difference, Hastie, Tibshirani and Friedman (2009), section 7.10. The nominal
model is among the choices.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.cross_validation import CrossValidation
from seatrial.models.identification.fallback import guarded
from seatrial.models.identification.linear import Decomposition, columns_of, factor, triangle
from seatrial.models.identification.problem import Identified, Needs, Problem
from seatrial.models.identification.residual import ResidualOptions, Samples, thruster_of
from seatrial.models.notation import SQUARE_UNIT
from seatrial.models.ranges import Folds, NotNegative, Positive
from seatrial.models.recording.recording import blocks
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

THRESHOLDS = (0.0, *np.geomspace(1e-3, 1.0, 7).tolist())  # shares of the lack of fit
NEGLIGIBLE_TERM = 1e-12  # share of a term in the lack of fit that is rounding
CHOICES: tuple[float | None, ...] = (*THRESHOLDS, None)  # None: no terms, the nominal model
ROUNDING = 1e-12  # mean square of an error, relative to the force's, below which it is rounding
ITERATIONS = 300  # at most; STLSQ needs one for each term that it leaves out
CONVERGED = 1e-6  # change of w at which SR3 ends


@dataclass(frozen=True)
class Sparse(ResidualOptions):
    """Sequentially thresholded least squares (`stlsq`) or sparse relaxed regression (`sr3`).

    `threshold` is the least share of a term in the lack of fit; null chooses it by
    cross-validation over `folds` blocks. `penalty` is that of `stlsq` per sample, `relaxation` the
    nu of `sr3`. With `unbiased` the terms that are left are fitted again by least squares.
    """

    algorithm: Literal["stlsq", "sr3"]
    threshold: NotNegative | None
    penalty: NotNegative
    relaxation: Positive
    unbiased: bool
    folds: Folds

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError without pysindy, or for options that do not fit the vessel."""
        if find_spec("pysindy") is None:
            raise ConfigurationError(
                "identifier=sparse: pysindy is not installed: pip install 'seatrial[rivals]'"
            )
        super().check(nominal, thruster, measured)

    def needs(self) -> Needs:
        """The data of the residual, and two samples for each fold."""
        return super().needs()._replace(samples=2 * self.folds)

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table; an axis that free runs predict worse keeps its equation."""
        blocks = CrossValidation(problem, horizon_s=self.segment_s, force=self.force)
        quick = replace(self, refinement="none")
        return guarded(blocks, lambda part: quick.fitted(part).model, self.fitted(problem))

    @property
    def protected(self) -> bool:
        """The axes are judged on blocks left out already."""
        return False

    def fitted(self, problem: Problem) -> Identified:
        """Identify the residual table, with the threshold and the number of terms of each axis."""
        lag, diagnostics = thruster_of(self, problem)
        samples = self.samples(problem.training, problem.nominal, lag)
        dofs = problem.nominal.dofs
        thresholds = [self.threshold] * len(dofs)
        folds = [
            (factor(samples, block, None, samples.epsilon), block.stop - block.start)
            for block in blocks(len(samples), self.folds)
        ]
        if self.threshold is None:
            errors = self.left_out_errors(samples, folds)
            floor = ROUNDING * np.mean(samples.force**2, axis=0)
            thresholds = [CHOICES[sparsest(errors[..., k], floor[k])] for k in range(len(dofs))]
            diagnostics += error_diagnostics(np.mean(errors, axis=1), dofs)
        part, n = self._decompose([R for R, _ in folds], samples), len(samples)
        columns = [self._solve(part, n, one, slice(k, k + 1)) for k, one in enumerate(thresholds)]
        residual = Vessel("residual", dofs, samples.terms, np.hstack(columns))
        diagnostics += choice_diagnostics(residual, thresholds)
        result = Identified(problem.nominal + residual, residual, diagnostics=diagnostics)
        return finished(self, problem, lag, samples, result)

    def left_out_errors(self, samples: Samples, folds: list[tuple[Array, int]]) -> Array:
        """Mean square of the lack of fit on the blocks left out, shape (n_choices, folds, n_dof).

        `folds` are the triangular factor of each block and its number of samples. Raises
        IdentificationError if the terms cannot be distinguished without a block.
        """
        order, n_dof = columns_of(samples), samples.epsilon.shape[1]
        errors = np.empty((len(CHOICES), len(folds), n_dof))
        for j, (left_out, n) in enumerate(folds):
            part = self._decompose([R for R, _ in folds if R is not left_out], samples, n)
            for i, threshold in enumerate(CHOICES):
                theta = self._solve(part, len(samples) - n, threshold, slice(n_dof))[order]
                rest = left_out @ np.vstack([-theta, np.eye(n_dof)])
                errors[i, j] = np.sum(rest**2, axis=0) / n
        return errors

    def _decompose(self, factors: list[Array], samples: Samples, without: int = 0) -> Decomposition:
        """The decomposition of blocks by their triangular factors, `without` some samples."""
        penalised = self.algorithm == "stlsq" and self.penalty > 0.0
        order, total = columns_of(samples), float(len(samples) - without)
        return Decomposition.of(triangle(factors), samples.terms, order, total, penalised)

    def _solve(self, part: Decomposition, n: int, threshold: float | None, axes: slice) -> Array:
        """The table (n_terms, n_axes) of the lack of fit of n samples; None: no terms.

        Rotating the samples by U' leaves the regression as it is, with one row for each column.
        """
        along, left = part.along[:, axes], part.left[:, axes]
        theta = np.zeros((part.n_terms, along.shape[1]))
        if threshold is None:
            return theta
        root, size = np.sqrt(n), np.sqrt(np.sum(along**2, axis=0) + np.sum(left**2, axis=0))
        size[size == 0.0] = 1.0
        with warnings.catch_warnings():  # that no term is left is a result; it is stored
            warnings.simplefilter("ignore")
            optimizer = self._optimizer(threshold)
            optimizer.fit(part.s[:, None] * part.vt / root, along / size)
        shares = np.where(np.abs(optimizer.coef_) > NEGLIGIBLE_TERM, optimizer.coef_, 0.0)
        theta[part.columns] = shares.T * size / root / part.scale[:, None]
        if part.constant is not None:
            theta[part.constant] = part.offset[axes] - part.mean @ theta[part.columns]
        return theta

    def _optimizer(self, threshold: float) -> Any:
        from pysindy.optimizers import SR3, STLSQ  # slow to import, and optional

        if self.algorithm == "stlsq":
            return STLSQ(
                threshold,
                alpha=self.penalty,
                max_iter=ITERATIONS,
                ridge_kw={"solver": "svd"},
                unbias=self.unbiased,
            )
        return SR3(
            SR3.calculate_l0_weight(threshold, self.relaxation),
            regularizer="L0",
            relax_coeff_nu=self.relaxation,
            tol=CONVERGED,
            max_iter=ITERATIONS,
            unbias=self.unbiased,
        )


def sparsest(errors: Array, floor: float) -> int:
    """Index of the last choice within one standard error of the least error.

    `errors` (n_choices, folds) begin with the most terms; those below `floor` are equal.
    """
    errors = np.maximum(errors, floor)
    excess = errors - errors[int(np.argmin(np.mean(errors, axis=1)))]
    allowed = np.std(excess, axis=1, ddof=1) / np.sqrt(errors.shape[1])
    return int(np.flatnonzero(np.mean(excess, axis=1) <= allowed)[-1])


def error_diagnostics(errors: Array, dofs: tuple[str, ...]) -> tuple[Diagnostic, ...]:
    """Mean squared error (n_choices, n_dof) on the blocks left out for every threshold."""
    labels = ["no terms" if choice is None else f"{choice:.3g}" for choice in CHOICES]
    return tuple(
        Diagnostic("threshold_mse", dof, float(errors[i, k]), SQUARE_UNIT[dof], i=i, label=label)
        for k, dof in enumerate(dofs)
        for i, label in enumerate(labels)
    )


def choice_diagnostics(
    residual: Vessel, thresholds: Sequence[float | None]
) -> tuple[Diagnostic, ...]:
    """The threshold of each degree of freedom (None: no terms) and how many terms are left."""
    diagnostics = []
    for k, (dof, threshold) in enumerate(zip(residual.dofs, thresholds, strict=True)):
        count = int(np.count_nonzero(residual.theta[:, k]))
        diagnostics.append(Diagnostic("sparse_threshold", dof, threshold))
        diagnostics.append(Diagnostic("selected_variables", dof, float(count)))
    return tuple(diagnostics)
