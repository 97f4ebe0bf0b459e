"""Deterministic and stochastic subspace identification of a vessel from its pose and force.

The output is the pose, the input is the force, held between the samples; `subspace` identifies the
states of the model. The dynamics of a vessel depend on the heading in NED but not in body axes, so
the pose is in body axes: the sum of the measured increments R(psi)' delta eta (psi half-way), whose
rate is the body velocity.

Such a linear model has inertia and linear damping about the mean motion. Quadratic damping and
Coriolis forces become noise, and a constant force biases all coefficients. `extra_terms` add such
forces as known inputs: the model stays linear in their coefficients. A model of other inputs and
outputs, such as the velocity, has no inertia or damping of its own: it is stored beside the nominal
model. Bargouth (2022), section 3.7; Di Ruscio (2009).
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import scipy
from annotated_types import Ge, Le

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.problem import (
    Force,
    Identified,
    Identifier,
    Needs,
    Problem,
    check_forces,
)
from seatrial.models.identification.subspace import (
    FEEDBACK_P,
    NAMES,
    Alternative,
    Realisation,
    Record,
    identify_innovations,
    select_variant,
)
from seatrial.models.identification.validation import HIDES_BIAS, TEN
from seatrial.models.notation import (
    ACCELERATIONS,
    DOFS,
    FORCE_UNIT,
    PLANAR,
    POSE_UNIT,
    POSES,
    VELOCITIES,
    accelerations_of,
    poses_of,
    velocities_of,
)
from seatrial.models.ranges import Positive, PositiveInt, Replicates, check_ranges
from seatrial.models.recording.recording import Recording, following
from seatrial.models.simulation.statespace import StateSpace, zero_order_hold
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, Array, Codes, Term
from seatrial.models.vessel.kinematics import in_body, spatial_reference_kernel
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

FORCE = "tau_"  # begins the name of an input that is a force, such as tau_surge
UNEVEN = 1e-3  # of a period, by which the sample time of a measured recording may miss it
MARKOV_PARAMETERS = 20  # that are stored
RESTORING = {"roll": "sin(phi)", "pitch": "sin(theta)"}
CONDITION_LIMIT = 1e3  # of the transformation to pose and velocity
REAL = 1e-6  # imaginary part of a logarithm below which it is rounding
ZERO_EIGENVALUE = 1e-9  # eigenvalue of A, or ratio of B_2, that counts as zero


@dataclass(frozen=True, eq=False)
class Sampled:
    """Outputs (N, m) and inputs (N, r) of contiguous stretches, sampled every `period_s` [s].

    The first inputs are the forces, the others are terms of the motion or the attitude.
    """

    y: Array
    u: Array
    stretch: Codes  # (N,) index of the contiguous stretch
    period_s: float
    extra: tuple[Term, ...]  # the terms among the inputs
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    file: Codes | None = None  # (N,) number of the file, of a recording of several


def forces_of(dofs: tuple[str, ...]) -> tuple[str, ...]:
    """The names of the forces in all degrees of freedom, as inputs."""
    return tuple(FORCE + dof for dof in dofs)


def sampled(
    recording: Recording, force: str | None, inputs: tuple[str, ...], outputs: tuple[str, ...],
    period_s: float | None,
) -> Sampled:  # fmt: skip
    """Sample the outputs, and the mean of each input over a period.

    `inputs` are forces (`tau_surge`) and terms, `outputs` poses (`x`) in body axes and terms (`u`,
    `u_dot`). For `period_s` see `samples_in`.
    """
    count, dofs = samples_in(period_s, recording.period_s), recording.dofs
    forces = [name for name in inputs if name.startswith(FORCE)]
    extra = basis.terms(name for name in inputs if name not in forces)
    begin = np.flatnonzero(recording.piece_starts)[1:]
    pieces = np.split(np.arange(len(recording)), begin)
    whole = np.concatenate([piece[: len(piece) // count * count] for piece in pieces])
    rows = whole[::count]
    terms = basis.evaluate(extra, recording.variables())
    terms = 0.5 * (terms + following(terms))  # the mean over a sample, as of the force
    columns = [dofs.index(name.removeprefix(FORCE)) for name in forces]
    acting = np.hstack([recording.held_force(force)[:, 1][:, columns], terms])[whole]
    measured, poses = dict[str, Array](), poses_of(dofs)
    if set(outputs) & set(poses):  # each contiguous part from its own origin
        pose = np.vstack([body_pose(eta, dofs) for eta in np.split(recording.eta, begin)])
        measured |= dict(zip(poses, pose.T, strict=True))
    others = [name for name in outputs if name not in poses]
    values = basis.evaluate(basis.terms(others), recording.variables())
    measured |= dict(zip(others, values.T, strict=True))
    named = poses if dofs in (PLANAR, DOFS) else ()  # elsewhere body axes are those of NED
    return Sampled(
        y=np.column_stack([measured[name] for name in outputs])[rows],
        u=acting.reshape(len(rows), count, acting.shape[1]).mean(axis=1),
        stretch=np.cumsum(recording.piece_starts)[rows] - 1, period_s=count * recording.period_s,
        extra=extra, inputs=(*forces, *(term.name for term in extra)),
        outputs=tuple(f"body {name}" if name in named else name for name in outputs),
        file=None if recording.file is None else recording.file[rows],
    )  # fmt: skip


def samples_in(period_s: float | None, sample_time_s: float) -> int:
    """Samples of a recording in a period [s], None: one.

    Raises ConfigurationError, with the nearest multiples of the sample time, unless it is one.
    """
    ratio = 1.0 if period_s is None else period_s / sample_time_s
    if abs(round(ratio) - ratio) > UNEVEN * ratio:
        below = max(int(ratio), 1)
        nearest = " or ".join(f"{count * sample_time_s:g}" for count in (below, below + 1))
        raise ConfigurationError(
            f"identifier.period_s: got {period_s:g} s, expected a multiple of the recording's "
            f"sample time {sample_time_s:g} s, such as {nearest}"
        )
    return round(ratio)


def body_pose(eta: Array, dofs: tuple[str, ...]) -> Array:
    """Sum of pose increments in body axes, from 0: J^-1 delta eta, J half-way; shape (N, n_dof).

    Its rate is the body velocity at any attitude. eta (N, n_dof) is (x, y, psi) in the plane, (x,
    y, z, phi, theta, psi) in six degrees of freedom; in other degrees of freedom J is the identity.
    """
    steps, middle = np.diff(eta, axis=0), 0.5 * (eta[1:] + eta[:-1])
    if dofs == PLANAR:
        steps[:, :2] = in_body(steps[:, :2], middle[:, 2])
    elif dofs == DOFS:
        unused = np.empty(len(dofs))
        for position, step in zip(middle, steps, strict=True):
            path = np.column_stack([position, step, np.zeros(len(dofs))])
            spatial_reference_kernel(path, step, unused)
    return np.vstack([np.zeros(len(dofs)), np.cumsum(steps, axis=0)])


def check_signals(
    inputs: tuple[str, ...] | None, outputs: tuple[str, ...] | None, nominal: Vessel
) -> None:
    """Raise ConfigurationError for a signal that a recording of the vessel does not have."""
    own = {"inputs": forces_of(nominal.dofs), "outputs": poses_of(nominal.dofs)}
    known = {"1", *nominal.velocities, *nominal.accelerations, *basis.ATTITUDE, *AIR}
    for option, values in (("inputs", inputs), ("outputs", outputs)):
        for value in set(values or ()) - set(own[option]):
            names = set() if value.startswith(FORCE) else varying(basis.term(value))
            if not names or not names <= known:
                raise ConfigurationError(
                    f"identifier.{option}: got {value}, expected {', '.join(own[option])} or terms "
                    f"that vary of the motion in {', '.join(nominal.dofs)}"
                )


def is_further_input(term: Term) -> bool:
    """Whether a term can be an additional input: it varies and is not already in the model."""
    names = varying(term)
    return bool(names) and not names & set(ACCELERATIONS) and term.name not in VELOCITIES


def varying(term: Term) -> set[str]:
    """The variables in a term, without the constant."""
    return {basis.VARIABLES[code % basis.N_VARIABLES] for code in term.codes if code}


@dataclass(frozen=True)
class Dsr(Identifier):
    """DSR with L rows in the Hankel matrices and J past samples.

    The data choose the variant, if it is `auto`, and whether there is a direct term; a pose has
    none. Inputs are forces (`tau_surge`) and terms, outputs poses (`x`) and terms (`u`, `u_dot`).
    """

    L: Annotated[int, Ge(2), Le(1000)]
    J: Annotated[int, Ge(1), Le(1000)]
    order: PositiveInt | Literal["physical", "gap"]
    variant: Literal["auto", "closed", "open"]
    stable: bool
    inputs: tuple[str, ...] | None
    outputs: tuple[str, ...] | None
    force: Force | None
    extra_terms: tuple[str, ...] | Literal["physical"]  # further inputs beside the force
    period_s: Positive | None
    physical_form: Literal["better", "optional"]
    bootstrap: Replicates | None
    block_s: Positive

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

    @property
    def protected(self) -> bool:
        """Whether the nominal model is kept where the physical form predicts worse."""
        return self.physical_form == "better"

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for unknown signals or a wrong order."""
        check_forces("dsr", nominal)
        check_signals(self.inputs, self.outputs, nominal)
        states = 2 * len(nominal.dofs)
        needs_states = self._has_form(nominal.dofs) and self.physical_form == "better"
        if needs_states and self.order not in (states, "physical", "gap"):
            raise ConfigurationError(
                f"identifier.order: got {self.order}, but {nominal.name} has {states} states; "
                f"use order={states} or identifier.physical_form=optional"
            )
        most = self.L * len(self._outputs(nominal.dofs))
        if (order := self._order(nominal.dofs) or 1) > most:
            raise ConfigurationError(
                f"identifier.order: got {order}, expected at most L x outputs = {most}"
            )

    def needs(self) -> Needs:
        """The force of the input."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def model_period_s(self, sample_time_s: float) -> float:
        """The identifier's period [s], or that of the recording; see `samples_in`."""
        return samples_in(self.period_s, sample_time_s) * sample_time_s

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The state-space model and the vessel of its form; raises IdentificationError for none."""
        nominal, dofs = problem.nominal, problem.nominal.dofs
        data, order = self._sampled(problem.training, nominal), self._order(dofs)
        method, diagnostics = self._method(data, order)
        realisation = self._realise(data, order, method)
        diagnostics += realisation_diagnostics(realisation)
        model, vessel, errors = realisation.model, replace(nominal, name="identified"), None
        usable = self._has_form(dofs)
        try:
            if not usable:
                needed = "all forces as the first inputs and the whole pose as output"
                raise IdentificationError(f"no physical form: it needs {needed}")
            form = physical_form(model)
        except IdentificationError as error:
            diagnostics.append(Diagnostic("physical_form", "all", 0.0, label=str(error)))
            usable = usable and self.physical_form == "optional"
        else:
            model, vessel = form.model, form.vessel("identified", dofs, data.extra)
            diagnostics += form.diagnostics(dofs)
            if not problem.compared:
                errors = self._standard_errors(data, model.order, method, vessel - nominal, rng)
        named = self.outputs is not None
        diagnostics += model_diagnostics(model, MARKOV_PARAMETERS, named)
        diagnostics += fit_diagnostics(model, self._sampled(problem.validation, nominal), named)
        r = len(dofs)
        forced = replace(model, B=model.B[:, :r], D=model.D[:, :r], inputs=model.inputs[:r])
        return Identified(
            vessel, vessel - nominal, errors, tuple(diagnostics), state_space=model,
            control_model=forced if usable else None, notes=(f"dsr: {NAMES[method]}",),
        )  # fmt: skip

    def _outputs(self, dofs: tuple[str, ...]) -> tuple[str, ...]:
        """The outputs, by default the whole pose."""
        return poses_of(dofs) if self.outputs is None else self.outputs

    def _has_form(self, dofs: tuple[str, ...]) -> bool:
        """Whether the inputs begin with all forces and the outputs are the whole pose."""
        forces = forces_of(dofs)
        begin = forces if self.inputs is None else self.inputs[: len(dofs)]
        return begin == forces and self._outputs(dofs) == poses_of(dofs)

    def _order(self, dofs: tuple[str, ...]) -> int | None:
        """The number of states; None: by the gap of the singular values."""
        if self.order == "physical":
            return sum(1 + (name in poses_of(dofs)) for name in self._outputs(dofs))
        return None if self.order == "gap" else self.order

    def _sampled(self, recording: Recording, nominal: Vessel) -> Sampled:
        """The recording as inputs, the forces first and without repetitions, and outputs."""
        own = forces_of(nominal.dofs) if self.inputs is None else self.inputs
        forces = [name for name in own if name.startswith(FORCE)]
        terms = basis.terms(name for name in own if name not in forces)
        if self.extra_terms == "physical":
            moving = {*VELOCITIES, *AIR}  # a term of the attitude alone is part of the stiffness
            further = tuple(t for t in nominal.terms if is_further_input(t) and varying(t) & moving)
        else:
            further = basis.terms(self.extra_terms)
        extra = dict.fromkeys((*terms, *further))
        inputs = (*forces, *(term.name for term in extra))
        outputs = self._outputs(nominal.dofs)
        return sampled(recording, self.force, inputs, outputs, self.period_s)

    def _method(self, data: Sampled, order: int | None) -> tuple[Alternative, list[Diagnostic]]:
        """The variant and whether D is estimated, chosen by the data if there is a choice."""
        pose = set(self.outputs or ()) <= set(POSES)
        alternatives = [
            one for one in NAMES if self.variant in ("auto", one[0]) and not (pose and one[1])
        ]
        if len(alternatives) == 1:
            return alternatives[0], []
        (variant, direct), p_value, errors = select_variant(
            data.y, data.u, self.L, self.J, order, alternatives, stable=self.stable,
            stretch=data.stretch, file=data.file,
        )  # fmt: skip
        feedback = p_value < FEEDBACK_P
        reason = "judged by " + ("one-step predictions" if feedback else "simulations")
        chosen = NAMES[variant, direct]
        return (variant, direct), [
            Diagnostic("variant", "all", float(variant == "closed"), label=chosen),
            Diagnostic("feedthrough", "all", float(direct)),
            Diagnostic("feedback", "all", float(feedback), label=reason),
            Diagnostic("feedback_p_value", "all", p_value),
            *(
                Diagnostic("variant_error", "all", float(error), "", i, j, name)
                for i, (name, left_out) in enumerate(errors.items())
                for j, error in enumerate(np.sqrt(np.mean(left_out.squares, axis=1)))
            ),
        ]

    def _realise(
        self, data: Sampled, order: int | None, method: Alternative, times: Codes | None = None
    ) -> Realisation:
        realisation = identify_innovations(
            data.y, data.u, self.L, self.J, order, method[0], feedthrough=method[1],
            stable=self.stable, period_s=data.period_s, stretch=data.stretch, times=times,
        )  # fmt: skip
        model = replace(realisation.model, inputs=data.inputs, outputs=data.outputs)
        return replace(realisation, model=model)

    def _standard_errors(
        self, data: Sampled, order: int, method: Alternative, residual: Vessel,
        rng: np.random.Generator,
    ) -> Array | None:  # fmt: skip
        """Standard errors by block bootstrap, shape of residual.theta; NaN: not estimated."""
        if self.bootstrap is None:
            return None
        count = max(round(len(data.y) * data.period_s / self.block_s), 2)
        blocks, tables = np.array_split(np.arange(len(data.y)), count), list[Vessel]()
        for _ in range(self.bootstrap):
            times = np.concatenate([blocks[i] for i in rng.integers(count, size=count)])
            with suppress(IdentificationError):  # a replicate may not excite the vessel enough
                form = physical_form(self._realise(data, order, method, times).model)
                tables.append(form.vessel("replicate", residual.dofs, data.extra))
        errors = np.full(residual.theta.shape, np.nan)
        if 2 * len(tables) >= self.bootstrap:
            rows = [residual.terms.index(term) for term in tables[0].terms]
            errors[rows] = np.std([table.theta for table in tables], axis=0, ddof=1)
        return errors


def realisation_diagnostics(realisation: Realisation) -> list[Diagnostic]:
    """Order, singular values, spectral radii, controllability and observability."""
    model = realisation.model
    quantities = {
        "selected_order": model.order,
        "spectral_radius": model.spectral_radius,
        "predictor_radius": model.predictor_radius,
        "gain_recomputed": realisation.gain_recomputed,
        "poles_moved": realisation.poles_moved,
        "controllable_order": model.controllable_order,
        "observable_order": model.observable_order,
    }
    diagnostics = [Diagnostic(name, "all", float(value)) for name, value in quantities.items()]
    values = enumerate(realisation.singular_values, start=1)
    return diagnostics + [Diagnostic("singular_value", "all", float(v), i=i) for i, v in values]


def axes_of(model: StateSpace) -> tuple[str, ...]:
    """The degree of freedom of every pose, velocity or acceleration; `all` for other outputs."""
    axes = dict(zip((*POSES, *VELOCITIES, *ACCELERATIONS), DOFS * 3, strict=True))
    return tuple(axes.get(name.removeprefix("body "), "all") for name in model.outputs)


def model_diagnostics(model: StateSpace, lags: int, named: bool = False) -> list[Diagnostic]:
    """The eigenvalues, and the Markov parameters up to a lag.

    For a Markov parameter i is the lag, j the input and dof the output, which the label names as
    well if `named`; for an eigenvalue i is its number, the largest magnitude first.
    """
    axes, diagnostics = axes_of(model), list[Diagnostic]()
    for i, value in enumerate(model.eigenvalues, start=1):
        diagnostics.append(Diagnostic("eigenvalue_real", "all", float(value.real), i=i))
        diagnostics.append(Diagnostic("eigenvalue_imag", "all", float(value.imag), i=i))
    for (lag, row, j), value in np.ndenumerate(model.markov(lags)):
        label = (f"{model.outputs[row]} of " if named else "") + model.inputs[j]
        diagnostics.append(Diagnostic("markov", axes[row], float(value), "", lag, j + 1, label))
    return diagnostics


def fit_diagnostics(model: StateSpace, held_out: Sampled, named: bool) -> list[Diagnostic]:
    """One-step, ten-step and free-run fit [%] on held-out data, per output.

    The first state of every stretch is estimated from it. If `named`, labels are the outputs.
    """
    predicted: dict[str, list[Array]] = {"one_step": [], "ten_step": [], "free_run": []}
    record = Record(held_out.y, held_out.u, held_out.stretch, np.arange(len(held_out.y)))
    for y, u in record.parts():
        start = model.initial_state(y, u)
        predicted["one_step"].append(model.predict(y, u, 1, start))
        predicted["ten_step"].append(model.predict(y, u, TEN, start))
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may diverge
            free = model.initial_state(y, u, free_run=True)
            predicted["free_run"].append(model.simulate(u, free))
    diagnostics = []
    for name, rows in predicted.items():
        label = HIDES_BIAS if name == "one_step" else None
        fits = fit(held_out.y, np.vstack(rows)).tolist()
        diagnostics += [
            Diagnostic(f"fit_{name}", dof, value, "%", label=output if named else label)
            for dof, output, value in zip(axes_of(model), model.outputs, fits, strict=True)
        ]
    return diagnostics


def fit(y: Array, predicted: Array) -> Array:
    """100 (1 - |y - y_hat| / |y - mean y|) [%] per column; 100 is perfect, 0 is the mean.

    NaN where y does not vary.
    """
    error, spread = np.linalg.norm([y - predicted, y - y.mean(axis=0)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 0.0, 100.0 * (1.0 - error / spread), np.nan)


@dataclass(frozen=True, eq=False)
class PhysicalForm:
    """M nu_dot + damping nu + stiffness y + extra phi = tau, with a delay of the pose."""

    inertia: Array  # (n_dof, n_dof) [kg, kg m, kg m^2]
    damping: Array  # (n_dof, n_dof) [kg/s, kg m/s, kg m^2/s]
    extra: Array  # (n_dof, n_terms) coefficients of the inputs that are not forces
    stiffness: Array  # (n_dof, n_dof) [N/m, N, Nm/rad]
    delay: Array  # (n_dof,) [s] delay of the pose behind the force
    condition: float  # condition number of the transform with rows of unit length
    model: StateSpace  # the model with the state (y, y_dot)

    def vessel(self, name: str, dofs: tuple[str, ...], extra: tuple[Term, ...]) -> Vessel:
        """The coefficient table of accelerations, velocities, restoring and `extra` terms."""
        tilting = [i for i, dof in enumerate(dofs) if dof in RESTORING]
        restoring = (RESTORING[dofs[i]] for i in tilting)
        linear_terms = basis.terms([*accelerations_of(dofs), *velocities_of(dofs), *restoring])
        linear = [self.inertia.T, self.damping.T, self.stiffness.T[tilting]]
        return Vessel(name, dofs, (*linear_terms, *extra), np.vstack([*linear, self.extra.T]))

    def diagnostics(self, dofs: tuple[str, ...]) -> list[Diagnostic]:
        """Condition of the transform, stiffness, and the delay of each pose behind its force."""
        found = [
            Diagnostic("physical_form", "all", 1.0),
            Diagnostic("physical_condition", "all", self.condition),
        ]
        for dof, delay, row in zip(dofs, self.delay, self.stiffness, strict=True):
            found.append(Diagnostic("delay", dof, float(delay), "s"))
            for j, (other, stiffness) in enumerate(zip(dofs, row, strict=True), start=1):
                unit = f"{FORCE_UNIT[dof]}/{POSE_UNIT[other]}"
                found.append(Diagnostic("stiffness", dof, float(stiffness), unit, j=j, label=other))
        return found


def physical_form(model: StateSpace) -> PhysicalForm:
    """Inertia and damping of a discrete model, from its poles.

    With the pose as output and two states a degree of freedom, z = (y, y_dot) = [C; C A_c] x is a
    state, A_c the logarithm of A over the period. In it

        y_ddot = A_21 y + A_22 y_dot + B_2 [tau, phi]    so that    M = B_2tau^-1,
        damping = -M A_22,   coefficients of further terms phi = -M B_2phi.

    Roll and pitch have restoring moments: their columns of the stiffness -M A_21 become the
    coefficients of sin(phi) and sin(theta). No other motion of a vessel has a stiffness. A pose
    that responds with a delay, as with a thruster lag, has C B_c = -delay M^-1. Raises
    IdentificationError when there is no such form.
    """
    n, m, r = model.order, *model.D.shape
    if n != 2 * m or r < m:
        raise IdentificationError(
            f"no physical form: got {n} states, {r} inputs and {m} outputs, "
            f"expected a force for every output and two states for each"
        )
    A, B = continuous(model)
    transform = np.vstack([model.C, model.C @ A])
    size = np.linalg.norm(transform, axis=1, keepdims=True)
    condition = float(np.linalg.cond(transform / np.where(size > 0.0, size, 1.0)))
    if not condition < CONDITION_LIMIT:
        raise IdentificationError(
            f"no physical form: the transform to pose and velocity is ill-conditioned, "
            f"got {condition:.3g}, expected less than {CONDITION_LIMIT:g}"
        )
    lower = (transform @ A @ np.linalg.inv(transform))[m:]
    forced = transform @ B
    inverse = forced[m:, :m]
    scale = np.max(np.abs(inverse), axis=0, initial=0.0)
    if np.min(scale) <= 0.0 or np.linalg.cond(inverse / scale) > 1.0 / ZERO_EIGENVALUE:
        raise IdentificationError("no physical form: a force has no effect on the acceleration")
    inertia = np.asarray(np.linalg.inv(inverse), dtype=np.float64)
    smallest = float(np.min(np.linalg.eigvals(inertia).real))
    if smallest <= 0.0:
        raise IdentificationError(
            f"no physical form: the inertia must be positive definite, "
            f"got an eigenvalue of {smallest:.3g}; nonlinear forces may have to be added by "
            f"identifier.extra_terms"
        )
    return PhysicalForm(
        inertia=inertia, damping=-inertia @ lower[:, m:], stiffness=-inertia @ lower[:, :m],
        extra=-inertia @ forced[m:, m:], delay=-np.diag(forced[:m, :m] @ inertia),
        condition=condition, model=replace(model.transformed(transform), D=model.D),
    )  # fmt: skip


def continuous(model: StateSpace) -> tuple[Array, Array]:
    """A_c (n, n) and B_c (n, r) whose zero-order hold is A and B, or an IdentificationError."""
    eigenvalues, period = model.eigenvalues, float(model.period_s or 1.0)
    negative = (eigenvalues.real < 0.0) & (np.abs(eigenvalues.imag) < REAL)
    if np.any(negative) or np.min(np.abs(eigenvalues)) < ZERO_EIGENVALUE:
        raise IdentificationError(
            f"no physical form: the model has an eigenvalue at {np.min(eigenvalues.real):.3g}, "
            f"which a sampled continuous model cannot have"
        )
    logarithm = np.asarray(scipy.linalg.logm(model.A))
    if np.max(np.abs(np.imag(logarithm))) > REAL * np.max(np.abs(logarithm)):
        raise IdentificationError("no physical form: the logarithm of A is not real")
    A = np.asarray(np.real(logarithm), dtype=np.float64) / period
    held = zero_order_hold(A, np.eye(model.order), period)[1]
    return A, np.asarray(np.linalg.solve(held, model.B), dtype=np.float64)
