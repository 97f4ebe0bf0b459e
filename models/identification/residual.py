"""The regression problem of a recording: force, basis, filter, and columns.

    epsilon = tau - F0(nu_dot, nu) = Phi theta + rest            Jervan (2020), eqs. (3.20)-(3.22)

All identifiers of a coefficient table share the options of the data (`ResidualOptions`) and the
samples of Phi and epsilon (`Samples`). If the thruster lag is not known, that can be estimated by
which the basis explains the filtered command f best,

    maximise mean over dof of 1 - |rest|^2 / |f - mean f|^2,    f = lag(command).

Dividing by the variance of the lack of fit instead would favour a lag that increases the force and
with it the lack of fit. Standard errors of coefficients are those for the estimated lag.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import pairwise, product
from typing import Annotated, Any, Literal, Self

import numpy as np
import scipy
from annotated_types import Gt
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError, RecordingError
from seatrial.models.identification.cross_validation import CrossValidation, best_of
from seatrial.models.identification.problem import (
    Force,
    Identified,
    Identifier,
    Needs,
    Problem,
    choose_basis,
    lack_of_fit,
    reference_force,
)
from seatrial.models.notation import DOFS, PLANAR, poses_of
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import DROP_S, Recording
from seatrial.models.recording.signals import Smoothing, smoothing_for
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.devices.device import device_forces
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

CONSTANT = basis.term("1")
NAMED_BASES = ("full", "physical", "linear")
HEADING = basis.terms(["cos(psi)", "sin(psi)"])
SETTLE_S = 10.0  # after this time the unknown initial state of the lag has no effect
FREQUENCIES = np.geomspace(0.3, 20.0, 9)  # [rad/s] grid of the first search
DAMPINGS = np.geomspace(0.3, 2.0, 4)
SETTLING_PERIODS = 0.5  # periods of the cut-off after which a filter has forgotten where it began
BLOCK_ROWS = 2048  # rows in a block of a product or a factorisation
BLOCK_SAMPLES = 8192  # samples that are evaluated together
FEW_VALUES = 2**17  # values that are filtered together
NOTHING_LEFT = 1e-12  # fraction of the force below which the residual is rounding
NOTHING_PUSHES = 1e-12  # of the largest power of the forces in any direction, each of size one
Refinement = Literal["free_run", "none"]


@dataclass(frozen=True, eq=False)
class Samples:
    """Regressors and lack of fit of one recording."""

    terms: tuple[Term, ...]
    phi: Array  # (N, n_terms)
    epsilon: Array  # (N, n_dof) [N, Nm]
    force: Array  # (N, n_dof) [N, Nm], what epsilon was formed with
    file: NDArray[np.int64] | None = None  # (N,)

    def __len__(self) -> int:
        return len(self.phi)

    def on(self, terms: tuple[Term, ...]) -> "Samples":
        """The same samples over some of their terms."""
        columns = [self.terms.index(term) for term in terms]
        return replace(self, terms=terms, phi=self.phi.T[columns].T)

    @property
    def constant(self) -> int | None:
        """Index of the term 1, the intercept; None if it is not in the basis."""
        return self.terms.index(CONSTANT) if CONSTANT in self.terms else None


@dataclass(frozen=True)
class ResidualOptions(Identifier):
    """Data options of the identifiers of a residual table.

    `basis` is one of NAMED_BASES or a list of terms (`choose_basis`). `force` is that of the
    residual (null: filtered if the thruster lag is known, else actual if that is recorded, else
    commanded). `lowpass_hz: auto` chooses the zero-phase low-pass filter of velocity, acceleration
    and force, and another of the regressors, by the noise of the recording (`smoothing`).
    """

    basis: str | tuple[str, ...]
    extra_terms: tuple[str, ...]
    force: Force | None
    lowpass_hz: Positive | Literal["auto"] | None
    thruster: Literal["known", "estimated", "none"]
    inertia_factor: Annotated[float, Gt(1)] | None
    refinement: Refinement
    segment_s: Positive | None
    tune: dict[str, tuple[Any, ...]] | None

    def __post_init__(self) -> None:
        check_ranges(self)
        for name, choices in (self.tune or {}).items():
            if not choices:
                raise ConfigurationError(f"tune.{name}: got no values, expected at least one")
        ResidualOptions.alternatives(self, None)  # each is checked
        if isinstance(self.basis, str) and self.basis not in NAMED_BASES:
            raise ConfigurationError(
                f"basis: got {self.basis!r}, expected {', '.join(NAMED_BASES)} or a list of terms"
            )
        basis.terms(() if isinstance(self.basis, str) else self.basis)
        basis.terms(self.extra_terms)
        if self.thruster == "estimated" and self.force not in (None, "filtered"):
            got = f"force must be filtered or null, got {self.force}"
            raise ConfigurationError(f"thruster=estimated filters the command: {got}")
        if self.thruster == "none" and self.force == "filtered":
            raise ConfigurationError("force=filtered needs a thruster lag, got thruster=none")

    @property
    def noise_remedies(self) -> tuple[str, ...]:
        """Options that noise in the regressors biases less; empty if it does not bias these."""
        if self.refinement == "free_run":
            return ()
        smoother = () if self.lowpass_hz == "auto" else ("identifier.lowpass_hz=auto",)
        return (*smoother, "identifier=robust", "identifier=iv")

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for options that do not fit the vessel."""
        if self.force == "filtered" and thruster is None and self.thruster == "known":
            raise ConfigurationError(
                f"identifier.force=filtered: {nominal.name} has no known thruster lag"
            )
        if self.thruster == "estimated" and not nominal.forces_commanded:
            raise ConfigurationError(
                f"identifier.thruster=estimated filters a commanded force: {nominal.name} has "
                f"inputs ({', '.join(nominal.inputs)}), which are recorded as they act"
            )
        terms = choose_basis(self.basis, self.extra_terms, nominal)
        if not terms:
            raise ConfigurationError("identifier.basis: got no terms, expected at least one")
        known = {"1", *nominal.velocities, *nominal.accelerations, *basis.ATTITUDE, *nominal.inputs}
        known |= {*basis.AIR} if nominal.dofs == PLANAR else set()
        known |= {*basis.SPEED, basis.SIDESLIP} if {"surge", "sway"} <= {*nominal.dofs} else set()
        known |= {*basis.ANGLES} & {*poses_of(nominal.dofs)} if nominal.dofs != DOFS else set()
        for term in terms:
            for name in _variables(term) - known:
                inputs = f" with inputs {', '.join(nominal.inputs)}" if nominal.inputs else ""
                raise ConfigurationError(
                    f"identifier.basis: term {term} has {name}, but {nominal.name} moves in "
                    f"{', '.join(nominal.dofs)}{inputs}"
                )
            if term.name in nominal.accelerations and not nominal.forces_known:
                raise ConfigurationError(
                    f"identifier.basis: got {term}, but no force of {nominal.name} is known: the "
                    "inputs determine its coefficients relative to the inertia only"
                )

    def needs(self) -> Needs:
        """The force, the thruster lag if it must be known, and the low-pass filter."""
        lag = self.force == "filtered" and self.thruster == "known"
        cutoff = None if self.lowpass_hz == "auto" else self.lowpass_hz
        return Needs(self.force, lag, cutoff)

    def check_samples(self, training: Recording, nominal: Vessel) -> None:
        """Raise RecordingError if the low-pass filters leave too few samples for the terms."""
        super().check_samples(training, nominal)
        smoothing, count = self.smoothing(training), len(self.regressed(nominal))
        drop_s = DROP_S if smoothing.regressors_hz is None else 0.0
        filtered = training.lowpass(smoothing.signals_hz, drop_s)
        left = int(np.count_nonzero(kept(filtered, smoothing)))
        if left <= count + 1:
            raise RecordingError(
                f"got {left} samples for training after the low-pass filters, "
                f"expected at least {count + 2} for {count} terms"
            )

    @property
    def protected(self) -> bool:
        """Physical constraints and nominal equations where they predict better go together."""
        return self.inertia_factor is not None

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table, with the alternative that predicts best if there are any."""
        if alternatives := self.alternatives(problem):
            return best_of(alternatives, CrossValidation(problem, force=self.force), rng)
        return self.estimated(problem, rng)

    @abstractmethod
    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the options as they are; raises IdentificationError."""

    def quick(self) -> Identifier:
        """This identifier without refinement."""
        return replace(self, refinement="none")

    def alternatives(self, problem: Problem | None) -> dict[str, Self]:
        """The identifiers of every combination of the values of `tune`."""
        if not self.tune:
            return {}
        known, names = {field.name for field in fields(self)} - {"tune"}, list(self.tune)
        for name in set(names) - known:
            expected = f"expected options of the identifier: {', '.join(sorted(known))}"
            raise ConfigurationError(f"tune: got {name!r}, {expected}")
        tuned = {}
        for values in product(*self.tune.values()):
            name = f"[{', '.join(names)} = {', '.join(map(str, values))}]"
            tuned[name] = replace(self, **dict(zip(names, values, strict=True)), tune=None)
        return tuned

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel."""
        return choose_basis(self.basis, self.extra_terms, nominal)

    def regressed(self, nominal: Vessel) -> tuple[Term, ...]:
        """The terms that the regression has."""
        return self.terms(nominal)

    def smoothing(self, recording: Recording) -> Smoothing:
        """The low-pass filters for a recording."""
        if self.lowpass_hz != "auto":
            return Smoothing(self.lowpass_hz)
        return smoothing_for(recording.noise.cutoff_hz, recording.period_s)

    def lagged(self, recording: Recording, lag: SecondOrderLag | None) -> Recording:
        """The recording with the force filtered by the lag."""
        if self.thruster == "none":
            return replace(recording, tau_filtered=None)
        return recording.with_thruster(lag) if self.thruster == "estimated" else recording

    def filtered(
        self, recording: Recording, lag: SecondOrderLag | None, smoothing: Smoothing
    ) -> Recording:
        """The recording with the force filtered by the lag, after the filter of the signals.

        Where the regressors are filtered too, their filter drops the ends of the pieces.
        """
        drop_s = DROP_S if smoothing.regressors_hz is None else 0.0
        return self.lagged(recording, lag).lowpass(smoothing.signals_hz, drop_s)

    def samples(
        self, recording: Recording, nominal: Vessel, lag: SecondOrderLag | None,
        terms: tuple[Term, ...] | None = None,
    ) -> Samples:  # fmt: skip
        """Regressors and lack of fit; by default the terms but `dependent_accelerations`.

        Raises IdentificationError for values that are not finite or too few samples.
        """
        smoothing = self.smoothing(recording)
        filtered = self.filtered(recording, lag, smoothing)
        own = self.terms(nominal)
        dependent = [] if terms else dependent_accelerations(filtered, nominal, own, self.force)
        terms = terms or own
        parts = evaluated(
            filtered, lambda part: basis.evaluate(terms, part.variables()),
            lambda part: lack_of_fit(part, nominal, self.force),
            lambda part: reference_force(part, nominal, self.force),
        )  # fmt: skip
        phi, epsilon, force = (smoothed(filtered, each, smoothing) for each in parts)
        if recording.inputs is not None:  # terms of a constant one are multiples of others
            for name, values in zip(recording.input_names, recording.inputs.T, strict=True):
                if np.ptp(values) <= NOTHING_LEFT * np.max(np.abs(values)):
                    phi[:, [name in _variables(term) for term in terms]] = 0.0
        phi[:, [term in dependent for term in terms]] = 0.0
        file = None if filtered.file is None else filtered.file[kept(filtered, smoothing)]
        samples = Samples(terms, phi, epsilon, force, file)
        if not (np.all(np.isfinite(phi)) and np.all(np.isfinite(epsilon))):
            raise IdentificationError("the training part has values that are not finite")
        if len(samples) <= len(terms) + 1:
            raise IdentificationError(
                f"the training part has {len(samples)} samples for {len(terms)} terms, "
                f"expected at least {len(terms) + 2}"
            )
        return samples


def dependent_accelerations(
    recording: Recording, nominal: Vessel, terms: tuple[Term, ...], force: str | None
) -> list[Term]:
    """Those of the terms that the others determine, since nothing ever pushes some way.

    Along w with w' tau = 0, as in sway of a vessel whose thrusters push ahead, 0 = w' F(nu_dot, nu)
    holds for any multiple of its coefficients, and all of them zero explain it best. The nominal
    coefficient of the acceleration that weighs most there is kept; the others are relative to it.
    """
    if not nominal.forces_known or not {*nominal.terms} <= {*terms}:
        return []
    pushed, own = recording.force(force), [DOFS.index(dof) for dof in nominal.dofs]
    if nominal.devices:
        (pushed,) = evaluated(
            recording, lambda part: device_forces(nominal.installed, part.variables())[:, own]
        )
    size = np.linalg.norm(pushed, axis=0)
    size[size == 0.0] = 1.0
    share, ways = np.linalg.eigh(pushed.T @ pushed / np.outer(size, size))
    unpushed = ways.T[share <= NOTHING_PUSHES * share[-1]] / size
    weights = np.abs(unpushed @ nominal.inertia) * np.std(recording.nu_dot, axis=0)
    return [basis.term(nominal.accelerations[k]) for k in np.argmax(weights, axis=1)]


def _variables(term: Term) -> set[str]:
    """The variables that a term multiplies, of the constant `1`."""
    return {basis.VARIABLES[code % basis.N_VARIABLES] for code in term.codes}


def turns(n: int, together: int | None = None) -> list[slice]:
    """Slices of n rows, `together` rows each (None: BLOCK_ROWS)."""
    rows = together or BLOCK_ROWS
    return [slice(a, min(a + rows, n)) for a in range(0, n, rows)]


def evaluated(filtered: Recording, *functions: Callable[[Recording], Array]) -> list[Array]:
    """Columns (N, k) of each function of single samples, evaluated in parts of the recording.

    The variables of a part fit into the cache. Each column is contiguous, as filters need it.
    """
    n, edges = len(filtered), np.arange(0, len(filtered) - 1, BLOCK_SAMPLES).tolist()
    results: list[Array] = []
    for a, b in pairwise([*edges, n]):
        values = [function(filtered.part(slice(a, b))) for function in functions]
        results = results or [np.empty((n, each.shape[1]), order="F") for each in values]
        for result, each in zip(results, values, strict=True):
            result[a:b] = each
    return results


def smoothed(filtered: Recording, columns: Array, smoothing: Smoothing) -> Array:
    """Columns (N, k) of a filtered recording after the filter of the regressors, in their place."""
    cutoff = smoothing.regressors_hz
    if cutoff is None:
        return columns
    few = max(FEW_VALUES // len(columns), 1)  # columns, so that not all of them are copied
    for a in range(0, columns.shape[1], few):
        columns[:, a : a + few] = filtered.lowpassed(columns[:, a : a + few], cutoff)
    inside = kept(filtered, smoothing)
    first, count = int(np.argmax(inside)), int(np.count_nonzero(inside))
    whole = slice(first, first + count)  # of a recording without a gap, where nothing is copied
    return columns[whole if np.all(inside[whole]) else inside]


def kept(filtered: Recording, smoothing: Smoothing) -> NDArray[np.bool_]:
    """Samples (N,) of a filtered recording that the filter of the regressors leaves."""
    if smoothing.regressors_hz is None:
        return np.ones(len(filtered), dtype=np.bool_)
    return filtered.interior(max(DROP_S, SETTLING_PERIODS / smoothing.regressors_hz))


def thruster_of(
    options: ResidualOptions, problem: Problem
) -> tuple[SecondOrderLag | None, tuple[Diagnostic, ...]]:
    """The thruster lag according to `options.thruster`, and the diagnostics of its estimation.

    The estimated one has the largest R^2, by a grid and the simplex method of Nelder and Mead, with
    HEADING in the basis for a constant force. Raises IdentificationError for too few samples.
    """
    if options.thruster != "estimated":
        return problem.thruster if options.thruster == "known" else None, ()
    training = problem.training
    terms = (*options.terms(problem.nominal), *HEADING)
    samples = options.samples(training, problem.nominal, SecondOrderLag(1.0, 1.0), terms)
    settled = round(SETTLE_S / training.period_s)
    if (count := len(samples)) < (fewest := settled + 2 * len(terms)):
        raise IdentificationError(
            f"thruster=estimated: the training part has {count} samples, expected {fewest} or more"
        )
    columns = samples.phi[settled:]
    size = np.sqrt(np.mean(columns**2, axis=0))
    u, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    u, fitted = u[:, s > 1e-10 * s[0]], (samples.force - samples.epsilon)[settled:]
    smoothing = options.smoothing(training)

    def unexplained(logs: Array) -> float:
        """Mean over dof of 1 - R^2 of the filtered force, for (log frequency, log damping)."""
        filtered = options.filtered(training, SecondOrderLag(*np.exp(logs)), smoothing)
        force = smoothed(filtered, filtered.force("filtered"), smoothing)[settled:]
        rest = force - fitted
        rest -= u @ (u.T @ rest)
        moves = np.var(force, axis=0) > 0.0
        if not np.any(moves):
            return 1.0
        ratios = np.mean(rest[:, moves] ** 2, axis=0) / np.var(force[:, moves], axis=0)
        return float(np.mean(ratios))

    grid = np.array([(np.log(w), np.log(d)) for w in FREQUENCIES for d in DAMPINGS])
    optimum = scipy.optimize.minimize(
        lambda logs: np.log(unexplained(np.clip(logs, -5.0, 6.0)) + NOTHING_LEFT),
        grid[int(np.argmin([unexplained(point) for point in grid]))],
        method="Nelder-Mead",
        options={"xatol": 1e-5, "fatol": 1e-6, "maxiter": 500},
    )
    lag = SecondOrderLag(*np.exp(np.clip(optimum.x, -5.0, 6.0)).tolist())
    return lag, (
        Diagnostic("thruster_natural_frequency", "all", lag.natural_frequency_rad_s, "rad/s"),
        Diagnostic("thruster_damping", "all", lag.damping),
    )
