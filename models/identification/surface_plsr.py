"""Surface analysis: PLSR over model order and number of terms. Jervan (2020), 4.4 and 4.5.1.

For each degree of freedom and each order, the regression begins with all terms; then the term with
the smallest |Theta_pre| is dropped and the model is fitted again, down to max(2, order) terms. With
30 terms these are 464 models per output. Their MSE on left-out data is the surface

    minimum       the (order, terms) of the least MSE
    parsimonious  with the terms of the minimum, the smallest order within 10 % of the least MSE
    local_minima  the same also with the terms of each local minimum of lower order

The method can be repeated on the residual in stages, F2 = F1 + Theta Phi, eq. (3.26). A stage that
does not lower the MSE adds no terms.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from seatrial.models.compiled import kernel
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.plsr import (
    Block,
    Pair,
    PartialLeastSquares,
    Selection,
    all_orders,
    covariances,
    left_out_mse,
    mean_squares,
    output_moment,
    partial_least_squares,
    scaled_coefficients,
)
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import thruster_of
from seatrial.models.notation import SQUARE_UNIT
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel, coefficient_unit

PARSIMONY = 1.1  # largest MSE of the parsimonious order, relative to the least at the minimum
MSE_RESOLUTION = 1e-12  # rounding of an MSE from moments, relative to the output's mean square
MIN_COUNT = 2


@kernel
def surface(xx: Array, xy: Array, theta: Array) -> None:
    """Write Theta_pre of every (order, number of terms), from E'E (J, J) and E'f (J, 1).

    theta (J, J, J): order - 1, number of terms - 1, term; other entries are not changed.
    """
    n = xx.shape[0]
    for order in range(1, n + 1):
        kept = np.arange(n)
        for count in range(n, max(min(MIN_COUNT, n), order) - 1, -1):
            part, cross = np.empty((count, count)), np.empty((count, 1))
            for i in range(count):
                cross[i, 0] = xy[kept[i], 0]
                for j in range(count):
                    part[i, j] = xx[kept[i], kept[j]]
            found = np.zeros((order, count, 1))
            weights, loadings = np.zeros((count, order)), np.zeros((count, order))
            partial_least_squares(part, cross, weights, loadings, np.zeros((1, order)), found)
            least = 0
            for i in range(count):
                theta[order - 1, count - 1, kept[i]] = found[order - 1, i, 0]
                if abs(found[order - 1, i, 0]) < abs(found[order - 1, least, 0]):
                    least = i
            for i in range(least, count - 1):
                kept[i] = kept[i + 1]


def whole_surface(moment: Array, beta: Array) -> Array:
    """Coefficients on Z of one output, (order, number of terms, 1 + J, 1); zero where dropped."""
    c, pre = covariances(moment, beta), np.zeros((len(beta),) * 3)
    surface(np.ascontiguousarray(c.xx), np.ascontiguousarray(c.xy), pre)
    theta = pre * c.x_gain * c.y_scale
    constant = c.y_mean - theta @ c.x_mean
    return np.concatenate([constant[..., None], theta], axis=2)[..., None]


def exists(n: int) -> NDArray[np.bool_]:
    """Mask of the models (order, number of terms), shape (n, n): terms >= max(2, order)."""
    order, count = np.arange(1, n + 1)[:, None], np.arange(1, n + 1)
    return np.asarray(count >= np.maximum(order, min(MIN_COUNT, n)))


class Choice(NamedTuple):
    """The model chosen for one output."""

    order: int
    kept: NDArray[np.int64]  # indices of the terms among the J
    surface_mse: Array  # (J, J), NaN where no model exists
    order_mse: Array  # of the orders on the kept terms


Rule = Literal["minimum", "parsimonious", "local_minima"]


def choose(pairs: list[Pair], moment: Array, beta: Array, selection: Rule) -> Choice:
    """Choose order and terms of one output by the MSE on the left-out data of the pairs.

    If no model is better than the empty one, order 0 and no terms are chosen.
    """
    n = len(beta)
    mse = left_out_mse(
        pairs, lambda used, left: mean_squares(left, whole_surface(used, beta))[..., 0]
    )
    mse[~exists(n)] = np.nan
    empty_mse = left_out_mse(pairs, lambda _, left: mean_squares(left, np.zeros((1 + n, 1))))[0]
    if empty_mse <= np.nanmin(mse):
        return Choice(0, np.zeros(0, dtype=np.int64), mse, np.zeros(0))
    best, count = least(mse, MSE_RESOLUTION * empty_mse)
    places = [(best, count)]
    if selection == "local_minima":
        places += [place for place in local_minima(mse) if place[0] < best]
    models = whole_surface(moment, beta)
    terms = [np.flatnonzero(models[*place, 1:, 0]) for place in places]
    errors = [orders_mse(pairs, beta, kept) for kept in terms]
    chosen = 0
    if selection != "minimum":
        limit = PARSIMONY * np.min(errors[0])
        best, _, chosen = min(
            (int(order), float(each[order]), number)
            for number, each in enumerate(errors)
            for order in np.flatnonzero(each <= limit)[:1]
        )
    return Choice(best + 1, terms[chosen], mse, errors[chosen])


def orders_mse(pairs: list[Pair], beta: Array, kept: NDArray[np.int64]) -> Array:
    """MSE of one output on the left-out data, of every order with a subset of the terms."""
    return left_out_mse(
        [(restrict(used, kept), restrict(left, kept)) for used, left in pairs],
        lambda used, left: mean_squares(left, all_orders(used, beta[kept], len(kept)))[..., 0],
    )


def local_minima(mse: Array) -> list[tuple[int, int]]:
    """Indices (order - 1, terms - 1) of the models that are better than all their neighbours."""
    padded = np.pad(np.where(np.isnan(mse), np.inf, mse), 1, constant_values=np.inf)
    around = sliding_window_view(padded, (3, 3)).reshape(*mse.shape, 9)
    lowest = np.all(mse[..., None] < np.delete(around, 4, axis=2), axis=2)
    return [(order, count) for order, count in np.argwhere(lowest).tolist()]


def least(mse: Array, resolution: float) -> tuple[int, int]:
    """Indices (order - 1, terms - 1) of the least MSE.

    Of those below `resolution`, which is rounding, the most terms, then the highest order.
    """
    exact = np.argwhere(mse <= resolution)
    if not len(exact):
        exact = np.argwhere(mse == np.nanmin(mse))[:1]
    best, count = max(exact.tolist(), key=lambda at: (at[1], at[0]))
    return best, count


def restrict(moment: Array, kept: NDArray[np.int64]) -> Array:
    """Moments of one output with a subset of the terms."""
    rows = np.concatenate([[0], 1 + kept, [len(moment) - 1]])
    return np.asarray(moment[np.ix_(rows, rows)])


def after(moment: Array, theta: Array) -> Array:
    """Moments of Z with the outputs replaced by the residuals of theta (1 + J, K)."""
    change = np.eye(len(moment))
    change[: len(theta), len(theta) :] = -theta
    return np.asarray(change.T @ moment @ change)


def fit_stages(moment: Array, beta: Array, stages: list[list[Choice]]) -> list[Array]:
    """Coefficients on Z (1 + J, K) of each stage, fitted to the residual of the last stage."""
    coefficients = []
    for choices in stages:
        theta = np.zeros((1 + len(beta), len(choices)))
        for k, (order, kept, *_) in enumerate(choices):
            if order > 0:
                part = restrict(output_moment(moment, len(beta), k), kept)
                fitted = all_orders(part, beta[kept], order)[-1, :, 0]
                theta[np.concatenate([[0], 1 + kept]), k] = fitted
        coefficients.append(theta)
        moment = after(moment, theta)
    return coefficients


@dataclass(frozen=True)
class SurfacePlsr(PartialLeastSquares):
    """PLSR of each degree of freedom alone, with order and terms from its surface.

    All bootstrap replicates have the same order and terms.
    """

    selection: Rule
    validation: Selection
    stages: Annotated[int, Ge(1), Le(10)]

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table of all stages; the surfaces are diagnostics."""
        lag, diagnostics = thruster_of(self, problem)
        samples = self.samples(problem.training, problem.nominal, lag)
        z, dofs = self.columns(samples), problem.nominal.dofs
        left_out = self.left_out(self.validation, problem, lag, samples, z)
        all_samples, stages = Block.of(z.x, slice(None)), list[list[Choice]]()
        moment, pairs = all_samples.moment(z.y), left_out.pairs(left_out.moments(z.y))
        rest = moment
        for stage in range(self.stages):
            choices = []
            for k in range(len(dofs)):
                own = [(output_moment(u, z.n_x, k), output_moment(o, z.n_x, k)) for u, o in pairs]
                choices.append(choose(own, output_moment(rest, z.n_x, k), z.beta, self.selection))
            stages.append(choices)
            diagnostics += surface_diagnostics(choices, z.y_scale**2, dofs, stage, self.validation)
            (fitted,) = fit_stages(rest, z.beta, [choices])
            rest = after(rest, fitted)
            for i, (used, out) in enumerate(pairs):  # each fitted without what is left out
                (fitted,) = fit_stages(used, z.beta, [choices])
                pairs[i] = (after(used, fitted), after(out, fitted))

        def theta(outputs: Array) -> Array:
            return np.asarray(
                np.sum(fit_stages(all_samples.moment(outputs), z.beta, stages), axis=0)
            )

        sums = np.cumsum(fit_stages(moment, z.beta, stages), axis=0)
        tables = [Vessel("residual", dofs, samples.terms, z.table(part)) for part in sums]
        parts = [tables[0], *(b - a for a, b in pairwise(tables))]
        diagnostics += tuple(
            Diagnostic("stage_coefficient", dof, float(value), coefficient_unit(term, dof), stage,
                       label=term.name)
            for stage, table in enumerate(parts if len(parts) > 1 else [], start=1)
            for term, row in zip(table.terms, table.theta, strict=True)
            for dof, value in zip(dofs, row, strict=True)
            if value
        )  # fmt: skip
        diagnostics += scaled_coefficients(z, sums[-1], tables[-1])
        errors = self.bootstrap_errors(problem, z, theta, rng)
        model = problem.nominal + tables[-1]
        result = Identified(model, tables[-1], errors, diagnostics, tuple(parts))
        return finished(self, problem, lag, samples, result)


def surface_diagnostics(
    choices: list[Choice], square: Array, dofs: tuple[str, ...], stage: int, label: str
) -> tuple[Diagnostic, ...]:
    """The surface of each degree of freedom, the MSE of the orders, and the choice."""
    suffix = f"_stage{stage + 1}" if stage else ""
    diagnostics = []
    for k, (dof, choice) in enumerate(zip(dofs, choices, strict=True)):
        unit = SQUARE_UNIT[dof]
        places = np.argwhere(~np.isnan(choice.surface_mse)).tolist()
        for a, j in places:
            value, at = float(choice.surface_mse[a, j] * square[k]), (a + 1, j + 1)
            diagnostics.append(Diagnostic(f"surface_mse{suffix}", dof, value, unit, *at, label))
        models, order, count = float(len(places)), float(choice.order), float(len(choice.kept))
        errors = enumerate((choice.order_mse * square[k]).tolist(), start=1)
        diagnostics += [
            Diagnostic(f"surface_models{suffix}", dof, models, label=label),
            *(Diagnostic(f"order_mse{suffix}", dof, e, unit, i, label=label) for i, e in errors),
            Diagnostic(f"selected_order{suffix}", dof, order, label=label),
            Diagnostic(f"selected_variables{suffix}", dof, count, label=label),
        ]
    return tuple(diagnostics)
