"""From a recording to a regression: which force, which basis, which filter, and the columns.

    epsilon = tau - F0(nu_dot, nu) = Phi theta + rest            Jervan (2020), eqs. (3.20)-(3.22)

Every identifier of a coefficient table is told the same about its data (`ResidualOptions`) and
begins with the same samples of Phi and epsilon (`Samples`).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.problem import Identifier, Needs, choose_basis, lack_of_fit
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import PLANAR, Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

CONSTANT = basis.term("1")
NED_COLUMNS = basis.terms(["cos(psi)", "sin(psi)"])


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
    lowpass_hz: float | None
    thruster: Literal["known", "estimated", "none"]

    def __post_init__(self) -> None:
        if self.lowpass_hz is not None and not self.lowpass_hz > 0.0:
            raise ConfigurationError(f"lowpass_hz must be positive, got {self.lowpass_hz}")
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
