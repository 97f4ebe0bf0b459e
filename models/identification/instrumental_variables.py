"""Instrumental variables for second-order modulus models. Ljungberg (slides), after his thesis.

    theta = sol { (1/N) sum_k Z(k) (y(k) - Phi(k)' theta) = 0 }

Least squares is Z = Phi. It is biased, however long the recording, where the regressors are
measured: they carry the same noise twice. Instruments Z that follow the motion and not its noise
make the estimate consistent. Products such as (u + e)|u + e| leave a mean e^2 even so, constant
while u keeps its sign: hence the excitation has an offset and the instruments have zero mean.

    predictor   orientation_terms   wind_measurement
    LS1, IV1    false               false     bursts of wind and current without a mean
    LS2, IV2    true                false     a mean, slower than the vessel
    LS3, IV3    true                true      a mean, at times faster than the vessel

with `instruments: none` (LS) or `simulated` (IV).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.linear import qr
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.identification.residual import (
    CONSTANT,
    NED_COLUMNS,
    ResidualOptions,
    Samples,
    thruster_of,
)
from seatrial.models.identification.simulated_motion import simulated_motion
from seatrial.models.identification.uncertainty import (
    ErrorKind,
    block_bootstrap,
    check_bootstrap,
    hac_variance,
    stationary_variance,
)
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import NotNegativeInt, Positive
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

SINGULAR = 1e-10


@dataclass(frozen=True, eq=False)
class Solution:
    """An instrumental-variable fit of m targets; linear in them, theta = gains' y."""

    theta: Array  # (n_terms, m)
    rest: Array  # (N, m)
    span: Array  # (N, n_instruments) orthonormal columns of the instruments
    share: Array  # (n_instruments, n_terms), theta = share' span' y
    condition: float  # of the scaled regressors as far as the instruments see them

    @cached_property
    def gains(self) -> Array:
        """Weight of every sample's target in theta, shape (N, n_terms)."""
        return np.asarray(self.span @ self.share)


def solve(z: Array, phi: Array, y: Array, names: Sequence[str] = ()) -> Solution:
    """Two-stage least squares; z (N, n_instruments), phi (N, n_terms), y (N, m).

    theta = argmin |P (y - Phi theta)|^2 with the projection P on the instruments; for as many
    instruments as terms the solution of Z'(y - Phi theta) = 0, and for Z = Phi least squares.
    Raises IdentificationError, with the `names` of the terms, where the instruments do not
    determine theta.
    """
    if z.shape[1] < phi.shape[1]:
        raise IdentificationError(
            f"got {z.shape[1]} instruments for {phi.shape[1]} terms, expected at least as many"
        )
    zq, zr = qr(_scaled(z))
    if z.shape[1] == phi.shape[1]:
        _check_rank(zr, names, "instruments")
    scale = _size(phi)
    seen = zr if z is phi else (zq.T @ phi) / scale  # of least squares: Q'Q R = R
    u, s, vt = np.linalg.svd(seen, full_matrices=False)
    _check_singular(s, vt, names, "instruments")
    share = (u / s) @ vt / scale
    theta = share.T @ (zq.T @ y)
    return Solution(theta, y - phi @ theta, zq, share, float(s[0] / s[-1]))


def _size(columns: Array) -> Array:
    size = np.sqrt(np.einsum("nj,nj->j", columns, columns) / len(columns))
    return np.where(size > 0.0, size, 1.0)


def _scaled(columns: Array) -> Array:
    return np.asarray(columns / _size(columns))


def _check_rank(r: Array, names: Sequence[str], what: str) -> None:
    _, s, vt = np.linalg.svd(r)
    _check_singular(s, vt, names, what)


def _check_singular(s: Array, vt: Array, names: Sequence[str], what: str) -> None:
    if s[-1] > SINGULAR * s[0]:
        return
    part = [str(names[int(i)]) for i in np.flatnonzero(np.abs(vt[-1]) > 0.1)] if names else []
    raise IdentificationError(
        f"the {what} do not tell {', '.join(part) or 'the terms'} from each other "
        f"(singular value ratio {s[-1] / s[0]:.1e})"
    )


@dataclass(frozen=True, eq=False)
class Estimate:
    """What `InstrumentalVariables.estimate` found, before errors are worked out."""

    samples: Samples
    kept: tuple[int, ...]  # terms that are determined; the others stay as in the nominal model
    solution: Solution  # over `kept`
    findings: tuple[Finding, ...]

    def table(self, values: Array, missing: float) -> Array:
        """Values over `kept` on all terms, shape (n_terms, n_dof)."""
        full = np.full((len(self.samples.terms), values.shape[1]), missing)
        full[list(self.kept)] = values
        return full

    def residual(self, dofs: tuple[str, ...]) -> Vessel:
        """The residual table."""
        return Vessel("residual", dofs, self.samples.terms, self.table(self.solution.theta, 0.0))


@dataclass(frozen=True)
class InstrumentalVariables(ResidualOptions):
    """Instrumental variables on the lack of fit, instruments from a simulated motion.

    `orientation_terms` adds cos(psi), sin(psi), free in every degree of freedom (null: where a
    vessel moves in surge, sway and yaw), `wind_measurement` the terms `wind_terms` of the measured
    wind. The first instruments are from the nominal model, and `iterations` times again from the
    model that was found. `restart_s` begins the simulation anew from the measured state.
    `bootstrap` is the number of block-bootstrap replicates for standard errors; null takes
    `errors`. The instruments are the same in all of them.
    """

    instruments: Literal["none", "simulated"]
    iterations: NotNegativeInt
    restart_s: Positive | None
    orientation_terms: bool | None
    wind_measurement: bool
    wind_terms: tuple[str, ...]
    errors: ErrorKind
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bootstrap(self.bootstrap, self.block_s)
        still = [str(one) for one in basis.terms(self.wind_terms) if not _in_air(one)]
        if still or not self.wind_terms:
            raise ConfigurationError(
                f"wind_terms: got {still[0] if still else 'none'}, expected terms in "
                f"{', '.join(basis.AIR)}"
            )

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Refuse what cannot work for this vessel, before any work."""
        super().check(nominal, thruster, measured)
        for name in ("orientation_terms", "wind_measurement"):
            if getattr(self, name) and nominal.dofs != PLANAR:
                raise ConfigurationError(
                    f"identifier.{name} needs a vessel in {', '.join(PLANAR)}, "
                    f"got one in {', '.join(nominal.dofs)}"
                )
        if self.wind_measurement and measured:
            raise ConfigurationError(
                "identifier.wind_measurement: the recorded file has no wind, only a simulated "
                "recording has"
            )
        in_air = [str(one) for one in super().terms(nominal) if _in_air(one)]
        if in_air and not self.wind_measurement:
            raise ConfigurationError(
                f"identifier.basis: term {in_air[0]} needs wind_measurement=true"
            )
        if self.instruments == "simulated":
            nominal.plant_table()

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel, with the terms of the predictor."""
        chosen = super().terms(nominal)
        if self.wind_measurement:
            chosen += tuple(t for t in basis.terms(self.wind_terms) if t not in chosen)
        if self.orientation_terms or (self.orientation_terms is None and nominal.dofs == PLANAR):
            chosen += tuple(t for t in NED_COLUMNS if t not in chosen)
        return chosen

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table with standard errors, and how good the instruments are."""
        found = self.estimate(problem)
        residual = found.residual(problem.nominal.dofs)
        _refuse_nonsense(problem.nominal + residual)
        errors = found.table(self._errors(found, rng), np.nan)
        return Identified(problem.nominal + residual, residual, errors, found.findings)

    def without_bootstrap(self) -> Identifier:
        """The same without replicates."""
        return replace(self, bootstrap=None)

    def _errors(self, found: Estimate, rng: np.random.Generator) -> Array:
        """Standard errors of what was kept, shape (n_kept, n_dof)."""
        if self.bootstrap is None:
            return _standard_errors(found.solution, self.errors)
        length = round(self.block_s / found.samples.period_s)
        gains, rest = found.solution.gains, found.solution.rest
        return block_bootstrap(lambda drawn: gains.T @ drawn, rest, length, self.bootstrap, rng)

    def estimate(self, problem: Problem) -> Estimate:
        """The estimate without standard errors."""
        if self.wind_measurement and problem.training.wind is None:
            raise IdentificationError(
                "wind_measurement=true: the recording has no measured wind, "
                "expected a disturbance with wind"
            )
        lag, findings = thruster_of(self, problem)
        samples = self.samples(problem.training, problem.nominal, lag)
        if self.instruments == "none":
            found = _solved(samples, samples.phi)
        else:
            found = self._refined(problem, samples, lag)
        return Estimate(
            samples, found.kept, found.solution,
            findings + found.findings + _fit_findings(found, problem.nominal.dofs),
        )  # fmt: skip

    def _refined(self, problem: Problem, samples: Samples, lag: SecondOrderLag | None) -> Estimate:
        """Instruments from the nominal model, then from what was found.

        A model that cannot be simulated ends the refinement: the last estimate stands.
        """
        z, same_sign = self.columns(problem, problem.nominal, lag)
        found, done = _solved(samples, z), 0
        for _ in range(self.iterations):
            model = problem.nominal + found.residual(problem.nominal.dofs)
            try:
                better, same_sign = self.columns(problem, model, lag)
                found, z = _solved(samples, better), better
            except IdentificationError:
                break
            done += 1
        findings = [Finding("iterations", "all", float(done)), *_correlations(found, z)]
        for dof, share in zip(problem.nominal.dofs, same_sign, strict=True):
            findings.append(Finding("same_sign", dof, float(share)))
        return Estimate(samples, found.kept, found.solution, tuple(findings))

    def columns(
        self, problem: Problem, model: Vessel, lag: SecondOrderLag | None
    ) -> tuple[Array, Array]:
        """Instruments (N, n_terms) of zero mean, and how often velocities have one sign (n_dof,).

        The term 1 keeps its mean, an intercept.
        """
        recording = problem.training
        if self.thruster == "estimated":
            recording = recording.with_thruster(lag)
        elif self.thruster == "none":
            recording = replace(recording, tau_filtered=None)
        motion, first = simulated_motion(recording, model, self.force, self.restart_s)
        starts = motion.t[first]
        motion = self.filtered(motion, lag)
        used = ~np.isin(motion.t, starts)
        terms = self.terms(problem.nominal)
        z = basis.evaluate(terms, motion.variables())
        means = np.mean(z, axis=0, where=used[:, None])
        means[[i for i, one in enumerate(terms) if one == CONSTANT]] = 0.0
        same_sign = np.maximum(np.mean(motion.nu > 0.0, axis=0), np.mean(motion.nu < 0.0, axis=0))
        z -= means
        z[~used] = 0.0
        return z, same_sign


def _refuse_nonsense(model: Vessel) -> None:
    """A vessel of negative inertia says that the instruments do not follow the motion."""
    least = float(np.min(np.linalg.eigvals(model.inertia).real))
    if least <= 0.0:
        raise IdentificationError(
            f"the instruments are too weak: the inertia found has an eigenvalue of {least:.3g}, "
            f"expected positive ones; the simulation leaves the motion where a mean force is "
            f"missing (orientation_terms=true) or where it runs for long (restart_s)"
        )


def _in_air(one: Term) -> bool:
    return any(basis.VARIABLES[code % basis.N_VARIABLES] in basis.AIR for code in one.codes)


def _solved(samples: Samples, z: Array) -> Estimate:
    """The solution over the terms whose instruments and regressors vary."""
    spread = np.sqrt(np.mean(z**2, axis=0))
    seen = (spread > 1e-12 * np.max(spread, initial=0.0)) & np.any(samples.phi != 0.0, axis=0)
    kept = tuple(int(i) for i in np.flatnonzero(seen))
    if not kept:
        raise IdentificationError("the recorded force moves the simulated vessel in no term")
    names = [str(samples.terms[i]) for i in kept]
    phi = samples.phi if len(kept) == len(samples.terms) else samples.phi[:, list(kept)]
    instruments = phi if z is samples.phi else z[:, list(kept)]
    solution = solve(instruments, phi, samples.epsilon, names)
    return Estimate(samples, kept, solution, ())


def _correlations(found: Estimate, z: Array) -> tuple[Finding, ...]:
    """Correlation of every regressor with its instrument; a weak one makes a poor estimate."""
    values = []
    for i in found.kept:
        a, b = z[:, i] - np.mean(z[:, i]), found.samples.phi[:, i]
        b = b - np.mean(b)
        size = float(np.sqrt(np.sum(a**2) * np.sum(b**2)))
        if size > 0.0:
            name = found.samples.terms[i].name
            values.append(Finding("instrument_correlation", "all", float(a @ b) / size, label=name))
    return tuple(values)


def _fit_findings(found: Estimate, dofs: tuple[str, ...]) -> tuple[Finding, ...]:
    """Condition number as the instruments see it, and the terms that are not determined."""
    condition = [Finding("condition_number", dof, found.solution.condition) for dof in dofs]
    dropped = [
        Finding("dropped_term", "all", 1.0, label=one.name)
        for i, one in enumerate(found.samples.terms)
        if i not in found.kept
    ]
    return (*condition, *dropped)


def _standard_errors(solution: Solution, kind: ErrorKind) -> Array:
    """Standard errors (n_terms, n_dof) for residuals that are autocorrelated."""
    n, n_terms = solution.gains.shape
    rest = solution.rest * np.sqrt(n / max(n - n_terms, 1))
    if kind == "hac":
        columns = [hac_variance(solution.gains * column[:, None]) for column in rest.T]
        variances = np.stack(columns, axis=1)
    else:
        variances = stationary_variance(solution.gains, rest)
    return np.sqrt(np.clip(variances, 0.0, None))
