"""Instrumental variables for second-order modulus models. Ljungberg (slides), after his thesis.

    theta = sol { (1/N) sum_k Z(k) (y(k) - Phi(k)' theta) = 0 }

Least squares is Z = Phi. If the regressors are measured, it is biased for any length of the
recording, since the noise of the regressors is squared. Instruments Z that are correlated with the
motion but not with its noise make the estimate consistent. Products such as (u + e)|u + e| still
have a mean of e^2, which is constant while u keeps its sign: hence the excitation has an offset and
the instruments have zero mean.

    predictor   orientation_terms   wind_measurement
    LS1, IV1    false               false     bursts of wind and current without a mean
    LS2, IV2    true                false     a mean, slower than the vessel
    LS3, IV3    true                true      a mean, at times faster than the vessel

with `instruments: none` (LS) or `simulated` (IV).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.free_parameters import ned_forces
from seatrial.models.identification.linear import (
    check_distinguished,
    condition_diagnostics,
    long_run_covariances,
    triangle,
    turns,
)
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import (
    CONSTANT,
    Refinement,
    ResidualOptions,
    Samples,
    evaluated,
    kept,
    smoothed,
    thruster_of,
)
from seatrial.models.identification.simulated_motion import simulated_motion
from seatrial.models.identification.spread import TableSpread, table_spread
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import MOST_REPEATS, Positive
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

SINGULAR_RATIO = 1e-10
WHAT = "instruments do not distinguish"
WEAK = 0.1  # strength below which the estimate is little else than noise, and so are its intervals
REFINED = (
    "the instruments are weak, so that the model of the regression was refined by free runs; "
    "try fewer terms or a longer recording"
)
NO_INTERVALS = (
    "the instruments are weak, and the model diverges when it is refined by free runs: the "
    "coefficients have no standard errors; try fewer terms or a longer recording"
)


@dataclass(frozen=True, eq=False)
class Solution:
    """An instrumental-variable fit of m targets y, in which theta is linear."""

    theta: Array  # (n_terms, m)
    rest: Array  # (N, m) residuals
    z: Array  # (N, n_instruments)
    inverse: Array  # (n_instruments, n_instruments) that makes the columns of z orthonormal
    share: Array  # (n_instruments, n_terms), theta = share' (z inverse)' y
    left: Array  # (n, n_terms) R of what the instruments leave of the regressors
    condition: float  # condition number of the scaled regressors projected on the instruments

    @cached_property
    def covariances(self) -> Array:
        """Covariances of theta for each target with stationary residuals, (m, n_terms, n_terms)."""
        own = long_run_covariances(lambda rows: self.z[rows] @ self.inverse, self.rest)
        return np.asarray(self.share.T @ own @ self.share)

    def standard_errors(self) -> Array:
        """Standard errors (n_terms, m) for autocorrelated residuals."""
        n, n_terms = len(self.rest), len(self.theta)
        variances = np.diagonal(self.covariances, axis1=1, axis2=2).T
        return np.sqrt(np.clip(n / max(n - n_terms, 1) * variances, 0.0, None))


def solve(z: Array, phi: Array, y: Array, names: Sequence[str] = ()) -> Solution:
    """Two-stage least squares; z (N, n_instruments), phi (N, n_terms), y (N, m).

    theta = argmin |P (y - Phi theta)|^2 with the projection P on the instruments. With as many
    instruments as terms it solves Z'(y - Phi theta) = 0, and with Z = Phi it is least squares.
    Raises IdentificationError, with the `names` of the terms, when the instruments do not
    determine theta.
    """
    n, m = y.shape
    (a, b), own = (z.shape[1], phi.shape[1]), z is phi
    if a < b:
        raise IdentificationError(f"got {a} instruments for {b} terms, expected at least as many")
    columns = (z, y) if own else (z, phi, y)
    R = triangle(np.hstack([each[turn] for each in columns]) for turn in turns(n))
    of_z, of_phi = R[:, :a], R[:, :a] if own else R[:, a : a + b]
    sizes = [np.linalg.norm(each, axis=0) / np.sqrt(n) for each in (of_z, of_phi)]
    size, scale = (np.where(each > 0.0, each, 1.0) for each in sizes)
    if a == b:
        check_distinguished(*np.linalg.svd(of_z[:a] / size)[1:], names, WHAT, SINGULAR_RATIO)
    u, s, vt = np.linalg.svd(of_phi[:a] / scale, full_matrices=False)
    check_distinguished(s, vt, names, WHAT, SINGULAR_RATIO)
    share = (u / s) @ vt / scale
    theta = share.T @ R[:a, -m:]
    inverse = np.asarray(np.linalg.inv(of_z[:a]), dtype=np.float64)
    condition = float(s[0] / s[-1])
    return Solution(theta, y - phi @ theta, z, inverse, share, of_phi[a:], condition)


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate without standard errors."""

    samples: Samples
    kept: tuple[int, ...]  # terms that are determined; the others keep their nominal values
    solution: Solution  # over `kept`
    diagnostics: tuple[Diagnostic, ...] = ()

    def table(self, values: Array, missing: float) -> Array:
        """Values (n_kept, n_dof) on all terms, `missing` elsewhere, shape (n_terms, n_dof)."""
        full = np.full((len(self.samples.terms), values.shape[1]), missing)
        full[list(self.kept)] = values
        return full

    @cached_property
    def strength(self) -> float:
        """How much of the regressors the instruments explain, over what they do not.

        The statistic of Cragg and Donald (1993): the least eigenvalue over all combinations of the
        terms, an F of the first stage. About 1 is that of instruments that have nothing to do with
        the motion, above 10 are strong ones (Stock and Yogo 2005).
        """
        n, n_instruments = self.solution.z.shape
        largest = float(np.linalg.norm(self.solution.left @ self.solution.share.T, 2)) ** 2
        return (n - n_instruments) / n_instruments / largest if largest > 0.0 else np.inf

    def spread(self) -> TableSpread:
        """The distribution of the coefficients."""
        covariances = [np.zeros((len(self.samples.terms),) * 2) for _ in self.solution.covariances]
        for full, own in zip(covariances, self.solution.covariances, strict=True):
            full[np.ix_(self.kept, self.kept)] = own
        return table_spread(covariances, self.solution.rest)

    def residual(self, dofs: tuple[str, ...]) -> Vessel:
        """The residual table."""
        return Vessel("residual", dofs, self.samples.terms, self.table(self.solution.theta, 0.0))


@dataclass(frozen=True)
class InstrumentalVariables(ResidualOptions):
    """Instrumental variables on the lack of fit, with instruments from a simulated motion.

    `orientation_terms` adds the terms of a force that is constant in NED, such as cos(psi) and
    sin(psi), free in every degree of freedom; `wind_measurement` adds the terms `wind_terms` of the
    measured wind (null: where the vessel moves in surge, sway and yaw and the recording has a
    wind). The first instruments come from the nominal model, those of the `iterations` refinements
    from the last estimate. The simulation restarts at the measured state every `restart_s` [s].
    """

    instruments: Literal["none", "simulated"]
    iterations: Annotated[int, Ge(0), Le(MOST_REPEATS)]
    restart_s: Positive | None
    orientation_terms: bool
    wind_measurement: bool | None
    wind_terms: tuple[str, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        others = [str(term) for term in basis.terms(self.wind_terms) if not _in_air(term)]
        if others or not self.wind_terms:
            raise ConfigurationError(
                f"wind_terms: got {others[0] if others else 'none'}, expected terms in "
                f"{', '.join(basis.AIR)}"
            )

    @property
    def noise_remedies(self) -> tuple[str, ...]:
        """Simulated instruments do not know the noise of the regressors."""
        if self.instruments == "simulated":
            return ()
        others = [remedy for remedy in super().noise_remedies if remedy != "identifier=iv"]
        return (*others, "identifier.instruments=simulated") if others else ()

    @property
    def interval_covers(self) -> bool:
        """With instruments the estimate is consistent; without them it is that of least squares."""
        return self.instruments != "none"

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for options that do not fit the vessel."""
        super().check(nominal, thruster, measured)
        if self.wind_measurement and nominal.dofs != PLANAR:
            raise ConfigurationError(
                f"identifier.wind_measurement needs a vessel in {', '.join(PLANAR)}, "
                f"got one in {', '.join(nominal.dofs)}"
            )
        if self.wind_measurement and measured:
            raise ConfigurationError(
                "identifier.wind_measurement: got true, expected false: the recorded "
                "file has no wind"
            )
        in_air = [str(term) for term in super().terms(nominal) if _in_air(term)]
        if in_air and (self.wind_measurement is False or measured):
            raise ConfigurationError(
                f"identifier.basis: term {in_air[0]} needs wind_measurement=true"
            )
        if self.instruments == "simulated":
            nominal.plant_table()

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel, with the terms of the predictor."""
        terms = super().terms(nominal)
        if self.wind_measurement:
            terms += tuple(t for t in basis.terms(self.wind_terms) if t not in terms)
        if self.orientation_terms:
            forces = (table.terms for table in ned_forces(nominal.dofs).values())
            terms += tuple(t for t in dict.fromkeys(chain(*forces)) if t not in terms)
        return terms

    def with_wind(self, problem: Problem) -> "InstrumentalVariables":
        """These options with the choice of the wind that they leave to the recording."""
        if self.wind_measurement is not None:
            return self
        windy = problem.nominal.dofs == PLANAR and problem.training.wind is not None
        return replace(self, wind_measurement=windy)

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table with standard errors and the strength of the instruments."""
        if self.wind_measurement is None:
            return self.with_wind(problem).estimated(problem, rng)
        lag, diagnostics = thruster_of(self, problem)
        estimate = self.estimate(problem, lag)
        residual = estimate.residual(problem.nominal.dofs)
        model = problem.nominal + residual
        if self.inertia_factor is None:
            least = float(np.min(np.linalg.eigvals(model.inertia).real))
            if least <= 0.0:
                raise IdentificationError(
                    f"the instruments are too weak: the identified inertia has an eigenvalue of "
                    f"{least:.3g}, expected positive ones; the simulation may drift away from the "
                    f"measured motion: try orientation_terms=true or a shorter restart_s"
                )
        consistent = not problem.compared and self.instruments != "none"
        weak = consistent and self.inertia_factor is not None and estimate.strength < WEAK
        errors, spread = None, None
        if not (problem.compared or weak):
            errors = estimate.table(estimate.solution.standard_errors(), np.nan)
            spread = estimate.spread()
        diagnostics = (*diagnostics, *estimate.diagnostics)
        result = Identified(model, residual, errors, diagnostics, spread=spread)
        if not consistent:
            return finished(self, problem, lag, estimate.samples, result)
        refinements: tuple[Refinement, ...] = ("none", "free_run")  # until one can be simulated
        if self.refinement != "none":
            refinements = (self.refinement,)
        for refinement in refinements[:: -1 if weak else 1]:
            options = replace(self, refinement=refinement)
            final = finished(options, problem, lag, estimate.samples, result)
            if self._simulates(problem, final.model):
                chosen = (REFINED,) if refinement != self.refinement else ()
                lacking = (NO_INTERVALS,) if not chosen and final.std_error is None else ()
                return replace(final, warnings=(*final.warnings, *chosen, *lacking))
        raise IdentificationError(
            "the instruments are too weak: the identified model diverges under the inputs of the "
            "recording, expected one that can be simulated; try fewer terms or a longer recording"
        )

    def _simulates(self, problem: Problem, model: Vessel) -> bool:
        """Whether a model can be simulated under what it was trained on."""
        try:
            simulated_motion(problem.training, [model], self.force, self.restart_s)
        except IdentificationError:
            return False
        return True

    def estimate(self, problem: Problem, lag: SecondOrderLag | None) -> Estimate:
        """The estimate without standard errors."""
        if self.wind_measurement and problem.training.wind is None:
            raise IdentificationError(
                "wind_measurement=true: the recording has no measured wind, "
                "expected a disturbance with wind"
            )
        samples = self.samples(problem.training, problem.nominal, lag)
        if self.instruments == "none":
            estimate = _solve_excited_terms(samples, samples.phi)
        else:
            estimate = self._refine(problem, samples, lag)
        kept, dofs = np.isin(np.arange(len(samples.terms)), estimate.kept), problem.nominal.dofs
        conditions = [estimate.solution.condition] * len(dofs)
        about = condition_diagnostics(samples.terms, kept, conditions, dofs)
        return replace(estimate, diagnostics=estimate.diagnostics + about)

    def _refine(self, problem: Problem, samples: Samples, lag: SecondOrderLag | None) -> Estimate:
        """Estimate with instruments from the nominal model, then from each estimate.

        In a stretch where an estimate cannot be simulated the instruments are those of the
        estimate before. The refinement ends where no stretch can be; the last estimate is kept.
        """
        models = [problem.nominal]
        instruments, same_sign, _ = self.columns(problem, models, lag)
        estimate, count = _solve_excited_terms(samples, instruments), 0
        for _ in range(self.iterations):
            models.insert(0, problem.nominal + estimate.residual(problem.nominal.dofs))
            try:
                instruments, same_sign, newest = self.columns(problem, models, lag)
                if newest == 0.0:
                    break
                estimate = _solve_excited_terms(samples, instruments)
            except IdentificationError:
                break
            count += 1
        diagnostics = (
            Diagnostic("iterations", "all", float(count)),
            Diagnostic("instrument_strength", "all", estimate.strength),
            *(
                Diagnostic("same_sign", dof, float(share))
                for dof, share in zip(problem.nominal.dofs, same_sign, strict=True)
            ),
        )
        return replace(estimate, diagnostics=diagnostics)

    def columns(
        self, problem: Problem, models: Sequence[Vessel], lag: SecondOrderLag | None
    ) -> tuple[Array, Array, float]:
        """Instruments (N, n_terms), and the share of samples with the commoner sign of nu (n_dof,).

        The instruments have zero mean except for the term 1, the intercept. Last is the share of
        the stretches that the first of the models simulates.
        """
        recording = self.lagged(problem.training, lag)
        motion, first, newest = simulated_motion(recording, models, self.force, self.restart_s)
        starts = motion.t[first]
        smoothing = self.smoothing(problem.training)
        motion = self.filtered(motion, lag, smoothing)
        inside = kept(motion, smoothing)
        used = ~np.isin(motion.t[inside], starts)
        terms = self.terms(problem.nominal)
        (z,) = evaluated(motion, lambda part: basis.evaluate(terms, part.variables()))
        z = smoothed(motion, z, smoothing)
        means = np.mean(z, axis=0, where=used[:, None])
        means[[i for i, term in enumerate(terms) if term == CONSTANT]] = 0.0
        same_sign = np.maximum(np.mean(motion.nu > 0.0, axis=0), np.mean(motion.nu < 0.0, axis=0))
        z -= means
        z[~used] = 0.0
        return z, same_sign, newest


def _in_air(term: Term) -> bool:
    return any(basis.VARIABLES[code % basis.N_VARIABLES] in basis.AIR for code in term.codes)


def _solve_excited_terms(samples: Samples, z: Array) -> Estimate:
    """The solution over the terms whose instruments and regressors vary."""
    spread = np.sqrt(np.einsum("nj,nj->j", z, z) / len(z))
    excited = (spread > 1e-12 * np.max(spread, initial=0.0)) & np.any(samples.phi != 0.0, axis=0)
    kept = tuple(int(i) for i in np.flatnonzero(excited))
    if not kept:
        raise IdentificationError(
            "the recorded force excites no term in the simulated motion, expected at least one"
        )
    names = [str(samples.terms[i]) for i in kept]
    phi = samples.phi if len(kept) == len(samples.terms) else samples.phi[:, list(kept)]
    instruments = phi if z is samples.phi else z[:, list(kept)]
    solution = solve(instruments, phi, samples.epsilon, names)
    return Estimate(samples, kept, solution)
