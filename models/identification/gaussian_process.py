"""A Gaussian process of the residual force over the velocities, compiled into a table.

    epsilon_k = phi' b_k + g_k(nu) + noise        b_k ~ N(0, S^2),  g_k ~ GP(0, kernel(nu, nu'))

epsilon_k is the lack of fit of one degree of freedom, phi are the terms that the nominal model has
there, and S is the size of its coefficients. Both priors have the nominal model as their mean: away
from the recording, and where it says nothing, the model stays what it is believed to be.

1. The scale, the length of every velocity and the noise of the kernel maximise the marginal
   likelihood of what phi leaves unexplained on a subsample: Rasmussen and Williams (2006),
   Gaussian processes for machine learning, eq. (5.8).
2. The posterior mean takes all samples (`kernel_posterior`). A degree of freedom whose posterior
   mean does not explain the lack of fit on blocks left out keeps the nominal model.
3. It is projected on the terms of the table in the velocities, at the recorded ones and, with less
   weight, around them. So the equation of motion stays the compiled one. R^2 says how much of the
   posterior mean the terms follow.
4. Every block is predicted by free runs over segments: by the nominal model, by phi' b alone and
   by the whole table, both identified without that block. The best of the three is the result; a
   degree of freedom that it predicts worse than the nominal model keeps its nominal equation.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations_with_replacement
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.errors import IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.blocked_free_run import Blocks
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.guard import guarded_by
from seatrial.models.identification.kernel_posterior import (
    Base,
    Prior,
    ProcessData,
    Projection,
    of_velocities,
)
from seatrial.models.identification.problem import Identified, Needs, Problem
from seatrial.models.identification.residual import (
    ResidualOptions,
    Samples,
    smoothed,
    thruster_of,
)
from seatrial.models.notation import FORCE_UNIT, VELOCITY_UNIT
from seatrial.models.ranges import Folds
from seatrial.models.recording.recording import blocks as blocks_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

LENGTHS = (0.5, 100.0)  # bounds of a length, in largest recorded velocities
SCALES = (1e-3, 1e3)  # bounds of the process' variance over that of the lack of fit
NOISES = (1e-8, 10.0)  # bounds of the noise's variance over that of the lack of fit
POOR = 0.9  # R^2 of a projection below which it is warned about


def cubic_terms(velocities: tuple[str, ...]) -> tuple[Term, ...]:
    """All products of three velocities: u^3, u^2v, uvr."""
    products = combinations_with_replacement(velocities, 3)
    return basis.terms("".join(letters) for letters in products)


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
        more = cubic_terms(nominal.velocities) if self.cubic else ()
        return terms + tuple(term for term in more if term not in terms)

    def needs(self) -> Needs:
        """The data of the residual, and the samples of the subsample."""
        return super().needs()._replace(samples=max(self.subsample, 2 * self.folds))

    def judged(self, problem: Problem, result: Identified) -> Identified:
        """The result, which the choice among the processes has judged already."""
        return result

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table, with the kernels and the R^2 of the projections."""
        lag, findings = thruster_of(self, problem)
        data = self._data(problem, lag, rng)
        tables, about = self._tables(data, problem.nominal)
        blocks = Blocks(replace(problem, thruster=lag), self.folds, self.segment_s, self.force)
        models = {name: self._left_out(blocks, table[1:]) for name, table in tables.items()}
        errors = {name: _error(blocks, own) for name, own in models.items()}
        for chosen in sorted(errors, key=lambda name: errors[name]):  # the simplest of equal ones
            try:
                result = self._compiled(problem, lag, data.samples, tables[chosen][0])
            except IdentificationError as error:
                findings += (Finding("rejected", "all", None, label=f"{chosen}: {error}"),)
            else:
                break
        if (own := models[chosen]) is not None:
            result = guarded_by(own, blocks, result)
        findings += (
            *about,
            *(
                Finding("left_out_error", "all", e if np.isfinite(e) else None, label=name)
                for name, e in errors.items()
            ),
            *(Finding("chosen", "all", float(name == chosen), label=name) for name in errors),
        )
        poor = projection_warnings(about) if chosen == "process" else ()
        warned = (*result.warnings, *poor)
        return replace(result, findings=(*findings, *result.findings), warnings=warned)

    def _left_out(self, blocks: Blocks, tables: Array) -> list[Vessel] | None:
        """The models without each block, of tables (folds, n_terms, n_dof); None: none hold."""
        quick, lag = replace(self, refinement="none"), blocks.problem.thruster
        try:
            return [
                quick._compiled(
                    problem, lag, quick.samples(problem.training, problem.nominal, lag), theta
                ).model
                for problem, theta in zip(blocks.problems, tables, strict=True)
            ]
        except IdentificationError:  # the physical constraints cannot be met
            return None

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
        nu = smooth(filtered.nu)
        count = min(self.subsample, len(samples))
        drawn = (np.arange(count) + rng.random(count)) * len(samples) / count
        rows = drawn.astype(np.int64)
        reach = np.max(np.abs(nu), axis=0)
        reach[reach == 0.0] = 1.0
        return ProcessData(samples, filtered.nu, smooth, rows, nu[rows], reach)

    def _tables(
        self, data: ProcessData, nominal: Vessel
    ) -> tuple[dict[str, Array], tuple[Finding, ...]]:
        """Residual tables of all samples and without each block, (1 + folds, n_terms, n_dof)."""
        findings: tuple[Finding, ...] = ()
        terms, dofs = data.samples.terms, nominal.dofs
        parts = blocks_of(len(data.samples), self.folds, data.samples.file)
        none = np.zeros((1 + len(parts), len(terms), len(dofs)))
        alone, process = none.copy(), none.copy()
        projection = Projection.of(Vessel("terms", dofs, terms, none[0]), data)
        for k, dof in enumerate(dofs):
            base = self._base(data.samples, nominal, k)
            prior = self._prior(data, base, k)
            posterior = data.posterior(prior, base, k, self.folds)
            findings += prior_findings(prior, nominal, k)
            findings += (Finding("left_out_r2", dof, posterior.left_out_r2),)
            if posterior.left_out_r2 > 0.0:
                alone[:, base.rows, k] = posterior.alone.T
                process[:, base.rows, k] = posterior.base.T
                own = process[0, projection.rows, k]
                change, r2 = projection.coefficients(prior, posterior, own)
                process[:, projection.rows, k] += change.T
                findings += (Finding("projection_r2", dof, r2),)
        return {"none": none, "base": alone, "process": process}, findings

    def _base(self, samples: Samples, nominal: Vessel, k: int) -> Base:
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
        return Base(rows, np.array(sizes))

    def _prior(self, data: ProcessData, base: Base, k: int) -> Prior:
        """The kernel of the largest marginal likelihood of what the base leaves unexplained."""
        from sklearn.gaussian_process import GaussianProcessRegressor, kernels  # slow to import

        rest = data.unexplained(base, k)[data.subsample]
        size = float(np.sqrt(np.mean(rest**2))) or 1.0
        lengths = np.ones(len(data.reach))
        shape = (
            kernels.RBF(lengths, LENGTHS)
            if self.kernel == "rbf"
            else kernels.Matern(lengths, LENGTHS, nu=2.5)
        )
        full = kernels.ConstantKernel(1.0, SCALES) * shape + kernels.WhiteKernel(0.1, NOISES)
        regressor = GaussianProcessRegressor(full)
        with warnings.catch_warnings():  # a length at its bound says that a velocity is not needed
            warnings.simplefilter("ignore")
            regressor.fit(data.inducing / data.reach, rest / size)
        fitted = regressor.kernel_
        return Prior(fitted.k1, data.reach, size, float(fitted.k2.noise_level))


def prior_findings(prior: Prior, nominal: Vessel, k: int) -> tuple[Finding, ...]:
    """Standard deviations of process and noise, and the length of every velocity."""
    dof = nominal.dofs[k]
    scale = prior.size * float(np.sqrt(prior.kernel.k1.constant_value))
    noise = prior.size * float(np.sqrt(prior.noise))
    lengths = prior.reach * prior.kernel.k2.length_scale
    return (
        Finding("process_deviation", dof, scale, FORCE_UNIT[dof]),
        Finding("noise_deviation", dof, noise, FORCE_UNIT[dof]),
        *(
            Finding("process_length", dof, float(length), VELOCITY_UNIT[own], label=letter)
            for own, letter, length in zip(nominal.dofs, nominal.velocities, lengths, strict=True)
        ),
    )


def _error(blocks: Blocks, models: list[Vessel] | None) -> float:
    """NRMSE of models on the blocks, mean of the axes; infinite where they cannot be simulated."""
    if not blocks.axes:
        return 0.0
    try:
        return float("inf") if models is None else float(np.sqrt(blocks.errors(models).error))
    except IdentificationError:
        return float("inf")


def projection_warnings(findings: Sequence[Finding]) -> tuple[str, ...]:
    """A warning for every degree of freedom with a poor projection."""
    return tuple(
        f"{found.dof}: the terms follow the Gaussian process with "
        f"R^2 = {found.value:.2f}, expected at least {POOR:g}: add terms to identifier.extra_terms"
        for found in findings
        if found.name == "projection_r2" and (found.value or 0.0) < POOR
    )
