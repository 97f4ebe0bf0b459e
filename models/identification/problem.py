"""What every identifier is given, and what it gives back."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.findings import Finding
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import FORCES, Recording
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag


@dataclass(frozen=True, eq=False)
class Problem:
    """A recording to learn from and what is believed of the vessel.

    `training` is what an identifier may use. `validation` is held out: it serves only a
    selection that says so in its name (the thesis's `selection: test`).
    """

    training: Recording
    validation: Recording
    nominal: Vessel
    thruster: SecondOrderLag | None  # the lag, where it is known


@dataclass(frozen=True, eq=False)
class Identified:
    """The identified model F1 = F0 + residual, with its uncertainty and diagnostics."""

    model: Vessel
    residual: Vessel
    std_error: Array | None = None  # of the residual, shape of residual.theta; NaN: not estimated
    findings: tuple[Finding, ...] = field(default=())
    stages: tuple[Vessel, ...] = ()  # residual tables of each stage, where there were several
    state_space: StateSpace | None = None  # a linear model with all its inputs, as it is stored
    control_model: StateSpace | None = None  # of the forces alone, for controllers that take one


class Needs(NamedTuple):
    """What an identifier needs beside the motion and the command."""

    force: str | None = None  # commanded, filtered or actual; None: whichever there is
    thruster_lag: bool = False  # to be known of the vessel
    lowpass_hz: float | None = None  # filter that the sample time has to allow


class Identifier(ABC):
    """An identifier: frozen options; fitting returns a new object."""

    @abstractmethod
    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the vessel; raises IdentificationError when the data do not determine it."""

    def check(  # noqa: B027 - nothing to refuse
        self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool
    ) -> None:
        """Raise ConfigurationError for what cannot work with this vessel, before any work.

        `measured`: the recording is of a file, and what only a simulation has is not there.
        """

    def needs(self) -> Needs:
        """What has to be known of the vessel, or recorded."""
        return Needs()

    def model_period_s(self, sample_time_s: float) -> float | None:
        """Sample time [s] of the state-space model for a controller; None: it gives a table."""
        return None

    def without_bootstrap(self) -> "Identifier":
        """The same without the standard errors that take long, for a cross-validation."""
        return self


def check_needs(
    needs: Needs, vessel: str, thruster: SecondOrderLag | None, recorded: Recording | None
) -> None:
    """Refuse an identifier that needs a force or a lag that is neither known nor recorded.

    `recorded` is None where the recording is still to be simulated.
    """
    if needs.thruster_lag and thruster is None:
        raise ConfigurationError(
            f"identifier.force: got filtered, but {vessel} has no known thruster lag"
        )
    if needs.force == "actual" and recorded is not None:
        recorded.force(needs.force)


def choose_basis(
    choice: str | tuple[str, ...], extra_terms: Sequence[str], nominal: Vessel
) -> tuple[Term, ...]:
    """`full` (Jervan's 31 terms), `physical` (the nominal model's own), or a list of terms.

    For a vessel that is not surge-sway-yaw `full` is its own terms too.
    """
    if choice == "full" and nominal.dofs == PLANAR:
        chosen = basis.full_basis(nominal.dofs)
    elif choice in ("full", "physical"):
        chosen = nominal.terms
    elif isinstance(choice, str):
        raise ConfigurationError(
            f"identifier.basis: got {choice!r}, expected full, physical or a list of terms"
        )
    else:
        chosen = basis.terms(choice)
    return chosen + tuple(t for t in basis.terms(extra_terms) if t not in chosen)


def check_force(kind: str | None) -> None:
    """Refuse an unknown kind of force."""
    if kind is not None and kind not in FORCES:
        raise ConfigurationError(f"force: got {kind!r}, expected one of {', '.join(FORCES)}")


def lack_of_fit(recording: Recording, model: Vessel, force: str | None) -> Array:
    """epsilon = tau - F(nu_dot, nu) [N, Nm], shape (N, n_dof). Jervan (2020), eq. (3.20)."""
    fitted = model.inverse(recording.nu_dot, recording.nu, recording.attitude, recording.wind)
    return recording.force(force) - fitted


# No identification: the nominal model as it is, the reference of every comparison.


@dataclass(frozen=True)
class NoIdentifier(Identifier):
    """Learns nothing: F1 = F0, a residual table without terms."""

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model."""
        nominal = problem.nominal
        empty = Vessel("residual", nominal.dofs, (), np.zeros((0, len(nominal.dofs))))
        return Identified(nominal, empty)
