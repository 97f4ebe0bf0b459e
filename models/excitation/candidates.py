"""Candidate manoeuvres, simulated with a nominal model in calm water, and the resulting mix."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.information import (
    Integers,
    Weights,
    information,
    inseparable,
    largest_remainder,
    log_det,
    optimal,
    scaled,
)
from seatrial.models.excitation.missions import Mission
from seatrial.models.excitation.schedule import Gains, Phase, Role, Schedule
from seatrial.models.ranges import NotNegativeInt, check_ranges
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather

STEP_S = 0.1  # longest integration step of the design's simulations


@dataclass(frozen=True)
class UncertainModel:
    """The model for the design of a mix; `error` is the relative error of its coefficients."""

    error: float
    seed: NotNegativeInt

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 0.0 <= self.error < 1.0:
            raise ConfigurationError(f"error must lie between 0 and 1, got {self.error}")

    def model(self, nominal: Vessel) -> Vessel:
        """The nominal model with coefficients multiplied by uniform numbers about one."""
        rng = np.random.default_rng(self.seed)
        factors = rng.uniform(1.0 - self.error, 1.0 + self.error, nominal.theta.shape)
        return replace(nominal, theta=nominal.theta * factors)


@dataclass(frozen=True, eq=False)
class CandidateSimulations:
    """Simulations of the candidates with the nominal model, and their information.

    Each candidate has `count` instants, followed by `stop` instants that bring the vessel to rest.
    """

    candidates: Mapping[str, Mission]
    plant: Plant  # the nominal model with the vessel's thrusters and limits
    terms: tuple[Term, ...]
    gains: Gains
    limits: Array
    count: int
    stop: int
    period_s: float
    reference_filter: Reference

    def sub_experiment(self, name: str, role: Role) -> list[Phase]:
        """A candidate, followed by its stop; repeated calls give equal forces."""
        mission, dofs = self.candidates[name], self.plant.vessel.dofs
        t = self.period_s * np.arange(self.count, dtype=np.float64)
        rng = np.random.default_rng(list(self.candidates).index(name))
        force, pieces = mission.force(t, dofs, rng), mission.pieces(self.period_s)
        manoeuvre = Phase(name, "manoeuvre", self.count, role, force, pieces)
        return [manoeuvre, Phase(name, "stop", self.stop)]

    def schedule(self, phases: Sequence[Phase]) -> Schedule:
        """Parts one after the other."""
        return Schedule(phases, self.period_s)

    def voyage(self, name: str) -> Voyage:
        """Simulate a candidate and its stop in calm water, from rest at the origin."""
        plan = self.schedule(self.sub_experiment(name, "training"))
        still = np.zeros((len(plan), len(self.plant.vessel.dofs)))
        try:
            return sail(
                self.plant, Weather(still, still, still, still), (Timetable(still), np.zeros(1)),
                self.reference_filter.table(self.period_s), plan.steering(self.gains, self.limits),
                still[0], self.period_s, min(STEP_S, self.period_s), added=plan.force(),
            )  # fmt: skip
        except (Diverged, ConfigurationError) as error:
            raise ConfigurationError(
                f"excitation.candidates.{name}: simulation of the nominal model failed: {error}"
            ) from error

    @cached_property
    def voyages(self) -> dict[str, Voyage]:
        """The simulation of every candidate with the nominal model."""
        return {name: self.voyage(name) for name in self.candidates}

    @cached_property
    def gammas(self) -> Array:
        """Scaled information of every candidate without its stop, shape (Q, n, n)."""
        matrices = []
        for voyage in self.voyages.values():
            log = voyage.log
            attitude = np.zeros((self.count, 3))
            attitude[:, 2] = log.eta[: self.count, 2]
            x = basis.variables(
                log.nu_dot[: self.count], log.nu[: self.count], attitude, voyage.dofs
            )
            matrices.append(information(basis.evaluate(self.terms, x)))
        return scaled(np.array(matrices))

    @cached_property
    def weights(self) -> Weights:
        """The optimal shares of the candidates."""
        return optimal(self.gammas, [term.name for term in self.terms])

    def counts(self, total: int) -> Integers:
        """The optimal mix in whole sub-experiments, shape (Q,)."""
        counts = largest_remainder(self.weights.share, total)
        terms = [term.name for term in self.terms]
        names = inseparable(np.tensordot(counts / total, self.gammas, axes=1), terms)
        if names:
            raise ConfigurationError(
                f"excitation.sub_experiments: {total} of the optimal mix do not separate "
                f"{', '.join(names)}, expected more"
            )
        return counts

    def log_det(self, counts: Array | Integers) -> float:
        """log det of the mean information of a mix; -inf where it is singular."""
        return log_det(self.gammas, np.asarray(counts, dtype=np.float64) / float(np.sum(counts)))
