"""Partial least squares regression of the lack of fit. Jervan (2020), sections 3.3 and 4.5.

The equations are in `kernel_pls`. The order of each degree of freedom has the least mean squared
error on left-out data, see `Selection`. Neighbouring samples are correlated, so blocks are left
out, not single samples.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.kernel_pls import (
    Block,
    Columns,
    LeftOut,
    all_orders,
    columns,
    left_out_mse,
    mean_squares,
)
from seatrial.models.identification.problem import Identified, Needs, Problem
from seatrial.models.identification.residual import CONSTANT, ResidualOptions, Samples, thruster_of
from seatrial.models.identification.uncertainty import block_bootstrap
from seatrial.models.notation import SQUARE_UNIT
from seatrial.models.ranges import Folds, Positive, PositiveInt, Replicates
from seatrial.models.recording.recording import blocks
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

# Blocks, or files, of the training part; the held-out part itself, as in the thesis, whose error is
# too optimistic.
Selection = Literal["blocked", "test"]


@dataclass(frozen=True)
class PartialLeastSquares(ResidualOptions):
    """Common options of the regressions by partial least squares.

    The constant is always in the basis. `bootstrap` is the number of block-bootstrap replicates
    for standard errors, null for none. The standard errors do not include the bias towards the
    nominal model.
    """

    folds: Folds
    bootstrap: Replicates | None
    block_s: Positive

    def needs(self) -> Needs:
        """The data of the residual, and two samples for each fold."""
        return super().needs()._replace(samples=2 * self.folds)

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel, with the constant."""
        terms = super().terms(nominal)
        return terms if CONSTANT in terms else (CONSTANT, *terms)

    def columns(self, samples: Samples) -> Columns:
        """Standardised columns of the samples."""
        return columns(samples)

    def left_out(
        self, selection: Selection, problem: Problem, lag: SecondOrderLag | None,
        samples: Samples, z: Columns,
    ) -> LeftOut:  # fmt: skip
        """What the models of the training part, `samples` and their columns z, are judged on.

        Raises IdentificationError when there are fewer than two samples per block.
        """
        if selection == "test":
            held_out = z.like(self.samples(problem.validation, problem.nominal, lag))
            return LeftOut((Block.of(z.x, slice(None)),), held_out.T @ held_out)
        if len(z.z) < 2 * self.folds:
            raise IdentificationError(
                f"{selection} selection: got {len(z.z)} samples for {self.folds} folds, expected "
                f"at least {2 * self.folds}"
            )
        parts = blocks(len(z.z), self.folds, samples.file)
        return LeftOut(tuple(Block.of(z.x, rows) for rows in parts), None)

    def bootstrap_errors(
        self, problem: Problem, z: Columns, theta: Callable[[Array], Array],
        rng: np.random.Generator,
    ) -> Array | None:  # fmt: skip
        """Standard errors of the table of theta(outputs), (n_terms, K); None without a bootstrap.

        The residuals are resampled in blocks; the regressors stay the same.
        """
        if self.bootstrap is None or problem.compared:
            return None
        fitted = z.x @ theta(z.y)
        length = round(self.block_s / problem.training.period_s)
        errors = block_bootstrap(
            lambda rest: z.table(theta(fitted + rest)), z.y - fitted, length, self.bootstrap, rng
        )
        errors[np.setdiff1d(np.arange(z.n_terms), [*z.terms, z.constant])] = np.nan
        return errors


@dataclass(frozen=True)
class Plsr(PartialLeastSquares):
    """PLSR over all degrees of freedom together.

    `max_order` null is the number of terms. Each bootstrap replicate chooses its own order.
    """

    max_order: PositiveInt | None
    selection: Selection

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table of the chosen orders, with the MSE of every order."""
        lag, diagnostics = thruster_of(self, problem)
        samples = self.samples(problem.training, problem.nominal, lag)
        z = self.columns(samples)
        left_out = self.left_out(self.selection, problem, lag, samples, z)
        orders = min(self.max_order or z.n_x, z.n_x)

        def chosen(outputs: Array) -> tuple[Array, Array]:
            """The coefficients of the best order, and the errors of every order."""
            moments = left_out.moments(outputs)
            every = all_orders(np.asarray(sum(moments)), z.beta, orders)
            mse = left_out_mse(
                left_out.pairs(moments),
                lambda used, left: mean_squares(left, all_orders(used, z.beta, orders)),
            )
            best = enumerate(np.argmin(mse, axis=0))
            return np.stack([every[a, :, k] for k, a in best], axis=1), mse

        theta, mse = chosen(z.y)
        mse = mse * z.y_scale**2
        residual = Vessel("residual", problem.nominal.dofs, samples.terms, z.table(theta))
        errors = self.bootstrap_errors(problem, z, lambda y: chosen(y)[0], rng)
        diagnostics += order_diagnostics(mse, np.argmin(mse, axis=0), residual.dofs, self.selection)
        diagnostics += scaled_coefficients(z, theta, residual)
        result = Identified(problem.nominal + residual, residual, errors, diagnostics)
        return finished(self, problem, lag, samples, result)


def order_diagnostics(
    mse: Array, chosen: NDArray[np.int64], dofs: tuple[str, ...], selection: str
) -> tuple[Diagnostic, ...]:
    """MSE of every order (orders, K) on left-out data, and the chosen order of each output (K,)."""
    diagnostics = []
    for k, dof in enumerate(dofs):
        unit = SQUARE_UNIT[dof]
        diagnostics += [
            Diagnostic("order_mse", dof, float(value), unit, i=a + 1, label=selection)
            for a, value in enumerate(mse[:, k])
        ]
        diagnostics.append(Diagnostic("selected_order", dof, float(chosen[k] + 1), label=selection))
    return tuple(diagnostics)


def scaled_coefficients(z: Columns, theta: Array, residual: Vessel) -> tuple[Diagnostic, ...]:
    """Theta_pre, the coefficients between scaled regressors and scaled outputs. Jervan, (3.11).

    They have no unit, so their magnitudes say how much each term contributes to the output.
    `theta` (1 + J, K) are the coefficients on Z of the table `residual`; terms that were dropped
    are left out.
    """
    scaled = theta[1:] * z.beta[:, None]  # Z has unit variance, E has 1 / beta
    return tuple(
        Diagnostic("scaled_coefficient", dof, float(value), label=residual.terms[i].name)
        for i, row in zip(z.terms, scaled, strict=True)
        for dof, value in zip(residual.dofs, row, strict=True)
        if value
    )
