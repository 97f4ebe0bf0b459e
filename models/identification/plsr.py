"""Partial least squares regression of the lack of fit. Jervan (2020), sections 3.3 and 4.5.

The equations stand in `components`. The order is chosen for each degree of freedom by the least
mean squared error on data that were left out: inside the training part (`selection`), or, as the
thesis does, on the held-out part itself (`selection: test`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.basis import Array, Term
from models.errors import ConfigurationError
from models.identification.components import (
    Columns,
    all_orders,
    columns,
    mean_squares,
    output_moment,
)
from models.identification.design import CONSTANT, ResidualOptions, Samples
from models.identification.problem import Finding, Identified, Problem
from models.identification.selection import (
    Selection,
    check_folds,
    left_out_mse,
    moment_pairs,
)
from models.identification.uncertainty import block_bootstrap, block_moments, check_bootstrap
from models.vessel import FORCE_UNIT, Vessel


@dataclass(frozen=True)
class Plsr(ResidualOptions):
    """PLSR over all degrees of freedom together (`joint`) or each alone.

    The constant is always in the basis. `max_order` null: as many as there are terms.
    `bootstrap` is the number of block-bootstrap replicates for standard errors, null for none.
    """

    joint: bool
    max_order: int | None
    selection: Selection
    folds: int
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_folds(self.folds)
        check_bootstrap(self.bootstrap, self.block_s)
        if self.max_order is not None and self.max_order < 1:
            raise ConfigurationError(f"max_order must be at least 1 or null, got {self.max_order}")

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel, with the constant."""
        chosen = super().terms(nominal)
        return chosen if CONSTANT in chosen else (CONSTANT, *chosen)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the chosen orders, with the MSE of every order."""
        samples = self.samples(problem.training, problem.nominal, problem.thruster)
        z = columns(samples)
        pairs = moment_pairs(self.selection, z.z, self.held_out(problem, z), self.folds, rng)
        mse = left_out_mse(pairs, lambda kept, left: mean_squares(left, self.fit(kept, z)))
        chosen = np.argmin(mse, axis=0)

        def table(moment: Array) -> Array:
            theta = self.fit(moment, z)
            picked = np.stack([theta[a, :, k] for k, a in enumerate(chosen)], axis=1)
            return z.table(picked)

        residual = Vessel("residual", problem.nominal.dofs, samples.terms, table(z.z.T @ z.z))
        return Identified(
            problem.nominal + residual,
            residual,
            bootstrap_errors(self.bootstrap, self.block_s, samples, z.z, table, rng),
            order_findings(mse * z.y_scale**2, chosen, residual.dofs, self.selection),
        )

    def fit(self, moment: Array, z: Columns) -> Array:
        """Coefficients on Z of every order, shape (orders, 1 + J, K)."""
        orders = min(self.max_order or z.n_x, z.n_x)
        if self.joint:
            return all_orders(moment, z.beta, orders)
        outputs = range(len(moment) - 1 - z.n_x)
        alone = [all_orders(output_moment(moment, z.n_x, k), z.beta, orders) for k in outputs]
        return np.concatenate(alone, axis=2)

    def held_out(self, problem: Problem, z: Columns) -> Array | None:
        """Z of the validation part, only for the selection that is allowed to see it."""
        if self.selection != "test":
            return None
        return z.like(self.samples(problem.validation, problem.nominal, problem.thruster))


def bootstrap_errors(
    replicates: int | None,
    block_s: float,
    samples: Samples,
    z: Array,
    table: Callable[[Array], Array],
    rng: np.random.Generator,
) -> Array | None:
    """Block-bootstrap standard errors of a table computed from moments of Z; None for none."""
    if replicates is None:
        return None
    moments = block_moments(z, max(round(block_s / samples.period_s), 1))
    return block_bootstrap(moments, table, replicates, rng)


def order_findings(
    mse: Array, chosen: NDArray[np.int64], dofs: tuple[str, ...], selection: str
) -> tuple[Finding, ...]:
    """Left-out MSE of every order, and the chosen order, labelled by how it was chosen."""
    found = []
    for k, dof in enumerate(dofs):
        unit = f"{FORCE_UNIT[dof]}^2"
        found += [
            Finding("order_mse", dof, float(value), unit, i=a + 1, label=selection)
            for a, value in enumerate(mse[:, k])
        ]
        found.append(Finding("selected_order", dof, float(chosen[k] + 1), label=selection))
    return tuple(found)
