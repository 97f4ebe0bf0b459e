"""The interface of an identifier: the problem, the result and the options' checks."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Self

import numpy as np

from seatrial.models.diagnostics import INTERVAL_OF_ESTIMATE, Diagnostic
from seatrial.models.errors import ConfigurationError, PartError, RecordingError
from seatrial.models.identification.model_error import ModelError
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording
from seatrial.models.returned import checked_array, name_of
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import NEEDED, Array, Term, each_product_once, manoeuvring_basis
from seatrial.models.vessel.derivatives import DOWN
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

Force = Literal["commanded", "filtered", "actual"]


@dataclass(frozen=True, eq=False)
class Problem:
    """A recording and the prior knowledge of the vessel.

    An identifier uses `training`. `validation` is held out; only `selection: test`, as in the
    thesis, uses it.
    """

    training: Recording
    validation: Recording
    nominal: Vessel
    thruster: SecondOrderLag | None  # None: not known
    compared: bool = False  # only the model is asked for, without its errors and warnings

    def __post_init__(self) -> None:
        recorded, expected = self.training.input_names, self.nominal.inputs
        if recorded != expected:
            got, needed = ", ".join(recorded) or "none", ", ".join(expected) or "none"
            raise RecordingError(
                f"recording: got inputs {got}, expected those of {self.nominal.name}: {needed}"
            )


class Spread(ABC):
    """The joint distribution of what was identified, as far as the data leave it open."""

    @abstractmethod
    def draw(
        self, result: "Identified", rng: np.random.Generator, share: float = 1.0,
        kappa2: float = 1.0,
    ) -> Vessel:  # fmt: skip
        """A model drawn about that of `result`, by a share of its deviations.

        The data count by 1 / `kappa2` of their information, a prior in full.
        """


@dataclass(frozen=True, eq=False)
class Identified:
    """The identified model F1 = F0 + residual, with its uncertainty and diagnostics."""

    model: Vessel
    residual: Vessel
    std_error: Array | None = None  # of the residual, shape of residual.theta; NaN: not estimated
    diagnostics: tuple[Diagnostic, ...] = field(default=())
    stages: tuple[Vessel, ...] = ()  # residual table of each stage
    state_space: StateSpace | None = None  # linear model with all its inputs
    control_model: StateSpace | None = None  # linear model with the forces as inputs, for control
    warnings: tuple[str, ...] = ()  # one line each, what is wrong and what to try
    notes: tuple[str, ...] = ()  # one line each, what was chosen and why
    device_errors: Mapping[str, float] = field(default_factory=dict)  # standard errors, by label
    spread: Spread | None = None  # None: not estimated
    fold_models: tuple[Vessel, ...] = ()  # each identified without one fold of the training part
    model_error: ModelError | None = None  # None: not calibrated

    def draws(self, count: int, share: float = 1.0) -> Iterator[Vessel]:
        """Models drawn from the spread, always by the same random numbers; none without one.

        `share` is that of the deviations of their parameters. Where there is a model error they
        are those that it calls for.
        """
        if self.spread is None:
            return
        rng, error = np.random.default_rng(0), self.model_error
        kappa2, scale = (1.0, 1.0) if error is None else (error.kappa2, error.scale)
        for _ in range(count):
            yield self.spread.draw(self, rng, share * scale, kappa2)


MIN_SAMPLES = 2  # samples of a recording


class Needs(NamedTuple):
    """Data that an identifier needs in addition to the motion and the command."""

    force: str | None = None  # commanded, filtered or actual; None: the best available one
    thruster_lag: bool = False  # whether the thruster lag has to be known
    lowpass_hz: float | None = None  # must be below the Nyquist frequency
    samples: int = MIN_SAMPLES  # least number of them for training


class Identifier(ABC):
    """An identifier: frozen options; fitting returns a new object."""

    @property
    def interval_covers(self) -> bool:
        """Whether 1.96 standard errors are tested to cover 90 to 98 % of the true coefficients.

        Otherwise they are an interval of the estimate, whose bias they do not include.
        """
        return False

    @property
    def protected(self) -> bool:
        """Whether axes that free runs predict worse keep their nominal equation (`fallback`).

        An identifier of the user's is taken at its word.
        """
        return False

    @abstractmethod
    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the vessel; raises IdentificationError when the data do not determine it."""

    def check(  # noqa: B027 - nothing to refuse
        self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool
    ) -> None:
        """Raise ConfigurationError for options that do not fit the vessel.

        `measured` is true for a recorded file, which lacks the data only a simulation has.
        """

    def needs(self) -> Needs:
        """Data of the vessel or the recording that the identifier needs."""
        return Needs()

    def check_samples(self, training: Recording, nominal: Vessel) -> None:
        """Raise RecordingError if the training part of a file is too short for the options."""
        if len(training) < (fewest := self.needs().samples):
            raise RecordingError(
                f"got {len(training)} samples for training, expected at least {fewest}"
            )

    def model_period_s(self, sample_time_s: float) -> float | None:
        """Sample time [s] of the identified state-space model; None: it identifies a table."""
        return None

    def quick(self) -> "Identifier":
        """This identifier without refinement, for a first comparison."""
        return self

    def alternatives(self, problem: Problem) -> dict[str, Self]:
        """Choices that its options leave to the data, the simplest first; empty: there are none."""
        return {}


def checked(identifier: Identifier, result: object, nominal: Vessel) -> Identified:
    """What an identifier has returned; raises PartError if it is no model of the vessel."""
    where = f"{name_of(identifier)}.identify"
    if not isinstance(result, Identified):
        raise PartError(f"{where}: got a {type(result).__name__}, expected an Identified")
    for name, table in (("model", result.model), ("residual", result.residual)):
        if not isinstance(table, Vessel):
            raise PartError(f"{where}: {name}: got a {type(table).__name__}, expected a Vessel")
        if table.dofs != nominal.dofs:
            got, expected = ", ".join(table.dofs), ", ".join(nominal.dofs)
            raise PartError(f"{where}: {name}: got a model in {got}, expected {expected}")
        checked_array(identifier, f"identify: {name}", table.theta, table.theta.shape)
    errors = result.std_error
    if errors is not None and np.shape(errors) != result.residual.theta.shape:
        shape = result.residual.theta.shape
        raise PartError(f"{where}: std_error: got shape {np.shape(errors)}, expected {shape}")
    return result


def with_interval(identifier: Identifier, identified: Identified) -> Identified:
    """Add the diagnostic `interval_of_estimate` to a model with standard errors, once."""
    errors = identified.std_error
    known = any(diagnostic.name == INTERVAL_OF_ESTIMATE for diagnostic in identified.diagnostics)
    if known or errors is None or not np.any(np.isfinite(errors)):
        return identified
    diagnostic = Diagnostic(INTERVAL_OF_ESTIMATE, "all", float(not identifier.interval_covers))
    return replace(identified, diagnostics=(*identified.diagnostics, diagnostic))


def check_needs(
    needs: Needs, vessel: str, thruster: SecondOrderLag | None, recorded: Recording | None
) -> None:
    """Raise ConfigurationError if a force or a lag is needed but neither known nor recorded.

    `recorded` is None if the recording has not been simulated yet.
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
    """The basis: `full` (Jervan's 31 terms), `physical` (those of the nominal model), or a list.

    `linear` are the accelerations, the velocities, the inputs and the restoring forces of the
    nominal model. For a vessel that does not move in surge, sway and yaw `full` equals `physical`.
    For a vessel with inputs, unless its table is that of the hull alone (`bare_hull`), `full` are
    the terms of manoeuvring (`manoeuvring`), `physical` without devices has each product of the
    nominal model once, and none of these has accelerations: the inertia stays that of the nominal
    model. A rudder acts on sway and yaw in a fixed proportion, so that any multiple of one equation
    may be added to the other.
    """
    inputs = () if nominal.bare_hull else nominal.inputs
    if choice == "full" and inputs and {*nominal.dofs} >= NEEDED:
        terms = manoeuvring_basis(nominal.accelerations, inputs)
    elif choice == "full" and nominal.dofs == PLANAR and nominal.bare_hull:
        terms = basis.full_basis(nominal.dofs)
    elif choice in ("full", "physical"):
        terms = nominal.terms
        if nominal.inputs:
            terms = tuple(each for each in terms if np.any(nominal.row(each.name) != 0.0))
        if not nominal.forces_known:
            terms = each_product_once(terms)
    elif choice == "linear":
        restoring = [term.name for term in nominal.terms if term.name in DOWN]
        names = [*nominal.accelerations, *nominal.velocities, *inputs, *restoring]
        terms = basis.terms(names)
    elif isinstance(choice, str):
        raise ConfigurationError(
            f"identifier.basis: got {choice!r}, expected full, physical, linear or a list of terms"
        )
    else:
        terms = basis.terms(choice)
    if isinstance(choice, str) and inputs:
        terms = tuple(term for term in terms if term.name not in nominal.accelerations)
    return terms + tuple(t for t in basis.terms(extra_terms) if t not in terms)


def lack_of_fit(recording: Recording, model: Vessel, force: str | None) -> Array:
    """epsilon = tau - F(nu_dot, nu) [N, Nm], shape (N, n_dof). Jervan (2020), eq. (3.20)."""
    fitted = model.inverse(
        recording.nu_dot, recording.nu, recording.attitude, recording.wind, recording.inputs
    )
    return recording.force(force) - fitted


def check_forces(identifier: str, nominal: Vessel) -> None:
    """Raise ConfigurationError for a vessel whose forces are not known, but its inputs."""
    if not nominal.forces_commanded:
        raise ConfigurationError(
            f"identifier={identifier} needs forces, but {nominal.name} has inputs "
            f"({', '.join(nominal.inputs)})"
        )


def reference_force(recording: Recording, nominal: Vessel, force: str | None) -> Array:
    """The force [N, Nm] that a model has to explain, shape (N, n_dof).

    It is the recorded one; for a vessel with inputs, whose forces are not recorded, that of its
    inertia, M nu_dot.
    """
    if nominal.forces_commanded:
        return recording.force(force)
    return np.asarray(recording.nu_dot @ nominal.inertia.T)


@dataclass(frozen=True)
class NoIdentifier(Identifier):
    """No identification, as a reference: F1 = F0, a residual table without terms."""

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model."""
        nominal = problem.nominal
        empty = Vessel("residual", nominal.dofs, (), np.zeros((0, len(nominal.dofs))))
        return Identified(nominal, empty)
