"""Identification with a prior and physical constraints: structure, weights, free runs.

1. The free parameters of the nominal model are found by a regression with a prior about the
   nominal values and physical constraints (`structured`), on smoothed signals (`smoothing`).
2. They are refined by free runs over segments whose initial velocities are free
   (`free_run_fit`).
3. Both are repeated with a force that is constant in NED, and with windage where the wind was
   measured. Free runs over blocks left out choose among them (`cross_validation`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.free_parameters import (
    WINDAGE,
    FreeParameters,
    free_parameters,
    nonzero_labels,
)
from seatrial.models.identification.free_run_fit import refined_by_segments
from seatrial.models.identification.input_terms import input_labels
from seatrial.models.identification.problem import Identified, Needs, Problem
from seatrial.models.identification.residual import ResidualOptions, Samples, thruster_of
from seatrial.models.identification.structured import structure
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

Choice = Literal["none", "ned_force", "windage", "both"]
DISTURBANCES: tuple[Choice, ...] = ("none", "ned_force", "windage", "both")  # the simplest first
MIN_SAMPLES = 40  # samples
SLIGHT = 0.1  # of the force that the nominal model needs: other forces moved the vessel


@dataclass(frozen=True)
class Robust(ResidualOptions):
    """Structured regression with a prior and constraints, refined by free runs over segments.

    The terms of `basis` that the nominal model has are free where it has them, the others in every
    degree of freedom. `disturbance`: none, ned_force (north, east), windage, or auto by
    cross-validation. `prior` is the standard deviation of a parameter over its nominal size. With
    `refinement: none` the regression is the result. `input_terms` adds terms of the inputs beside
    the devices of the vessel (`input_terms`).
    """

    disturbance: Choice | Literal["auto"]
    prior: Positive
    input_terms: bool = False

    @property
    def interval_covers(self) -> bool:
        """Refined parameters have the noise in the output alone."""
        return self.refinement == "free_run"

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for options that do not fit the vessel."""
        super().check(nominal, thruster, measured)
        if self.input_terms and not input_labels(nominal, windy=False):
            raise ConfigurationError(
                f"identifier.input_terms: {nominal.name} has no devices whose inputs have terms"
            )
        if self.disturbance in DISTURBANCES[2:] and nominal.dofs != PLANAR:
            raise ConfigurationError(
                f"identifier.disturbance={self.disturbance} needs a vessel in {', '.join(PLANAR)}, "
                f"got one in {', '.join(nominal.dofs)}"
            )

    def needs(self) -> Needs:
        """The data of the residual, and enough samples for the folds."""
        return super().needs()._replace(samples=MIN_SAMPLES)

    def regressed(self, nominal: Vessel) -> tuple[Term, ...]:
        """The terms of the nominal model and those of the basis."""
        return self.free(nominal).nominal.terms

    def alternatives(self, problem: Problem) -> dict[str, Self]:
        """The choices of disturbance terms, and those of `tune`."""
        tuned = super().alternatives(problem)
        if self.disturbance != "auto":
            return tuned
        windy = problem.nominal.dofs == PLANAR and problem.training.wind is not None
        names = DISTURBANCES if windy else DISTURBANCES[:2]
        return {
            f"{variant}[{name}]": replace(base, disturbance=name)
            for variant, base in (tuned or {"": self}).items()
            for name in (names if base.disturbance == "auto" else (base.disturbance,))
        }

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the table, refined if that is asked for.

        Raises IdentificationError where the recorded force moved no axis.
        """
        lag, diagnostics = thruster_of(self, problem)
        training, windy = problem.training, problem.training.wind is not None
        free = self.free(problem.nominal, (), windy)
        samples = self.samples(training, free.nominal, lag, free.nominal.terms)
        unexcited = unexcited_axes(samples, problem.nominal)
        if unexcited:
            free = self.free(problem.nominal, unexcited, windy)
        model = structure(free, samples, training.nu, self.inertia_factor)
        change, active = model.regress(self.prior)
        diagnostics += (Diagnostic("smoothing", "all", self.smoothing(training).signals_hz, "Hz"),)
        errors, spread = None, None
        if self.refinement == "free_run":
            refined = refined_by_segments(self, training, lag, model, change, self.prior)
            change, active = refined.change, refined.active
            if not problem.compared:
                errors, spread = free.std_error(refined.covariance), refined.spread(problem.nominal)
            diagnostics += (Diagnostic("evaluations", "all", float(refined.evaluations)),)
        residual = free.residual(free.values + change)
        diagnostics += tuple(
            Diagnostic("active_constraint", "all", 1.0, label=name) for name in active
        )
        diagnostics += tuple(Diagnostic("not_excited", dof, 1.0) for dof in unexcited)
        return Identified(problem.nominal + residual, residual, errors, diagnostics, spread=spread)

    def free(
        self, nominal: Vessel, kept: Sequence[str] = (), windy: bool = False
    ) -> FreeParameters:
        """The free parameters, with those of the disturbance; `windy`: the wind was measured.

        Degrees of freedom that are `kept` keep their equations.
        """
        terms = self.terms(nominal)
        dofs = [dof for dof in nominal.dofs if dof not in kept]
        own = [
            label
            for label, term in nonzero_labels(nominal, "tied")
            if term in terms and label.partition(".")[0] in dofs
        ]
        new = [f"{dof}.{term}" for term in terms if term not in nominal.terms for dof in dofs]
        windage = WINDAGE if self.disturbance in ("windage", "both") else ()
        inputs = input_labels(nominal, windy) if self.input_terms else []
        inputs = [label for label in inputs if label.partition(".")[0] in dofs]
        labels = dict.fromkeys([*own, *new, *windage, *inputs])
        ned_force = self.disturbance in ("ned_force", "both")
        return free_parameters(nominal, list(labels), "tied", ned_force, symmetric=True)


def unexcited_axes(samples: Samples, nominal: Vessel) -> list[str]:
    """Degrees of freedom whose motion was caused by other forces than the recorded one.

    There the recorded force is far below what the nominal model needs for the motion, and the
    smallest coefficients fit best. No force at all, as of a rudder ship in sway, says nothing.
    Raises IdentificationError where these are all.
    """
    if not nominal.forces_commanded:
        return []
    given, needed = np.std([samples.force, samples.force - samples.epsilon], axis=1)
    slight = (given > 0.0) & (given < SLIGHT * needed)
    if np.all(slight):
        raise IdentificationError(
            f"the recorded force is below {100.0 * SLIGHT:.0f} % of what the nominal model needs "
            "for the motion on every axis: other forces moved the vessel, or its unit is wrong"
        )
    return [nominal.dofs[k] for k in np.flatnonzero(slight)]
