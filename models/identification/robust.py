"""Identification with a prior and physical constraints: structure, weights, free runs.

1. The free parameters of the nominal model are found by a regression with a prior about the
   nominal values and physical constraints (`structured`), on smoothed signals (`smoothing`).
2. They are refined by free runs over segments whose initial velocities are free (`free_run_fit`).
3. Both are repeated with a force that is constant in NED, and with windage where the wind was
   measured. Free runs over blocks left out choose among them (`cross_validation`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np

from seatrial.models.diagnostics import NOT_EXCITED, Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.free_parameters import (
    WINDAGE,
    FreeParameters,
    free_parameters,
    nonzero_labels,
)
from seatrial.models.identification.free_run_fit import refined
from seatrial.models.identification.problem import Identified, Needs, Problem
from seatrial.models.identification.residual import ResidualOptions, Samples, thruster_of
from seatrial.models.identification.structured import Structure
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import Term
from seatrial.models.vessel.devices.device import device_forces
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

Choice = Literal["none", "ned_force", "windage", "both"]
DISTURBANCES: tuple[Choice, ...] = ("none", "ned_force", "windage", "both")  # the simplest first
MIN_SAMPLES = 40  # samples
SHAFT, ANGLE, SIGNAL = "n", "delta", "pwm"  # of which the names of inputs are made
AIR = {"surge": ("V_qu_q",), "sway": ("V_qv_q", "u_qv_q"), "yaw": ("V_qv_q", "u_qv_q")}
SLIGHT = 0.1  # of the force that the nominal model needs: other forces moved the vessel


@dataclass(frozen=True)
class Robust(ResidualOptions):
    """Structured regression with a prior and constraints, refined by free runs over segments.

    The terms of `basis` that the nominal model has are free where it has them, the others in every
    degree of freedom. `prior` is the standard deviation of a parameter over its nominal size.
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
            needed = f"needs a vessel in {', '.join(PLANAR)}, got one in {', '.join(nominal.dofs)}"
            raise ConfigurationError(f"identifier.disturbance={self.disturbance} {needed}")

    def needs(self) -> Needs:
        """The data of the residual, and enough samples for the folds."""
        return super().needs()._replace(samples=MIN_SAMPLES)

    def regressed(self, nominal: Vessel) -> tuple[Term, ...]:
        """The terms of the nominal model and those of the basis."""
        return self.free(nominal).nominal.terms

    def alternatives(self, problem: Problem | None) -> dict[str, Self]:
        """The choices of disturbance terms, and those of `tune`."""
        tuned = super().alternatives(problem)
        if self.disturbance != "auto" or problem is None:
            return tuned
        windy = problem.nominal.dofs == PLANAR and problem.training.wind is not None
        names = DISTURBANCES if windy else DISTURBANCES[:2]
        return {
            f"{variant}[{name}]": replace(base, disturbance=name)
            for variant, base in (tuned or {"": self}).items()
            for name in (names if base.disturbance == "auto" else (base.disturbance,))
        }

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the table; raises IdentificationError where the force moved no axis."""
        lag, diagnostics = thruster_of(self, problem)
        training, windy = problem.training, problem.training.wind is not None
        free = self.free(problem.nominal, (), windy)
        samples = self.samples(training, free.nominal, lag, free.nominal.terms)
        if unexcited := unexcited_axes(samples, problem.nominal):
            free = self.free(problem.nominal, unexcited, windy)
        model = Structure(free, samples, training.nu, self.inertia_factor)
        change, active = model.regress(self.prior)
        diagnostics += (Diagnostic("smoothing", "all", self.smoothing(training).signals_hz, "Hz"),)
        diagnostics += tuple(Diagnostic(NOT_EXCITED, dof, 1.0) for dof in unexcited)
        residual = free.residual(free.values + change)
        result = Identified(problem.nominal + residual, residual, diagnostics=diagnostics)
        if self.refinement == "free_run":
            return refined(self, problem, lag, model, change, self.prior, result)
        rows = (Diagnostic("active_constraint", "all", 1.0, label=name) for name in active)
        return replace(result, diagnostics=(*diagnostics, *rows))

    def free(
        self, nominal: Vessel, kept: Sequence[str] = (), windy: bool = False
    ) -> FreeParameters:
        """The free parameters, with those of the disturbance; `windy`: the wind was measured.

        Degrees of freedom that are `kept` keep their equations.
        """
        terms = self.terms(nominal)
        dofs = [dof for dof in nominal.dofs if dof not in kept]
        own = [label for label, term in nonzero_labels(nominal, "tied") if term in terms]
        inputs = input_labels(nominal, windy) if self.input_terms else []
        own, inputs = (
            [label for label in each if label.partition(".")[0] in dofs] for each in (own, inputs)
        )
        new = [f"{dof}.{term}" for term in terms if term not in nominal.terms for dof in dofs]
        windage = WINDAGE if self.disturbance in ("windage", "both") else ()
        labels = dict.fromkeys([*own, *new, *windage, *inputs])
        ned_force = self.disturbance in ("ned_force", "both")
        return free_parameters(nominal, list(labels), "tied", ned_force, symmetric=True)


def unexcited_axes(samples: Samples, nominal: Vessel) -> list[str]:
    """Degrees of freedom whose motion was caused by other forces than the recorded one.

    There the recorded force is far below what the nominal model needs for the motion. No force at
    all, as of a rudder ship in sway, says nothing. Raises IdentificationError where these are all.
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


def input_labels(nominal: Vessel, windy: bool) -> list[str]:
    """Labels `dof.term` of what the inputs may do beside the devices.

    The devices keep their nominal parameters. Where these are wrong, a table of the hull alone
    cannot make up for it; polynomials of the inputs can, as in the models of Abkowitz (1964):
    thrust is a quadratic form of n and u, a rudder in the slipstream acts with the square of a
    speed between those of ship and slipstream, a thruster in the directions in which it pushes. A
    model without devices has none, nor has one whose thrusters turn.
    """
    kinds = {name: name.partition("_")[0] for name in nominal.inputs}
    if not nominal.devices or not set(kinds.values()) <= {SHAFT, ANGLE, SIGNAL}:
        return []
    shafts = [name for name, kind in kinds.items() if kind == SHAFT]
    rest = np.zeros((len(kinds), len(nominal.dofs)))
    one_each = nominal.variables(rest, rest, inputs=np.eye(len(rest)))
    pushed = device_forces(nominal.installed, one_each)
    terms: dict[str, list[str]] = {dof: [] for dof in nominal.dofs}
    for dof in terms:
        ahead = dof == "surge"
        for n in shafts:
            terms[dof] += [f"|{n}|{n}", f"{n}^2"]
            terms[dof] += [f"u{n}", f"u|{n}|"] if ahead else []
        for p, force in zip(kinds, pushed[:, DOFS.index(dof)], strict=True):
            if kinds[p] == SIGNAL and force != 0.0:
                terms[dof] += [p, f"|{p}|{p}", f"u{p}"]
        for d in (name for name, kind in kinds.items() if kind == ANGLE):
            forms = ("{0}^2", "|{0}|{0}", "u{0}", "u|{0}|")[: 2 if ahead else 4]
            speeds = [form.format(n) for form in forms for n in shafts] or ["u^2"]
            terms[dof] += [f"{speed}{d}^2" if ahead else f"{speed}{d}" for speed in speeds]
        terms[dof] += AIR.get(dof, ()) if windy else ()
    return [f"{dof}.{term}" for dof, own in terms.items() for term in own]
