"""Instrumental variables for second-order modulus models. Ljungberg (slides), after his thesis.

    theta = sol { (1/N) sum_k Z(k) (y(k) - Phi(k)' theta) = 0 }

Least squares is Z = Phi, biased by noise of the regressors for any length of the recording.
Instruments Z that are correlated with the motion but not with its noise make the estimate
consistent. Products such as (u + e)|u + e| still have a mean of e^2, which is constant while u
keeps its sign: hence the excitation has an offset and the instruments have zero mean.

    predictor   orientation_terms   wind_measurement
    LS1, IV1    false               false     bursts of wind and current without a mean
    LS2, IV2    true                false     a mean, slower than the vessel
    LS3, IV3    true                true      a mean, at times faster than the vessel

with `instruments: none` (LS) or `simulated` (IV). The instruments are the regressors of a model
that is simulated with the same inputs. In a recording under feedback the force depends on past
noise, but white noise at an instant is independent of a motion caused by earlier forces. The
heading is measured, not simulated: a simulated one drifts, and its sine and cosine would lose their
correlation with the true ones. The wind is the mean of the measured wind in NED.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.free_parameters import ned_forces
from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.identification.least_squares import LinearFit, check_distinguished, triangle
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
    turns,
)
from seatrial.models.identification.validation import DIVERGED_MULTIPLE
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import MOST_REPEATS, Positive
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.kinematics import in_body, in_ned
from seatrial.models.vessel.plant_table import Flags
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

SINGULAR_RATIO = 1e-10
WHAT = "instruments do not distinguish"
STEP_S = 0.1  # longest integration step of simulated instruments
WEAK = 0.1  # strength below which the estimate is little else than noise, and so are its intervals
REFINED = "the instruments are weak: refined by free runs; try fewer terms or a longer recording"
NO_INTERVALS = "the instruments are weak, free runs diverge: no standard errors; try fewer terms"


class Solution(NamedTuple):
    """An instrumental-variable fit of m targets y, in which theta is linear."""

    theta: Array  # (n_terms, m)
    inverse: Array  # (n_instruments, n_instruments) that makes the columns of z orthonormal
    share: Array  # (n_instruments, n_terms), theta = share' (z inverse)' y
    condition: float  # condition number of the scaled regressors projected on the instruments
    strength: float  # how much of the regressors the instruments explain, over what they do not


def solve(z: Array, phi: Array, y: Array, names: Sequence[str] = ()) -> Solution:
    """Two-stage least squares; z (N, n_instruments), phi (N, n_terms), y (N, m).

    theta = argmin |P (y - Phi theta)|^2 with the projection P on the instruments. With as many
    instruments as terms it solves Z'(y - Phi theta) = 0, and with Z = Phi it is least squares.
    The strength is the statistic of Cragg and Donald (1993): the least eigenvalue over all
    combinations of the terms, an F of the first stage. About 1 is that of instruments that have
    nothing to do with the motion, above 10 are strong ones (Stock and Yogo 2005). Raises
    IdentificationError, with the `names` of the terms, when the instruments do not determine theta.
    """
    (n, m), (a, b), own = y.shape, (z.shape[1], phi.shape[1]), z is phi
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
    inverse = np.asarray(np.linalg.inv(of_z[:a]), dtype=np.float64)
    missed = float(np.linalg.norm(of_phi[a:] @ share.T, 2)) ** 2
    strength = (n - a) / a / missed if missed > 0.0 else np.inf
    return Solution(share.T @ R[:a, -m:], inverse, share, float(s[0] / s[-1]), strength)


def solve_excited(samples: Samples, z: Array) -> tuple[LinearFit, float]:
    """The fit of the terms whose instruments and regressors vary, and its strength."""
    phi, n_terms = samples.phi, len(samples.terms)
    size = np.sqrt(np.einsum("nj,nj->j", z, z) / len(z))
    varies = (size > 1e-12 * np.max(size, initial=0.0)) & np.any(phi != 0.0, axis=0)
    used = np.flatnonzero(varies)
    if not len(used):
        raise IdentificationError(
            "the recorded force excites no term in the simulated motion, expected at least one"
        )
    columns = phi if len(used) == n_terms else phi[:, used]
    instruments = columns if z is phi else z[:, used]
    names = [str(samples.terms[i]) for i in used]
    found = solve(instruments, columns, samples.epsilon, names)
    n_dof = samples.epsilon.shape[1]
    theta, share = np.zeros((n_terms, n_dof)), np.zeros((len(found.share), n_terms))
    theta[used], share[:, used] = found.theta, found.share
    return LinearFit(
        samples.terms, theta, samples.epsilon - columns @ found.theta,
        lambda rows: instruments[rows] @ found.inverse, np.repeat(share[None], n_dof, axis=0),
        np.full(n_dof, float(len(used))), varies, found.condition,
    ), found.strength  # fmt: skip


def simulated_motion(
    recording: Recording, models: Sequence[Vessel], force: str | None, restart_s: float | None
) -> tuple[Recording, Flags, float]:
    """The recording with the simulated motion of a model in place of the measured one.

    The simulation starts at the measured state in every stretch without a gap, and again every
    `restart_s` [s]. These samples (N,), which are returned too, have measurement noise and cannot
    be instruments. Each stretch is simulated by the first of the models that can be; last is the
    share of the stretches in which that is the first. Raises IdentificationError when none can.
    """
    wind, first = None, stretch_starts(recording, restart_s)
    if recording.wind is not None:
        wind = np.mean(in_ned(recording.wind, recording.attitude[:, 2]), axis=0)
    begin, fastest = np.flatnonzero(first), DIVERGED_MULTIPLE * np.max(np.abs(recording.nu), axis=0)
    limits = np.maximum(fastest, 1e-3 * np.max(fastest) + 1e-12)
    nu, nu_dot = np.empty_like(recording.nu), np.empty_like(recording.nu)
    left, shares = np.full(len(begin), True), []
    for model in models:
        try:
            motion = _moved(recording, model, force, wind, first)
            inside = np.all(np.abs(motion[0]) <= limits, axis=1)
        except ConfigurationError as error:
            why, inside = f"cannot be simulated: {error}", np.full(len(first), False)
        else:
            why = "diverge under the recorded force or inputs: try a shorter restart_s"
        able = left & np.logical_and.reduceat(inside, begin)
        rows = np.repeat(able, np.diff(begin, append=len(first)))
        if np.any(able):
            nu[rows], nu_dot[rows] = (values[rows] for values in motion)
        left &= ~able
        shares.append(float(np.mean(able)))
        if not np.any(left):
            break
    else:
        raise IdentificationError(f"the instruments {why}")
    heading = recording.attitude[:, 2]
    air = None if wind is None else in_body(np.tile(wind, (len(heading), 1)), heading)
    return replace(recording, nu=nu, nu_dot=nu_dot, wind=air), first, shares[0]


def stretch_starts(recording: Recording, restart_s: float | None) -> Flags:
    """True (N,) where a stretch without a gap begins, or a part of it of `restart_s` [s]."""
    first = recording.piece_starts.copy()
    if restart_s is not None:
        length = max(round(restart_s / recording.period_s), 2)
        edges = [*np.flatnonzero(first).tolist(), len(first)]
        for a, b in pairwise(edges):
            first[a : max(b - length, a) + 1 : length] = True
    return first


def _moved(
    recording: Recording, model: Vessel, force: str | None, wind: Array | None, first: Flags
) -> tuple[Array, Array]:
    """Velocity and acceleration (N, n_dof) of a model from the measured states at `first` on.

    The force over a sample is the mean; a recorded acting one, which follows the command without
    lag, that at its end. Raises ConfigurationError for a model that cannot be simulated.
    """
    n, commanded, every = len(model.dofs), model.forces_commanded, 1
    model.plant_table()
    course = course_of(recording, None, None, None, np.inf, model.attitude)
    course, held = course._replace(restart=first), np.zeros_like(recording.nu)
    if commanded:  # in steps of a sample that are short enough, with a wind in NED
        at_end = recording.force(force) is recording.tau_actual
        held = recording.held_force(force)[:, 2 if at_end else 1]
        every = max(int(np.ceil(course.step_s / STEP_S - 1e-9)), 1)
        measured, reached, acting = (
            np.repeat(each, every, axis=0) for each in (course.measured, course.reached, held)
        )
        restart = np.zeros(len(acting), dtype=np.bool_)
        restart[::every] = first
        weather = course.weather._replace(wind_body=np.zeros((0, 2)))
        if wind is not None:
            weather = weather._replace(wind_ned=np.tile(wind, (len(acting), 1)))
        course = course._replace(
            acting=np.ascontiguousarray(np.repeat(acting[:, None], 3, axis=1)), weather=weather,
            measured=measured, reached=reached, start=reached, restart=restart,
            step_s=course.step_s / every,
        )  # fmt: skip
    with np.errstate(all="ignore"):
        motion = free_run(model, course, "rk4")[::every]
        nu, attitude = motion[:, n:], attitude_of(model.dofs, motion[:, :n])
        acting, air = np.zeros_like(nu), recording.wind
        if commanded:  # the acceleration is that before a command takes effect
            acting[1:] = held[:-1]
            acting[first] = 0.0
            air = None if wind is None else in_body(np.tile(wind, (len(nu), 1)), attitude[:, 2])
        moved = replace(recording, nu=nu, attitude=attitude, wind=air, tau=acting)
        (nu_dot,) = evaluated(
            moved, lambda at: model.forward(at.tau, at.nu, at.attitude, at.wind, at.inputs)
        )
    return nu, nu_dot


@dataclass(frozen=True)
class InstrumentalVariables(ResidualOptions):
    """Instrumental variables on the lack of fit, with instruments from a simulated motion."""

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
            dofs = ", ".join(nominal.dofs)
            raise ConfigurationError(
                f"identifier.wind_measurement needs a vessel in {', '.join(PLANAR)}, got {dofs}"
            )
        if self.wind_measurement and measured:
            why = "the recorded file has no wind"
            raise ConfigurationError(f"identifier.wind_measurement=true: {why}")
        for term in filter(_in_air, super().terms(nominal)):
            if self.wind_measurement is False or measured:
                raise ConfigurationError(f"identifier.basis: {term} needs wind_measurement=true")
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
        """These options with the wind terms where the recording has a wind."""
        windy = problem.nominal.dofs == PLANAR and problem.training.wind is not None
        return replace(self, wind_measurement=windy)

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table with standard errors and the strength of the instruments."""
        if self.wind_measurement is None:
            return self.with_wind(problem).estimated(problem, rng)
        lag, diagnostics = thruster_of(self, problem)
        samples, fitted, strength, about = self.estimate(problem, lag)
        residual = fitted.residual(problem.nominal.dofs)
        model = problem.nominal + residual
        if self.inertia_factor is None:
            least = float(np.min(np.linalg.eigvals(model.inertia).real))
            if least <= 0.0:
                raise IdentificationError(
                    f"the instruments are too weak: the identified inertia has an eigenvalue of "
                    f"{least:.3g}: try orientation_terms=true or a shorter restart_s"
                )
        consistent = not problem.compared and self.instruments != "none"
        weak = consistent and self.inertia_factor is not None and strength < WEAK
        errors, spread = None, None
        if not (problem.compared or weak):
            errors, spread = fitted.standard_errors(), fitted.spread()
        result = Identified(model, residual, errors, (*diagnostics, *about), spread=spread)
        if not consistent:
            return finished(self, problem, lag, samples, result)
        refinements: tuple[Refinement, ...] = ("none", "free_run")  # until one can be simulated
        if self.refinement != "none":
            refinements = (self.refinement,)
        for refinement in refinements[:: -1 if weak else 1]:
            options = replace(self, refinement=refinement)
            final = finished(options, problem, lag, samples, result)
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
        with suppress(IdentificationError):
            simulated_motion(problem.training, [model], self.force, self.restart_s)
            return True
        return False

    def estimate(
        self, problem: Problem, lag: SecondOrderLag | None
    ) -> tuple[Samples, LinearFit, float, tuple[Diagnostic, ...]]:
        """The samples, the fit, the strength of its instruments, and diagnostics.

        The first instruments are from the nominal model, then from each estimate, where it can be
        simulated. The iterations end where it can be nowhere; the last estimate is kept.
        """
        if self.wind_measurement and problem.training.wind is None:
            raise IdentificationError("wind_measurement=true: the recording has no measured wind")
        samples, dofs = self.samples(problem.training, problem.nominal, lag), problem.nominal.dofs
        if self.instruments == "none":
            fitted, strength = solve_excited(samples, samples.phi)
            return samples, fitted, strength, fitted.diagnostics(dofs)
        models = [problem.nominal]
        instruments, same_sign, _ = self.columns(problem, models, lag)
        (fitted, strength), count = solve_excited(samples, instruments), 0
        for _ in range(self.iterations):
            models.insert(0, problem.nominal + fitted.residual(dofs))
            try:
                instruments, same_sign, newest = self.columns(problem, models, lag)
                if newest == 0.0:
                    break
                fitted, strength = solve_excited(samples, instruments)
            except IdentificationError:
                break
            count += 1
        shares = zip(dofs, same_sign.tolist(), strict=True)
        return samples, fitted, strength, (
            Diagnostic("iterations", "all", float(count)),
            Diagnostic("instrument_strength", "all", strength),
            *(Diagnostic("same_sign", dof, share) for dof, share in shares),
            *fitted.diagnostics(dofs),
        )  # fmt: skip

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
