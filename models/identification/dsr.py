"""Deterministic and stochastic subspace identification of a vessel from its pose and force.

The output is the pose, the input is the force, held between the samples; `subspace` identifies the
states of the model. The dynamics of a vessel depend on the heading in NED but not in body axes, so
the pose is in body axes: the sum of the measured increments R(psi)' delta eta (psi half-way), whose
rate is the body velocity. Near one heading it is the rotated NED pose.

Such a linear model has inertia and linear damping about the mean motion. Quadratic damping and
Coriolis forces become noise, and a constant force biases all coefficients. `extra_terms` add such
forces as known inputs: the model stays linear in their coefficients.

`inputs` and `outputs` are other quantities of the recording, such as the velocity in place of the
pose. Such a model has no inertia or damping of its own: it is stored beside the nominal model.
Bargouth (2022), section 3.7; Di Ruscio (2009).

The fit is 100 (1 - |y - y_hat| / |y - mean y|) per cent. A biased model can predict one step nearly
perfectly, because the predictor corrects it at every sample; predictions of ten steps and a free
run from the first sample show the bias.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.physical_form import physical_form
from seatrial.models.identification.problem import (
    Force,
    Identified,
    Identifier,
    Needs,
    Problem,
    check_forces,
)
from seatrial.models.identification.sampled_data import (
    FORCE,
    Sampled,
    check_signals,
    forces_of,
    is_further_input,
    moves,
    sampled,
    samples_in,
)
from seatrial.models.identification.subspace import Realisation, identify_innovations
from seatrial.models.identification.validation import HIDES_BIAS, TEN
from seatrial.models.identification.variant_selection import NAMES, Alternative, select_variant
from seatrial.models.notation import ACCELERATIONS, DOFS, POSES, VELOCITIES, poses_of
from seatrial.models.ranges import Positive, PositiveInt, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

MARKOV_PARAMETERS = 20  # that are stored


@dataclass(frozen=True)
class Dsr(Identifier):
    """DSR with L rows in the Hankel matrices and J past samples.

    `order` is a number, `physical` (two states for a pose, one for another output) or `gap` (the
    largest gap of the singular values). `variant: closed` (dsr_e) holds with and without feedback,
    `open` only without; `auto` lets the data choose. They also choose whether there is a direct
    term; a pose has none. `stable` moves poles outside the unit circle onto it.
    `inputs` are forces (`tau_surge`) and terms, None all forces; `extra_terms` follow, `physical`
    are the nonlinear terms of the nominal model. `outputs` are poses (`x`) and terms (`u`,
    `u_dot`), None the whole pose.

    Without a physical form the nominal model is kept, with the reason as a diagnostic; it is also
    that for control, where `physical_form: optional` takes the state-space model. `better` keeps it
    also where the physical form predicts the training part worse (`fallback`).
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
        """The identifier's period [s], a multiple of that of the recording, else the latter.

        Raises ConfigurationError unless it is one.
        """
        return samples_in(self.period_s, sample_time_s) * sample_time_s

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the state-space model and the vessel of its physical form.

        Raises IdentificationError when the data do not determine the model.
        """
        nominal, dofs = problem.nominal, problem.nominal.dofs
        data, order = self._sampled(problem.training, nominal), self._order(dofs)
        method, diagnostics = self._method(data, order)
        realisation = identify_innovations(
            data.y, data.u, self.L, self.J, order, method[0], feedthrough=method[1],
            stable=self.stable, period_s=data.period_s, stretch=data.stretch,
        )  # fmt: skip
        diagnostics += realisation_diagnostics(realisation)
        model = replace(realisation.model, inputs=data.inputs, outputs=data.outputs)
        vessel = replace(nominal, name="identified")
        usable = self._has_form(dofs)
        try:
            if not usable:
                raise IdentificationError(
                    "no physical form: it needs all forces as the first inputs and the whole pose "
                    "as output"
                )
            form = physical_form(model)
        except IdentificationError as error:
            diagnostics.append(Diagnostic("physical_form", "all", 0.0, label=str(error)))
            usable = usable and self.physical_form == "optional"
        else:
            model, vessel = form.model, form.vessel("identified", dofs, data.extra)
            diagnostics += form.diagnostics(dofs)
        named = self.outputs is not None
        diagnostics += model_diagnostics(model, MARKOV_PARAMETERS, named)
        diagnostics += fit_diagnostics(model, self._sampled(problem.validation, nominal), named)
        r = len(dofs)
        forced = replace(model, B=model.B[:, :r], D=model.D[:, :r], inputs=model.inputs[:r])
        return Identified(
            vessel, vessel - nominal, diagnostics=tuple(diagnostics), state_space=model,
            control_model=forced if usable else None,
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
            further = tuple(t for t in nominal.terms if is_further_input(t) and moves(t))
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
        chosen = select_variant(
            data.y, data.u, self.L, self.J, order, alternatives, stable=self.stable,
            stretch=data.stretch, file=data.file,
        )  # fmt: skip
        return chosen.alternative, chosen.diagnostics()


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
    axes: dict[str, str] = {}
    for names in (POSES, VELOCITIES, ACCELERATIONS):
        axes |= dict(zip(names, DOFS, strict=True))
    return tuple(axes.get(name.removeprefix("body "), "all") for name in model.outputs)


def model_diagnostics(model: StateSpace, lags: int, named: bool = False) -> list[Diagnostic]:
    """The eigenvalues, and the Markov parameters up to a lag.

    For a Markov parameter i is the lag, j the input and dof the output, which the label names as
    well if `named`; for an eigenvalue i is its number, the largest magnitude first.
    """
    axes, diagnostics = axes_of(model), list[Diagnostic]()
    before = [f"{name} of " if named else "" for name in model.outputs]
    for i, value in enumerate(model.eigenvalues, start=1):
        diagnostics.append(Diagnostic("eigenvalue_real", "all", float(value.real), i=i))
        diagnostics.append(Diagnostic("eigenvalue_imag", "all", float(value.imag), i=i))
    for (lag, row, j), value in np.ndenumerate(model.markov(lags)):
        label = before[row] + model.inputs[j]
        diagnostics.append(Diagnostic("markov", axes[row], float(value), "", lag, j + 1, label))
    return diagnostics


def fit_diagnostics(model: StateSpace, held_out: Sampled, named: bool) -> list[Diagnostic]:
    """One-step, ten-step and free-run fit [%] on held-out data, per output.

    The first state of every stretch is estimated from that stretch. If `named`, the label is the
    name of the output.
    """
    predicted: dict[str, list[Array]] = {"one_step": [], "ten_step": [], "free_run": []}
    for y, u in held_out.parts():
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
