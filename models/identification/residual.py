"""From a recording to a regression: which force, which basis, which filter, and the columns.

    epsilon = tau - F0(nu_dot, nu) = Phi theta + rest            Jervan (2020), eqs. (3.20)-(3.22)

Every identifier of a coefficient table is told the same about its data (`ResidualOptions`) and
begins with the same samples of Phi and epsilon (`Samples`).

Where the thruster lag is not known, the one is taken that makes the filtered force most
explicable. For each natural frequency and damping the command is passed through the lag and
regressed on the basis; the pair with the largest R^2 *of the filtered force* wins,

    maximise mean over dof of 1 - |rest|^2 / |f - mean f|^2,    f = lag(command).

Dividing by the variance of the lack of fit instead would reward a lag that makes the force, and
with it the lack of fit, large. Standard errors of coefficients are those at the lag that was
found. An axis that is hardly excited near the lag's frequency does not tell a lag from inertia.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import (
    Identifier,
    Needs,
    Problem,
    choose_basis,
    lack_of_fit,
)
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

CONSTANT = basis.term("1")
NED_COLUMNS = basis.terms(["cos(psi)", "sin(psi)"])
SETTLE_S = 10.0  # the lag's state at the start is not known; its effect is gone by then
FREQUENCIES = np.geomspace(0.3, 20.0, 9)  # [rad/s] where the search begins
DAMPINGS = np.geomspace(0.3, 2.0, 4)
NOTHING_LEFT = 1e-12  # share of the force below which a better fit is rounding


@dataclass(frozen=True, eq=False)
class Samples:
    """Regressors and lack of fit of one recording."""

    terms: tuple[Term, ...]
    phi: Array  # (N, n_terms)
    epsilon: Array  # (N, n_dof) [N, Nm]
    force: Array  # (N, n_dof) [N, Nm], what epsilon was formed with
    heading: Array  # (N, 2), cos(psi) and sin(psi)
    period_s: float

    def __len__(self) -> int:
        return len(self.phi)

    @cached_property
    def varying(self) -> NDArray[np.int64]:
        """Indices of the terms that vary; the others cannot be told from the constant."""
        low, high = np.min(self.phi, axis=0), np.max(self.phi, axis=0)
        return np.flatnonzero(high - low > 1e-12 * np.maximum(-low, high))

    @property
    def constant(self) -> int | None:
        """Index of the term 1, the intercept; None where the basis does not have it."""
        return self.terms.index(CONSTANT) if CONSTANT in self.terms else None


@dataclass(frozen=True)
class ResidualOptions(Identifier):
    """What an identifier of a residual table is told about its data.

    `basis`: full (Jervan's 31 terms), physical (the nominal model's own) or a list of terms, with
    `extra_terms` beside them. `force`: which force the residual is formed with; null is filtered
    where the thruster lag is known, else actual where that is recorded, else commanded.
    `lowpass_hz`: zero-phase low-pass of velocity, acceleration and force alike. `thruster`: the
    lag is known (taken from the vessel), estimated from the recording, or none.
    """

    basis: str | tuple[str, ...]
    extra_terms: tuple[str, ...]
    force: Literal["commanded", "filtered", "actual"] | None
    lowpass_hz: Positive | None
    thruster: Literal["known", "estimated", "none"]

    def __post_init__(self) -> None:
        check_ranges(self)
        if isinstance(self.basis, str) and self.basis not in ("full", "physical"):
            raise ConfigurationError(
                f"basis: got {self.basis!r}, expected full, physical or a list of terms"
            )
        basis.terms(() if isinstance(self.basis, str) else self.basis)
        basis.terms(self.extra_terms)
        if self.thruster == "estimated" and self.force not in (None, "filtered"):
            raise ConfigurationError(
                f"thruster=estimated filters the command: force must be filtered or null, "
                f"got {self.force}"
            )
        if self.thruster == "none" and self.force == "filtered":
            raise ConfigurationError("force=filtered needs a thruster lag, got thruster=none")

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Refuse what cannot work for this vessel, before any work."""
        if self.force == "filtered" and thruster is None and self.thruster == "known":
            raise ConfigurationError(
                f"identifier.force=filtered: {nominal.name} has no known thruster lag"
            )
        chosen = choose_basis(self.basis, self.extra_terms, nominal)
        if not chosen:
            raise ConfigurationError("identifier.basis: got no terms, expected at least one")
        known = {"1", *nominal.velocities, *nominal.accelerations, *basis.ATTITUDE}
        known |= {*basis.AIR} if nominal.dofs == PLANAR else set()
        for one in chosen:
            for code in one.codes:
                name = basis.VARIABLES[code % basis.N_VARIABLES]
                if name not in known:
                    raise ConfigurationError(
                        f"identifier.basis: term {one} has {name}, but {nominal.name} moves in "
                        f"{', '.join(nominal.dofs)}"
                    )

    def needs(self) -> Needs:
        """The force, by the vessel's own lag where that is to be known, and the low-pass."""
        lag = self.force == "filtered" and self.thruster == "known"
        return Needs(self.force, lag, self.lowpass_hz)

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel."""
        return choose_basis(self.basis, self.extra_terms, nominal)

    def filtered(self, recording: Recording, lag: SecondOrderLag | None) -> Recording:
        """The recording with the force by this lag, and low-passed."""
        if self.thruster == "none":
            recording = replace(recording, tau_filtered=None)
        elif self.thruster == "estimated":
            recording = recording.with_thruster(lag)
        return recording.lowpass(self.lowpass_hz)

    def samples(self, recording: Recording, nominal: Vessel, lag: SecondOrderLag | None) -> Samples:
        """Regressors and lack of fit of a recording."""
        filtered = self.filtered(recording, lag)
        terms, x = self.terms(nominal), filtered.variables()
        phi, heading = basis.evaluate(terms, x), basis.evaluate(NED_COLUMNS, x)
        epsilon, force = lack_of_fit(filtered, nominal, self.force), filtered.force(self.force)
        found = Samples(terms, phi, epsilon, force, heading, recording.period_s)
        if not (np.all(np.isfinite(phi)) and np.all(np.isfinite(epsilon))):
            raise IdentificationError("the training part has values that are not finite")
        if len(found) <= len(terms) + 1:
            raise IdentificationError(
                f"the training part has {len(found)} samples for {len(terms)} terms"
            )
        return found


def ned_columns(heading: Array) -> Array:
    """Columns of a force (north, east) that is constant in NED, shape (3, N, 2).

    heading (N, 2) is (cos psi, sin psi). tau = F - R(psi)' f, hence epsilon gets -(cos, sin) f in
    surge and (sin, -cos) f in sway: the two unknowns are shared.
    """
    c, s = heading.T
    zero = np.zeros_like(c)
    return np.array([np.stack(pair, axis=1) for pair in ((-c, -s), (s, -c), (zero, zero))])


def ned_table(force: Array) -> Array:
    """The same as coefficients of cos(psi) and sin(psi), shape (2, 3); force (north, east) [N]."""
    north, east = force
    return np.array([[-north, -east, 0.0], [-east, north, 0.0]])


@dataclass(frozen=True, eq=False)
class _Search:
    """What does not change while the lag does."""

    options: ResidualOptions
    problem: Problem
    keep: slice
    fitted: Array  # (N, n_dof) force that the nominal model needs
    u: Array  # (N, rank) orthonormal columns of the basis

    def unexplained(self, logs: Array) -> float:
        """Mean over dof of 1 - R^2 of the filtered force, for (log frequency, log damping)."""
        force = self.force(SecondOrderLag(*np.exp(logs)))
        rest = force - self.fitted
        rest -= self.u @ (self.u.T @ rest)
        moves = np.var(force, axis=0) > 0.0
        if not np.any(moves):
            return 1.0
        ratios = np.mean(rest[:, moves] ** 2, axis=0) / np.var(force[:, moves], axis=0)
        return float(np.mean(ratios))

    def force(self, lag: SecondOrderLag) -> Array:
        """Filtered and low-passed command [N, Nm], (N, n_dof)."""
        return self.options.filtered(self.problem.training, lag).force("filtered")[self.keep]


def thruster_of(
    options: ResidualOptions, problem: Problem
) -> tuple[SecondOrderLag | None, tuple[Finding, ...]]:
    """The lag to filter the command with, by `options.thruster`, and what was found of it."""
    if options.thruster == "known":
        return problem.thruster, ()
    if options.thruster == "none":
        return None, ()
    return estimate(options, problem)


def estimate(
    options: ResidualOptions, problem: Problem
) -> tuple[SecondOrderLag, tuple[Finding, ...]]:
    """The lag of the largest R^2, by a grid and then the simplex of Nelder and Mead."""
    from scipy.optimize import minimize  # slow to import

    search = _prepare(options, problem)
    grid = np.array([(np.log(w), np.log(d)) for w in FREQUENCIES for d in DAMPINGS])
    start = grid[int(np.argmin([search.unexplained(point) for point in grid]))]
    found = minimize(
        lambda logs: np.log(search.unexplained(np.clip(logs, -5.0, 6.0)) + NOTHING_LEFT),
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-5, "fatol": 1e-6, "maxiter": 500},
    )
    frequency, damping = (float(value) for value in np.exp(np.clip(found.x, -5.0, 6.0)))
    lag = SecondOrderLag(frequency, damping)
    r2 = 1.0 - search.unexplained(found.x)
    return lag, (
        Finding("thruster_natural_frequency", "all", lag.natural_frequency_rad_s, "rad/s"),
        Finding("thruster_damping", "all", lag.damping),
        Finding("thruster_r2", "all", r2),
    )


def _prepare(options: ResidualOptions, problem: Problem) -> _Search:
    """The basis with cos(psi), sin(psi) beside it, so that a constant force does not mislead."""
    training = problem.training
    any_lag = SecondOrderLag(1.0, 1.0)
    samples = options.samples(training, problem.nominal, any_lag)
    settle = round(SETTLE_S / training.period_s)
    if len(samples) < settle + 2 * len(samples.terms):
        raise IdentificationError(
            f"thruster=estimated: the training part has {len(samples)} samples, expected at "
            f"least {settle + 2 * len(samples.terms)}"
        )
    keep = slice(settle, None)
    columns = np.hstack([samples.phi, samples.heading])[keep]
    size = np.sqrt(np.mean(columns**2, axis=0))
    u, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    fitted = (samples.force - samples.epsilon)[keep]
    return _Search(options, problem, keep, fitted, u[:, s > 1e-10 * s[0]])
