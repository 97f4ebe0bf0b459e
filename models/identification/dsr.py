"""Deterministic and stochastic subspace identification of a vessel from its pose and force.

The output is the pose, the input is the force, held between the samples; `subspace` identifies the
states of the model. The dynamics of a vessel depend on the heading in NED but not in body axes, so
the default output is the pose in body axes: the sum of the measured increments R(psi)' delta eta
(psi half-way), whose rate is the body velocity. Near one heading it is the rotated NED pose.

Such a linear model has inertia and linear damping about the mean motion. Quadratic damping and
Coriolis forces become noise, and a constant force biases all coefficients. `extra_terms` add such
forces as known inputs: the model stays linear in their coefficients.
Bargouth (2022), section 3.7; Di Ruscio (2009).
"""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge

from seatrial.models.demand import FINDING, FLOPS, NUMBER, Demand, Extent, amount
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.physical_form import PhysicalForm, physical_form
from seatrial.models.identification.problem import Identified, Identifier, Needs, Problem
from seatrial.models.identification.sampled_data import Output, Sampled, sampled
from seatrial.models.identification.state_space_findings import (
    fit_findings,
    model_findings,
    physical_findings,
    realisation_findings,
)
from seatrial.models.identification.subspace import Realisation, identify_innovations
from seatrial.models.identification.uncertainty import check_bootstrap
from seatrial.models.notation import ACCELERATIONS, VELOCITIES
from seatrial.models.ranges import NotNegativeInt, Positive, PositiveInt, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, Array, Codes, Term
from seatrial.models.vessel.kinematics import rotation
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag


@dataclass(frozen=True)
class Dsr(Identifier):
    """DSR with L rows in the Hankel matrices and J past samples.

    `order` is a number, `physical` (two states a degree of freedom) or `gap` (the largest gap of
    the singular values). `variant: closed` (dsr_e) holds with and without feedback, `open` only
    without. `extra_terms: physical` are the nonlinear terms of the nominal model.
    `physical_form: optional` keeps the nominal model if there is no physical form, with the
    reason as a finding, so that the state-space model can still be used.
    """

    L: Annotated[int, Ge(2)]
    J: PositiveInt
    order: PositiveInt | Literal["physical", "gap"]
    variant: Literal["closed", "open"]
    output: Output
    heading_span_deg: Positive  # of `output: pose`, which holds near one heading only
    force: Literal["commanded", "filtered", "actual"] | None
    extra_terms: tuple[str, ...] | Literal["physical"]  # further inputs beside the force
    period_s: Positive | None
    physical_form: Literal["required", "optional"]
    condition_limit: Positive
    markov_parameters: NotNegativeInt
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        check_ranges(self)
        for term in () if self.extra_terms == "physical" else basis.terms(self.extra_terms):
            if not is_further_input(term):
                raise ConfigurationError(
                    f"extra_terms: got {term}, expected a term that varies; accelerations "
                    f"and velocities are in the model already"
                )
        check_bootstrap(self.bootstrap, self.block_s)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for an order without physical form or an unknown force."""
        states = 2 * len(nominal.dofs)
        if self.physical_form == "required" and self.order not in (states, "physical", "gap"):
            raise ConfigurationError(
                f"identifier.order: got {self.order}, but {nominal.name} has {states} states; "
                f"use order={states} or identifier.physical_form=optional"
            )
        order, most = self._order(nominal) or 1, self.L * len(nominal.dofs)
        if order > most:
            raise ConfigurationError(
                f"identifier.order: got {order}, expected at most L x outputs = {most}"
            )
        if self.force == "filtered" and thruster is None:
            raise ConfigurationError(
                "identifier.force: got filtered, but the thruster lag is not known"
            )

    def needs(self) -> Needs:
        """The force of the input."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def model_period_s(self, sample_time_s: float) -> float:
        """The identifier's period [s] if it is set, else that of the recording."""
        return self.period_s or sample_time_s

    def demands(self, extent: Extent) -> list[Demand]:
        """The triangular factor of the Hankel matrices, for the estimate and every replicate."""
        rows = (self.L + self.J + 1.0) * 3 * extent.n_dof  # force, motion and innovations
        samples = extent.samples * extent.period_s / self.model_period_s(extent.period_s)
        option = "L" if self.L > self.J else "J"
        detail = f"a factor of {amount(rows)} x {amount(rows)} numbers"
        once = samples * rows**2 / FLOPS
        factor = Demand(option, getattr(self, option), detail, once, 4 * NUMBER * rows**2)
        demands = [factor]
        if self.bootstrap is not None:
            detail = f"{amount(self.bootstrap)} factors of {amount(rows)} x {amount(rows)} numbers"
            memory = self.bootstrap * 10 * NUMBER * extent.n_terms * extent.n_dof
            demands.append(
                Demand("bootstrap", self.bootstrap, detail, self.bootstrap * once, memory)
            )
        numbers = self.markov_parameters * float(extent.n_dof) ** 2
        detail = f"{amount(numbers)} numbers in the results"
        memory = FINDING * numbers
        demands.append(Demand("markov_parameters", self.markov_parameters, detail, numbers, memory))
        return demands

    def without_bootstrap(self) -> Identifier:
        """This identifier without bootstrap replicates."""
        return replace(self, bootstrap=None)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the state-space model and the vessel of its physical form.

        Raises IdentificationError when the data do not determine the model, or when it has no
        physical form and that is required.
        """
        nominal, dofs = problem.nominal, problem.nominal.dofs
        data = self._sampled(problem.training, nominal)
        realisation = self._realise(data, self._order(nominal))
        model, errors = realisation.model, None
        findings = realisation_findings(realisation)
        try:
            form = self._physical(model, data)
            model = _rotate_outputs(form.model, data.heading)
            vessel = form.vessel("identified", dofs, data.extra)
            findings += physical_findings(form, dofs)
            errors = self._standard_errors(data, model.order, vessel - nominal, rng)
        except IdentificationError as error:
            if self.physical_form == "required":
                raise
            vessel = replace(nominal, name="identified")
            findings.append(Finding("physical_form", "all", 0.0, label=str(error)))
        findings += model_findings(model, self.markov_parameters, dofs)
        findings += fit_findings(model, self._sampled(problem.validation, nominal), dofs)
        control_model = _force_inputs_only(model, len(dofs))
        return Identified(
            vessel, vessel - nominal, errors, tuple(findings), state_space=model,
            control_model=control_model,
        )  # fmt: skip

    def _extra(self, nominal: Vessel) -> tuple[Term, ...]:
        if self.extra_terms != "physical":
            return basis.terms(self.extra_terms)
        return tuple(term for term in nominal.terms if is_further_input(term) and moves(term))

    def _sampled(self, recording: Recording, nominal: Vessel) -> Sampled:
        span = np.radians(self.heading_span_deg)
        extra = self._extra(nominal)
        return sampled(recording, self.force, extra, self.output, self.period_s, span)

    def _order(self, nominal: Vessel) -> int | None:
        orders = {"physical": 2 * len(nominal.dofs), "gap": None}
        return orders[self.order] if isinstance(self.order, str) else self.order

    def _realise(self, data: Sampled, order: int | None, times: Codes | None = None) -> Realisation:
        realisation = identify_innovations(
            data.y, data.u, self.L, self.J, order, self.variant,
            period_s=data.period_s, stretch=data.stretch, times=times,
        )  # fmt: skip
        model = replace(realisation.model, inputs=data.inputs, outputs=data.outputs)
        return replace(realisation, model=model)

    def _physical(self, model: StateSpace, data: Sampled) -> PhysicalForm:
        """The physical form in body axes; a NED pose is first rotated to the mean heading."""
        return physical_form(_rotate_outputs(model, -data.heading), self.condition_limit)

    def _standard_errors(
        self, data: Sampled, order: int, residual: Vessel, rng: np.random.Generator
    ) -> Array | None:
        """Standard errors by block bootstrap, shape of residual.theta; NaN: not estimated."""
        if self.bootstrap is None:
            return None
        count = max(round(len(data.y) * data.period_s / self.block_s), 2)
        blocks = np.array_split(np.arange(len(data.y)), count)
        tables = []
        for _ in range(self.bootstrap):
            times = np.concatenate([blocks[i] for i in rng.integers(count, size=count)])
            try:
                form = self._physical(self._realise(data, order, times).model, data)
                tables.append(form.vessel("replicate", residual.dofs, data.extra))
            except IdentificationError:
                continue  # a replicate may not excite the vessel enough
        errors = np.full(residual.theta.shape, np.nan)
        if 2 * len(tables) >= self.bootstrap:
            rows = [residual.terms.index(term) for term in tables[0].terms]
            errors[rows] = np.std([table.theta for table in tables], axis=0, ddof=1)
        return errors


def _force_inputs_only(model: StateSpace, count: int) -> StateSpace:
    """The model with the first `count` inputs, the forces, alone, for a controller."""
    B, D, inputs = model.B[:, :count], model.D[:, :count], model.inputs[:count]
    return replace(model, B=B, D=D, inputs=inputs)


def _rotate_outputs(model: StateSpace, psi: float) -> StateSpace:
    """The model with its first two outputs rotated by psi [rad] about the down axis."""
    if psi == 0.0:
        return model
    R = np.eye(len(model.C))
    R[:2, :2] = rotation(psi)[:2, :2]
    K = None if model.K is None else model.K @ R.T
    F = None if model.F is None else R @ model.F
    return replace(model, C=R @ model.C, D=R @ model.D, K=K, F=F)


def is_further_input(term: Term) -> bool:
    """Whether a term can be an additional input: it varies and is not already in the model."""
    names = {basis.VARIABLES[code % basis.N_VARIABLES] for code in term.codes if code}
    return bool(names) and not names & set(ACCELERATIONS) and term.name not in VELOCITIES


def moves(term: Term) -> bool:
    """Whether a term contains a velocity; a term of the attitude alone is part of the stiffness."""
    return any(
        basis.VARIABLES[code % basis.N_VARIABLES] in (*VELOCITIES, *AIR) for code in term.codes
    )
