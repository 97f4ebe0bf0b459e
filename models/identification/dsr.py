"""Deterministic and stochastic subspace identification of a vessel from its pose and force.

The output is the pose, the input is the force, held between the samples; `subspace` identifies the
states of the model. The dynamics of a vessel depend on the heading in NED but not in body axes, so
the default output is the pose in body axes: the sum of the measured increments R(psi)' delta eta
(psi half-way), whose rate is the body velocity. Near one heading it is the rotated NED pose.

Such a linear model has inertia and linear damping about the mean motion. Quadratic damping and
Coriolis forces become noise, and a constant force biases all coefficients. `extra_terms` add such
forces as known inputs: the model stays linear in their coefficients.

`inputs` and `outputs` are other quantities of the recording, such as the velocity in place of the
pose. Such a model has no inertia or damping of its own: it is stored beside the nominal model.
Bargouth (2022), section 3.7; Di Ruscio (2009).
"""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.physical_form import PhysicalForm, physical_form
from seatrial.models.identification.problem import (
    Identified,
    Identifier,
    Needs,
    Problem,
    check_forces,
)
from seatrial.models.identification.sampled_data import (
    Output,
    Sampled,
    check_signals,
    is_further_input,
    moves,
    sampled,
    samples_in,
)
from seatrial.models.identification.state_space_diagnostics import (
    NAMES,
    Alternative,
    axes_of,
    fit_diagnostics,
    model_diagnostics,
    physical_diagnostics,
    realisation_diagnostics,
    select_variant,
)
from seatrial.models.identification.subspace import Realisation, identify_innovations
from seatrial.models.identification.uncertainty import check_bootstrap
from seatrial.models.identification.validation import RESTART_S, prediction
from seatrial.models.notation import POSES, poses_of
from seatrial.models.ranges import Positive, PositiveInt, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Codes, Term
from seatrial.models.vessel.kinematics import rotation
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

FORM_NEEDS = "all forces as the first inputs and the whole pose as output"


@dataclass(frozen=True)
class Dsr(Identifier):
    """DSR with L rows in the Hankel matrices and J past samples.

    `order` is a number, `physical` (two states for a pose, one for another output) or `gap` (the
    largest gap of the singular values). `variant: closed` (dsr_e) holds with and without feedback,
    `open` only without; `auto` lets the data choose, and so does `feedthrough` None, whether there
    is a direct term; a pose has none. `stable` moves poles outside the unit circle onto it.
    `inputs` are forces (`tau_surge`) and terms, None all forces; `extra_terms` follow, `physical`
    are the nonlinear terms of the nominal model. `outputs` are poses (`x`) and terms (`u`,
    `u_dot`), None the whole pose.

    `physical_form: optional` keeps the nominal model if there is no physical form, with the
    reason as a diagnostic, and controls with the state-space model; `better` keeps the nominal
    model also if it predicts restarts of 30 s of the training part better, and controls with it.
    """

    L: Annotated[int, Ge(2), Le(1000)]
    J: Annotated[int, Ge(1), Le(1000)]
    order: PositiveInt | Literal["physical", "gap"]
    variant: Literal["auto", "closed", "open"]
    feedthrough: bool | None  # whether D is estimated
    stable: bool
    inputs: tuple[str, ...] | None
    outputs: tuple[str, ...] | None
    output: Output
    heading_span_deg: Positive  # of `output: pose`, which holds near one heading only
    force: Literal["commanded", "filtered", "actual"] | None
    extra_terms: tuple[str, ...] | Literal["physical"]  # further inputs beside the force
    period_s: Positive | None
    physical_form: Literal["better", "required", "optional"]
    condition_limit: Positive
    markov_parameters: Annotated[int, Ge(0), Le(10_000)]
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
        for name, values in (("inputs", self.inputs), ("outputs", self.outputs)):
            if values is not None and len(set(values)) < max(len(values), 1):
                raise ConfigurationError(f"{name}: got {list(values)}, expected different names")
        if self.variant == "closed" and self.feedthrough:
            raise ConfigurationError(
                "feedthrough: got true with variant=closed, expected open or auto"
            )
        check_bootstrap(self.bootstrap, self.block_s)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for unknown signals, a wrong order or an unknown force."""
        check_forces("dsr", nominal)
        check_signals(self.inputs, self.outputs, nominal)
        states = 2 * len(nominal.dofs)
        if self._has_form(nominal.dofs):
            if self.physical_form != "optional" and self.order not in (states, "physical", "gap"):
                raise ConfigurationError(
                    f"identifier.order: got {self.order}, but {nominal.name} has {states} states; "
                    f"use order={states} or identifier.physical_form=optional"
                )
        elif self.physical_form == "required":
            raise ConfigurationError(
                f"identifier.physical_form: got required, but it needs {FORM_NEEDS}"
            )
        outputs = self.outputs or poses_of(nominal.dofs)
        order, most = self._order(nominal) or 1, self.L * len(outputs)
        if order > most:
            raise ConfigurationError(
                f"identifier.order: got {order}, expected at most L x outputs = {most}"
            )
        if self.force == "filtered" and thruster is None:
            raise ConfigurationError(
                "identifier.force: got filtered, but the thruster lag is not known"
            )

    def _has_form(self, dofs: tuple[str, ...]) -> bool:
        """Whether the inputs begin with all forces and the outputs are the whole pose."""
        forces = tuple(f"tau_{dof}" for dof in dofs)
        begin = forces if self.inputs is None else self.inputs[: len(dofs)]
        return begin == forces and self.outputs in (None, poses_of(dofs))

    def needs(self) -> Needs:
        """The force of the input."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def model_period_s(self, sample_time_s: float) -> float:
        """The identifier's period [s], a multiple of that of the recording, else the latter.

        Raises ConfigurationError unless it is one.
        """
        return samples_in(self.period_s, sample_time_s) * sample_time_s

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
        method, diagnostics = self._method(data, self._order(nominal))
        realisation = self._realise(data, self._order(nominal), method)
        model, errors, usable = realisation.model, None, self._has_form(dofs)
        diagnostics += realisation_diagnostics(realisation)
        try:
            form = self._form(model, data, problem)
            model = _rotate_outputs(form.model, data.heading)
            vessel = form.vessel("identified", dofs, data.extra)
            diagnostics += physical_diagnostics(form, dofs)
            errors = self._standard_errors(data, model.order, method, vessel - nominal, rng)
        except IdentificationError as error:
            if self.physical_form == "required":
                raise
            vessel = replace(nominal, name="identified")
            diagnostics.append(Diagnostic("physical_form", "all", 0.0, label=str(error)))
            usable = usable and self.physical_form == "optional"
        axes, named = axes_of(model.outputs), self.outputs is not None
        diagnostics += model_diagnostics(model, self.markov_parameters, axes, named)
        held_out = self._sampled(problem.validation, nominal)
        diagnostics += fit_diagnostics(model, held_out, axes, named)
        return Identified(
            vessel, vessel - nominal, errors, tuple(diagnostics), state_space=model,
            control_model=_force_inputs_only(model, len(dofs)) if usable else None,
        )  # fmt: skip

    def _extra(self, nominal: Vessel) -> tuple[Term, ...]:
        """The inputs that are not forces."""
        listed = basis.terms(name for name in self.inputs or () if not name.startswith("tau_"))
        if self.extra_terms != "physical":
            further = basis.terms(self.extra_terms)
        else:
            further = tuple(t for t in nominal.terms if is_further_input(t) and moves(t))
        return (*listed, *(term for term in further if term not in listed))

    def _sampled(self, recording: Recording, nominal: Vessel) -> Sampled:
        span, forces = np.radians(self.heading_span_deg), None
        if self.inputs is not None:
            named = [name for name in self.inputs if name.startswith("tau_")]
            forces = tuple(name.removeprefix("tau_") for name in named)
        extra = self._extra(nominal)
        return sampled(
            recording, self.force, extra, self.output, self.period_s, span, forces, self.outputs
        )

    def _order(self, nominal: Vessel) -> int | None:
        if not isinstance(self.order, str):
            return self.order
        poses = poses_of(nominal.dofs)
        outputs = poses if self.outputs is None else self.outputs
        return None if self.order == "gap" else sum(1 + (name in poses) for name in outputs)

    def _method(self, data: Sampled, order: int | None) -> tuple[Alternative, list[Diagnostic]]:
        """The variant and whether D is estimated, chosen by the data if there is a choice."""
        pose = set(self.outputs or ()) <= set(POSES)
        direct = [False] if pose else [False, True]
        direct = direct if self.feedthrough is None else [self.feedthrough]
        alternatives = [
            one for one in NAMES if self.variant in ("auto", one[0]) and one[1] in direct
        ]
        if len(alternatives) == 1:
            return alternatives[0], []
        chosen = select_variant(
            data.y, data.u, self.L, self.J, order, alternatives, stable=self.stable,
            stretch=data.stretch, file=data.file,
        )  # fmt: skip
        return chosen.alternative, chosen.diagnostics()

    def _realise(
        self, data: Sampled, order: int | None, method: Alternative, times: Codes | None = None
    ) -> Realisation:
        realisation = identify_innovations(
            data.y, data.u, self.L, self.J, order, method[0], feedthrough=method[1],
            stable=self.stable, period_s=data.period_s, stretch=data.stretch, times=times,
        )  # fmt: skip
        model = replace(realisation.model, inputs=data.inputs, outputs=data.outputs)
        return replace(realisation, model=model)

    def _form(self, model: StateSpace, data: Sampled, problem: Problem) -> PhysicalForm:
        """The physical form; raises IdentificationError with the reason that it is not used."""
        dofs = problem.nominal.dofs
        if not self._has_form(dofs):
            raise IdentificationError(f"no physical form: it needs {FORM_NEEDS}")
        form = self._physical(model, data)
        if self.physical_form == "better":
            check_better(form.vessel("identified", dofs, data.extra), problem)
        return form

    def _physical(self, model: StateSpace, data: Sampled) -> PhysicalForm:
        """The physical form in body axes; a NED pose is first rotated to the mean heading."""
        return physical_form(_rotate_outputs(model, -data.heading), self.condition_limit)

    def _standard_errors(
        self, data: Sampled, order: int, method: Alternative, residual: Vessel,
        rng: np.random.Generator,
    ) -> Array | None:  # fmt: skip
        """Standard errors by block bootstrap, shape of residual.theta; NaN: not estimated."""
        if self.bootstrap is None:
            return None
        count = max(round(len(data.y) * data.period_s / self.block_s), 2)
        blocks = np.array_split(np.arange(len(data.y)), count)
        tables = []
        for _ in range(self.bootstrap):
            times = np.concatenate([blocks[i] for i in rng.integers(count, size=count)])
            try:
                form = self._physical(self._realise(data, order, method, times).model, data)
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


def check_better(vessel: Vessel, problem: Problem) -> None:
    """Raise IdentificationError if the nominal model predicts the training part better.

    Predictions that restart every 30 s; the error is the mean NRMSE of the velocities.
    """
    identified, nominal = (restart_error(one, problem) for one in (vessel, problem.nominal))
    if not identified <= nominal or not np.isfinite(identified):
        raise IdentificationError(
            f"the nominal model is kept: over predictions of {RESTART_S:g} s of the training part "
            f"the physical form has a velocity NRMSE of {identified:.3g}, the nominal model "
            f"{nominal:.3g}"
        )


def restart_error(vessel: Vessel, problem: Problem) -> float:
    """Mean NRMSE of the velocities over 30 s predictions of the training part.

    Infinite if they diverge or the vessel cannot be simulated.
    """
    try:
        course = prediction(vessel, problem.training, problem.thruster)
    except IdentificationError:
        return np.inf
    ahead, moved = course.over("restarts"), course.mean_motion()
    velocities = np.arange(len(moved)) >= len(vessel.dofs)
    used = velocities & (moved > 0.0)
    return np.inf if ahead.diverged else float(np.mean(ahead.rmse[used] / moved[used]))
