"""A Gaussian process of the residual force over the velocities, compiled into a table.

    epsilon_k = phi' b_k + g_k(nu) + noise        b_k ~ N(0, S^2),  g_k ~ GP(0, kernel(nu, nu'))

epsilon_k is the lack of fit of one degree of freedom, phi are the terms that the nominal model has
there, and S is the size of its coefficients. Both priors have the nominal model as their mean: away
from the recording, and where it says nothing, the model stays as the nominal one.

1. The scale, the length of every velocity and the noise of the kernel maximise the marginal
   likelihood of what phi leaves unexplained on a subsample: Rasmussen and Williams (2006),
   Gaussian processes for machine learning, eq. (5.8).
2. The posterior mean takes all samples. A degree of freedom whose posterior
   mean does not explain the lack of fit on blocks left out keeps the nominal model.
3. It is projected on the terms of the table in the velocities, at the recorded ones and, with less
   weight, around them. So the equation of motion stays the compiled one. R^2 says how much of the
   posterior mean the terms follow.
4. Every block is predicted by free runs over segments: by the nominal model, by phi' b alone and
   by the whole table, both identified without that block. The best of the three is the result; a
   degree of freedom that it predicts worse than the nominal model keeps its nominal equation.

The process is g(nu) = kernel(nu, z) w, w ~ N(0, kernel(z, z)^-1) with inducing points z, so that
the posterior mean of b and w is a ridge regression on all samples: Quinonero-Candela and Rasmussen
(2005), J. Mach. Learn. Res. 6, eq. (16). Away from the inducing points it returns to zero. The
noise counts for tau samples as for one, see `structured`.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations_with_replacement
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import scipy
from annotated_types import Ge, Le
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.cross_validation import CrossValidation
from seatrial.models.identification.fallback import guarded_by
from seatrial.models.identification.physical_constraints import VELOCITY_SCALES, sampled_velocities
from seatrial.models.identification.problem import Identified, Needs, Problem
from seatrial.models.identification.residual import ResidualOptions, Samples, smoothed, thruster_of
from seatrial.models.identification.structured import inflation
from seatrial.models.notation import FORCE_UNIT, VELOCITIES, VELOCITY_UNIT
from seatrial.models.ranges import Folds
from seatrial.models.recording.recording import blocks as blocks_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

ALL = (slice(None),)
MAX_SAMPLES = 20_000  # samples in the posterior mean; of a longer recording every so many-th
MIN_NOISE = 1e-13  # least noise, relative to the mean square of the features
NOISE_ROUNDS = 10  # of the noise that the base leaves
CHUNK = 50  # columns filtered together
JITTER = 1e-11  # of the kernel's diagonal, relative


class Prior(NamedTuple):
    """The prior of one degree of freedom: a kernel of scaled velocities, and the noise."""

    kernel: Any  # scikit-learn's, of velocities over their reach
    reach: Array  # (n_dof,) largest recorded velocities
    size: float  # [N, Nm] by which the lack of fit is divided
    noise: float  # variance over size^2

    def covariance(self, nu: Array, other: Array) -> Array:
        """Covariance [N^2] of the process between velocities (n, n_dof) and others (m, n_dof)."""
        return np.asarray(self.size**2 * self.kernel(nu / self.reach, other / self.reach))


class ParametricTerms(NamedTuple):
    """The terms of one degree of freedom that are estimated beside the process."""

    rows: list[int]  # of the table
    size: Array  # prior standard deviation of their coefficients


class Posterior(NamedTuple):
    """The posterior mean of one degree of freedom: of all samples, and without each block."""

    alone: Array  # (n_base, 1 + folds) coefficients of the terms of the base without the process
    base: Array  # (n_base, 1 + folds) those beside the process
    weights: Array  # (m, 1 + folds) of the covariance with the inducing points
    noise: float  # [N^2] variance that counts for one sample
    left_out_r2: float  # 1 - square of the lack of fit over that of the nominal model


@dataclass(frozen=True, eq=False)
class ProcessData:
    """The samples of a recording, with the velocities as the kernels and the table see them."""

    samples: Samples
    nu: Array  # (N', n_dof) recorded velocities after the filter of the signals
    smooth: Callable[[Array], Array]  # the filter of the regressors, (N', c) to (N, c)
    subsample: NDArray[np.int64]  # (m,) of the samples
    inducing: Array  # (m, n_dof) velocities of the subsample
    reach: Array  # (n_dof,) largest recorded velocities, 1 where there is no motion

    def unexplained(self, base: ParametricTerms, k: int) -> Array:
        """What the base alone leaves of the lack of fit of a degree of freedom, (N,)."""
        y, features = self.samples.epsilon[:, k], self.samples.phi[:, base.rows] * base.size
        return np.asarray(y - features @ without_process(features, y, ALL)[:, 0])

    def posterior(self, prior: Prior, base: ParametricTerms, k: int, folds: int) -> Posterior:
        """The posterior mean of a degree of freedom from all samples, at most `MAX_SAMPLES`.

        The features have a prior variance of one each: the base's terms times their size, and the
        covariance with the inducing points after a Cholesky factor of their own.
        """
        step = -(-len(self.samples) // MAX_SAMPLES)
        file = self.samples.file
        file = None if file is None else file[::step]
        parts = blocks_of(len(self.samples.phi[::step]), folds, file)
        y = self.samples.epsilon[::step, k]
        K = prior.covariance(self.inducing, self.inducing)
        L = np.linalg.cholesky(K + JITTER * np.mean(np.diag(K)) * np.eye(len(K)))
        chunks = np.array_split(self.inducing, max(len(self.inducing) // CHUNK, 1))
        columns = [self.smooth(prior.covariance(self.nu, part))[::step] for part in chunks]
        process = scipy.linalg.solve_triangular(L, np.hstack(columns).T, lower=True).T
        features = np.hstack([self.samples.phi[::step, base.rows] * base.size, process])
        noise, n = prior.noise * prior.size**2, len(base.rows)
        noise *= inflation((y - features @ regress(features, y, noise, ALL)[:, 0])[:, None])
        weights = regress(features, y, noise, parts)
        rests = [y[part] - features[part] @ w for part, w in zip(parts, weights.T[1:], strict=True)]
        left_out, power = float(np.sum(np.concatenate(rests) ** 2)), float(np.sum(y**2))
        alone = without_process(features[:, :n], y, parts)
        return Posterior(
            base.size[:, None] * alone,
            base.size[:, None] * weights[:n],
            scipy.linalg.solve_triangular(L, weights[n:], lower=True, trans="T"),
            noise,
            1.0 - left_out / power if power > 0.0 else 0.0,
        )


def regress(features: Array, y: Array, noise: float, parts: Sequence[slice]) -> Array:
    """Weights of features (N, p) with a prior variance of one: of all samples and without a block.

    `noise` is the variance of y (N,). The result has shape (p, 1 + n_parts); one part: (p, 1).
    """
    grams = np.array([features[part].T @ features[part] for part in parts])
    sides = np.array([features[part].T @ y[part] for part in parts])
    G, g = np.sum(grams, axis=0), np.sum(sides, axis=0)
    prior = max(noise, MIN_NOISE * float(np.trace(G))) * np.eye(len(g))
    kept = [(G - A, g - b) for A, b in zip(grams, sides, strict=True)] if len(parts) > 1 else []
    solved = [scipy.linalg.solve(A + prior, b, assume_a="pos") for A, b in [(G, g), *kept]]
    return np.stack(solved, axis=1)


def without_process(features: Array, y: Array, parts: Sequence[slice]) -> Array:
    """Weights as of `regress`, with the noise that they leave unexplained."""
    rest = y
    for _ in range(NOISE_ROUNDS):
        noise = float(np.mean(rest**2)) * inflation(rest[:, None])
        rest = y - features @ regress(features, y, noise, ALL)[:, 0]
    return regress(features, y, noise, parts)


AROUND_WEIGHT = 0.1  # weight of the velocities around the recorded ones
SHRINKAGE = 1e-8  # ridge per sample, on standardised terms
MAX_VELOCITIES = 2000  # recorded velocities


def of_velocities(term: Term) -> bool:
    """Whether a term is a function of the velocities of the hull alone, or the constant."""
    names = (basis.VARIABLES[code % basis.N_VARIABLES] for code in term.codes)
    return all(name in ("1", *VELOCITIES) for name in names)


@dataclass(frozen=True, eq=False)
class Projection:
    """Least squares of a posterior mean on the terms in the velocities."""

    rows: list[int]  # of the table
    nu: Array  # (n, n_dof) velocities, the recorded ones first
    n_recorded: int
    inducing: Array  # (m, n_dof)
    phi: Array  # (n, n_terms) weighted and standardised
    scale: Array  # (n_terms,) of the columns
    weight: Array  # (n, 1) root of the weight of a velocity

    @classmethod
    def of(cls, table: Vessel, data: ProcessData) -> "Projection":
        """The projection on a table's terms."""
        rows = [i for i, term in enumerate(table.terms) if of_velocities(term)]
        recorded = data.nu[:: -(-len(data.nu) // MAX_VELOCITIES)]
        around = sampled_velocities(data.nu, None, VELOCITY_SCALES[:-1])  # not far beyond them
        nu = np.vstack([recorded, around])
        shares = [1.0 / len(recorded), AROUND_WEIGHT / len(around)]
        weight = np.sqrt(np.repeat(shares, [len(recorded), len(around)]))[:, None]
        motion = table.variables(np.zeros_like(nu), nu)
        phi = weight * basis.evaluate([table.terms[i] for i in rows], motion)
        scale = np.linalg.norm(phi, axis=0)
        scale[scale == 0.0] = 1.0
        return cls(rows, nu, len(recorded), data.inducing, phi / scale, scale, weight)

    def coefficients(self, prior: Prior, posterior: Posterior, base: Array) -> tuple[Array, float]:
        """Coefficients (n_terms, 1 + folds) of the mean, and R^2 = 1 - |rest|^2 / |f|^2.

        f is the mean and the force of the terms' coefficients in the base (n_terms,), as recorded.
        """
        mean = self.weight * (prior.covariance(self.nu, self.inducing) @ posterior.weights)
        gram = self.phi.T @ self.phi + SHRINKAGE * np.eye(len(self.scale))
        theta = scipy.linalg.solve(gram, self.phi.T @ mean, assume_a="pos")
        recorded = slice(self.n_recorded)
        rest = (mean - self.phi @ theta)[recorded, 0]
        power = float(np.sum((mean[:, 0] + self.phi @ (self.scale * base))[recorded] ** 2))
        r2 = 1.0 - float(np.sum(rest**2)) / power if power > 0.0 else 1.0
        return theta / self.scale[:, None], r2


LENGTH_BOUNDS = (0.5, 100.0)  # bounds of a length, in largest recorded velocities
VARIANCE_BOUNDS = (1e-3, 1e3)  # bounds of the process' variance over that of the lack of fit
NOISES = (1e-8, 10.0)  # bounds of the noise's variance over that of the lack of fit
POOR = 0.9  # R^2 of a projection below which it is warned about


@dataclass(frozen=True)
class GaussianProcess(ResidualOptions):
    """The residual force as a Gaussian process, projected on the terms of the table.

    `kernel`: rbf (infinitely smooth) or matern (nu = 5/2). `base`: all terms that the nominal model
    has in a degree of freedom are estimated beside the process (physical), its inertia alone, or
    none. `cubic` adds all products of three velocities to the basis. `subsample` is the number of
    samples for the marginal likelihood, `folds` that of the blocks.
    """

    kernel: Literal["rbf", "matern"]
    base: Literal["physical", "inertia", "none"]
    cubic: bool
    subsample: Annotated[int, Ge(20), Le(10_000)]
    folds: Folds

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel, with the products of three velocities."""
        terms = super().terms(nominal)
        if not self.cubic:
            return terms
        products = combinations_with_replacement(nominal.velocities, 3)  # u^3, u^2v, uvr
        more = basis.terms("".join(letters) for letters in products)
        return terms + tuple(term for term in more if term not in terms)

    def needs(self) -> Needs:
        """The data of the residual, and the samples of the subsample."""
        return super().needs()._replace(samples=max(self.subsample, 2 * self.folds))

    @property
    def protected(self) -> bool:
        """The choice among the processes judges the axes on blocks left out."""
        return False

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table, with the kernels and the R^2 of the projections."""
        lag, diagnostics = thruster_of(self, problem)
        data = self._data(problem, lag, rng)
        tables, about = self._tables(data, problem.nominal)
        lagged = replace(problem, thruster=lag)
        blocks = CrossValidation(lagged, self.folds, self.segment_s, self.force)
        judged = {name: self._judged(blocks, table[1:]) for name, table in tables.items()}
        errors = {name: error for name, (_, error) in judged.items()}
        for chosen in sorted(errors, key=lambda name: errors[name]):  # the simplest of equal ones
            try:
                result = self._compiled(problem, lag, data.samples, tables[chosen][0])
            except IdentificationError as error:
                diagnostics += (Diagnostic("rejected", "all", None, label=f"{chosen}: {error}"),)
            else:
                break
        if (own := judged[chosen][0]) is not None:
            result = guarded_by(own, blocks, result)
        diagnostics += (
            *about,
            *(
                Diagnostic("left_out_error", "all", e if np.isfinite(e) else None, label=name)
                for name, e in errors.items()
            ),
            *(Diagnostic("chosen", "all", float(name == chosen), label=name) for name in errors),
        )
        poor = projection_warnings(about) if chosen == "process" else ()
        warned = (*result.warnings, *poor)
        return replace(result, diagnostics=(*diagnostics, *result.diagnostics), warnings=warned)

    def _judged(
        self, blocks: CrossValidation, tables: Array
    ) -> tuple[list[Vessel] | None, float]:
        """Models without each block, of tables (folds, n_terms, n_dof), and their NRMSE on it.

        It is the mean of the axes, infinite where a model cannot be simulated, or (None) had.
        """
        quick, lag, models = replace(self, refinement="none"), blocks.problem.thruster, None
        try:
            models = [
                quick._compiled(
                    problem, lag, quick.samples(problem.training, problem.nominal, lag), theta
                ).model
                for problem, theta in zip(blocks.problems, tables, strict=True)
            ]
            return models, float(np.sqrt(blocks.errors(models).error)) if blocks.axes else 0.0
        except IdentificationError:  # such as physical constraints that cannot be met
            return models, float("inf")

    def _compiled(
        self, problem: Problem, lag: SecondOrderLag | None, samples: Samples, theta: Array
    ) -> Identified:
        """A residual table with the physical constraints and the refinement that are asked for."""
        residual = Vessel("residual", problem.nominal.dofs, samples.terms, theta)
        identified = Identified(problem.nominal + residual, residual)
        return finished(self, problem, lag, samples, identified) if np.any(theta) else identified

    def _data(
        self, problem: Problem, lag: SecondOrderLag | None, rng: np.random.Generator
    ) -> ProcessData:
        """The data of the training part, with a subsample drawn from equal parts of it."""
        training = problem.training
        smoothing = self.smoothing(training)
        samples = self.samples(training, problem.nominal, lag, smoothing)
        filtered = self.filtered(training, lag, smoothing)
        smooth = partial(smoothed, filtered, smoothing=smoothing)
        nu = smooth(filtered.nu.copy())
        count = min(self.subsample, len(samples))
        drawn = (np.arange(count) + rng.random(count)) * len(samples) / count
        rows = drawn.astype(np.int64)
        reach = np.max(np.abs(nu), axis=0)
        reach[reach == 0.0] = 1.0
        return ProcessData(samples, filtered.nu, smooth, rows, nu[rows], reach)

    def _tables(
        self, data: ProcessData, nominal: Vessel
    ) -> tuple[dict[str, Array], tuple[Diagnostic, ...]]:
        """Residual tables of all samples and without each block, (1 + folds, n_terms, n_dof)."""
        diagnostics: tuple[Diagnostic, ...] = ()
        terms, dofs = data.samples.terms, nominal.dofs
        parts = blocks_of(len(data.samples), self.folds, data.samples.file)
        none = np.zeros((1 + len(parts), len(terms), len(dofs)))
        alone, process = none.copy(), none.copy()
        projection = Projection.of(Vessel("terms", dofs, terms, none[0]), data)
        for k, dof in enumerate(dofs):
            base = self._base(data.samples, nominal, k)
            prior = self._prior(data, base, k)
            posterior = data.posterior(prior, base, k, self.folds)
            diagnostics += prior_diagnostics(prior, nominal, k)
            diagnostics += (Diagnostic("left_out_r2", dof, posterior.left_out_r2),)
            if posterior.left_out_r2 > 0.0:
                alone[:, base.rows, k] = posterior.alone.T
                process[:, base.rows, k] = posterior.base.T
                own = process[0, projection.rows, k]
                change, r2 = projection.coefficients(prior, posterior, own)
                process[:, projection.rows, k] += change.T
                diagnostics += (Diagnostic("projection_r2", dof, r2),)
        return {"none": none, "base": alone, "process": process}, diagnostics

    def _base(self, samples: Samples, nominal: Vessel, k: int) -> ParametricTerms:
        """The terms of a degree of freedom beside the process, with the size of each coefficient.

        Terms of the basis in attitude and wind that the nominal model does not have are among them.
        """
        rows, sizes = [], []
        force = float(np.std(samples.force[:, k]))
        for i, term in enumerate(samples.terms):
            size = abs(nominal.coefficient(nominal.dofs[k], term.name))
            inertial = term.name in nominal.accelerations
            if not inertial and not of_velocities(term) and size == 0.0:
                effect = float(np.sqrt(np.mean(samples.phi[:, i] ** 2)))
                size = force / effect if effect > 0.0 else 0.0
            if size > 0.0 and (self.base == "physical" or (inertial and self.base == "inertia")):
                rows.append(i)
                sizes.append(size)
        return ParametricTerms(rows, np.array(sizes))

    def _prior(self, data: ProcessData, base: ParametricTerms, k: int) -> Prior:
        """The kernel of the largest marginal likelihood of what the base leaves unexplained."""
        from sklearn.gaussian_process import GaussianProcessRegressor, kernels  # slow to import

        rest = data.unexplained(base, k)[data.subsample]
        size = float(np.sqrt(np.mean(rest**2))) or 1.0
        lengths = np.ones(len(data.reach))
        shape = (
            kernels.RBF(lengths, LENGTH_BOUNDS)
            if self.kernel == "rbf"
            else kernels.Matern(lengths, LENGTH_BOUNDS, nu=2.5)
        )
        full = kernels.ConstantKernel(1.0, VARIANCE_BOUNDS) * shape + kernels.WhiteKernel(
            0.1, NOISES
        )
        regressor = GaussianProcessRegressor(full)
        with warnings.catch_warnings():  # a length at its bound says that a velocity is not needed
            warnings.simplefilter("ignore")
            regressor.fit(data.inducing / data.reach, rest / size)
        fitted = regressor.kernel_
        return Prior(fitted.k1, data.reach, size, float(fitted.k2.noise_level))


def prior_diagnostics(prior: Prior, nominal: Vessel, k: int) -> tuple[Diagnostic, ...]:
    """Standard deviations of process and noise, and the length of every velocity."""
    dof = nominal.dofs[k]
    scale = prior.size * float(np.sqrt(prior.kernel.k1.constant_value))
    noise = prior.size * float(np.sqrt(prior.noise))
    lengths = prior.reach * prior.kernel.k2.length_scale
    return (
        Diagnostic("process_deviation", dof, scale, FORCE_UNIT[dof]),
        Diagnostic("noise_deviation", dof, noise, FORCE_UNIT[dof]),
        *(
            Diagnostic("process_length", dof, float(length), VELOCITY_UNIT[own], label=letter)
            for own, letter, length in zip(nominal.dofs, nominal.velocities, lengths, strict=True)
        ),
    )


def projection_warnings(diagnostics: Sequence[Diagnostic]) -> tuple[str, ...]:
    """A warning for every degree of freedom with a poor projection."""
    return tuple(
        f"{found.dof}: the terms follow the Gaussian process with "
        f"R^2 = {found.value:.2f}, expected at least {POOR:g}: add terms to identifier.extra_terms"
        for found in diagnostics
        if found.name == "projection_r2" and (found.value or 0.0) < POOR
    )
