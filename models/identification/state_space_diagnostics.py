"""Diagnostics of an identified state-space model, and its fit.

The fit is 100 (1 - |y - y_hat| / |y - mean y|) per cent. A biased model can predict one step nearly
perfectly, because the predictor corrects it at every sample; predictions of ten steps and a free
run from the first sample show the bias.

The variant of a subspace identification, and whether it has a direct term, from the data.

Each alternative is identified without one block at a time, and judged on that block. What it is
judged by depends on whether the input depends on past outputs.

Without such feedback all alternatives are consistent, and the simulation decides, from the state
that fits the block best: predictions would use past outputs, which hide a wrong response.

With feedback the input contains past noise. `open` is biased then, and because of that noise it
simulates the record better than the truth does. The one-step prediction error has no such
preference if the noise is modelled: Ljung (1999), System Identification, section 13.4.

Test for feedback: without it the innovations e are independent of all inputs. u_k is regressed on
J past samples of u, and of e beside them; an F-test compares the two. Caines and Chan (1975),
Feedback between stationary stochastic processes, IEEE Transactions on Automatic Control 20.

The error of a block is the mean square of predicted - measured over its variance, the mean over the
outputs, at most that of the mean; the choice is that of `cross_validation`.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.cross_validation import FoldErrors, one_standard_error_rule
from seatrial.models.identification.physical_form import PhysicalForm
from seatrial.models.identification.sampled_data import Sampled
from seatrial.models.identification.subspace import (
    NOISE_FREE,
    Realisation,
    Record,
    Variant,
    Window,
    compressed,
    explained_by_past,
    identify_innovations,
)
from seatrial.models.identification.validation import HIDES_BIAS, TEN
from seatrial.models.notation import ACCELERATIONS, DOFS, FORCE_UNIT, POSE_UNIT, POSES, VELOCITIES
from seatrial.models.recording.recording import blocked_k_fold
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array, Codes


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


def axes_of(outputs: tuple[str, ...]) -> tuple[str, ...]:
    """The degree of freedom of every pose, velocity or acceleration; `all` for other outputs."""
    axes: dict[str, str] = {}
    for names in (POSES, VELOCITIES, ACCELERATIONS):
        axes |= dict(zip(names, DOFS, strict=True))
    return tuple(axes.get(name.removeprefix("body "), "all") for name in outputs)


def model_diagnostics(
    model: StateSpace, lags: int, dofs: tuple[str, ...], named: bool = False
) -> list[Diagnostic]:
    """The eigenvalues, and the Markov parameters up to a lag.

    For a Markov parameter i is the lag, j the input and dof the output, which the label names as
    well if `named`; for an eigenvalue i is its number, the largest magnitude first.
    """
    before = [f"{name} of " if named else "" for name in model.outputs]
    diagnostics = []
    for i, value in enumerate(model.eigenvalues, start=1):
        diagnostics.append(Diagnostic("eigenvalue_real", "all", float(value.real), i=i))
        diagnostics.append(Diagnostic("eigenvalue_imag", "all", float(value.imag), i=i))
    for lag, matrix in enumerate(model.markov(lags)):
        diagnostics += [
            Diagnostic(
                "markov", dofs[row], float(value), "", lag, j + 1, before[row] + model.inputs[j]
            )
            for (row, j), value in np.ndenumerate(matrix)
        ]
    return diagnostics


def physical_diagnostics(form: PhysicalForm, dofs: tuple[str, ...]) -> list[Diagnostic]:
    """Condition of the transform, stiffness, and the delay of each pose behind its force."""
    diagnostics = [Diagnostic("physical_form", "all", 1.0)]
    diagnostics.append(Diagnostic("physical_condition", "all", form.condition))
    for row, dof in enumerate(dofs):
        diagnostics.append(Diagnostic("delay", dof, float(form.delay[row]), "s"))
        for j, other in enumerate(dofs):
            unit = f"{FORCE_UNIT[dof]}/{POSE_UNIT[other]}"
            stiffness = float(form.stiffness[row, j])
            diagnostics.append(Diagnostic("stiffness", dof, stiffness, unit, j=j + 1, label=other))
    return diagnostics


def fit_diagnostics(
    model: StateSpace, held_out: Sampled, dofs: tuple[str, ...], named: bool = False
) -> list[Diagnostic]:
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
    labels = {"one_step": HIDES_BIAS}
    return [
        Diagnostic(
            f"fit_{name}", dof, float(value), "%", label=output if named else labels.get(name)
        )
        for name, rows in predicted.items()
        for dof, output, value in zip(
            dofs, model.outputs, fit(held_out.y, np.vstack(rows)), strict=True
        )
    ]


def fit(y: Array, predicted: Array) -> Array:
    """100 (1 - |y - y_hat| / |y - mean y|) [%] per column; 100 is perfect, 0 is the mean.

    NaN where y does not vary.
    """
    error, spread = np.linalg.norm([y - predicted, y - y.mean(axis=0)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 0.0, 100.0 * (1.0 - error / spread), np.nan)


VARIANT_FOLDS = 5
MAX_SAMPLES = 20_000  # samples that the choice is made with: the first ones of a longer record
FEEDBACK_P = 1e-3  # p-value below which there is feedback
Alternative = tuple[Variant, bool]  # and whether D is estimated
NAMES: dict[Alternative, str] = {
    ("closed", False): "closed",
    ("open", False): "open",
    ("open", True): "open with D",
}


@dataclass(frozen=True, eq=False)
class VariantChoice:
    """The chosen alternative, the p-value of no feedback, and the errors of all alternatives."""

    alternative: Alternative
    p_value: float
    errors: dict[str, FoldErrors]  # a run for each block left out

    def diagnostics(self) -> list[Diagnostic]:
        """The choice, the test for feedback, and the NRMSE of each alternative on each block j."""
        feedback = self.p_value < FEEDBACK_P
        reason = "judged by " + ("one-step predictions" if feedback else "simulations")
        variant, direct = self.alternative
        chosen = NAMES[self.alternative]
        rows = [
            Diagnostic("variant", "all", float(variant == "closed"), label=chosen),
            Diagnostic("feedthrough", "all", float(direct)),
            Diagnostic("feedback", "all", float(feedback), label=reason),
            Diagnostic("feedback_p_value", "all", self.p_value),
        ]
        for i, (name, left_out) in enumerate(self.errors.items()):
            rows += [
                Diagnostic("variant_error", "all", float(error), "", i, j, name)
                for j, error in enumerate(np.sqrt(np.mean(left_out.squares, axis=1)))
            ]
        return rows


def select_variant(
    y: Array,
    u: Array,
    L: int,
    J: int,
    order: int | None,
    alternatives: Sequence[Alternative] = tuple(NAMES),
    *,
    stable: bool = False,
    stretch: Codes | None = None,
    file: Codes | None = None,
) -> VariantChoice:
    """Choose one of the alternatives, the simplest first, for outputs y (N, m), inputs u (N, r).

    At most MAX_SAMPLES are used. Where `file` (N,) numbers several files, these are the blocks.
    The other arguments are those of `identify_innovations`. Raises IdentificationError when the
    data are too few for the test of feedback.
    """
    y, u = y[:MAX_SAMPLES], u[:MAX_SAMPLES]
    parts = np.zeros(len(y), dtype=np.int64) if stretch is None else stretch[:MAX_SAMPLES]
    record = Record(y, u, parts, np.arange(len(y)))
    p_value = feedback_p_value(record, J)
    splits = blocked_k_fold(
        len(y), VARIANT_FOLDS, file=None if file is None else file[:MAX_SAMPLES]
    )
    samples = np.array([float(np.count_nonzero(test)) for _, test in splits])
    errors = {NAMES[one]: np.ones((len(splits), y.shape[1])) for one in alternatives}
    for i, (train, test) in enumerate(splits):
        number = 2 * parts + (np.cumsum(test) > 0)  # no window may bridge the block left out
        for variant, direct in alternatives:
            with suppress(IdentificationError):
                model = identify_innovations(
                    y[train], u[train], L, J, order, variant, feedthrough=direct, stable=stable,
                    stretch=number[train],
                ).model  # fmt: skip
                left_out = Record(y[test], u[test], parts[test], record.times[test])
                error = relative_squares(model, left_out, p_value >= FEEDBACK_P)
                errors[NAMES[variant, direct]][i] = np.fmin(error, 1.0)  # that of the mean
    found = {name: FoldErrors(squares, samples) for name, squares in errors.items()}
    best = one_standard_error_rule(found)
    chosen = next(one for one in alternatives if NAMES[one] == best)
    return VariantChoice(chosen, p_value, found)


def feedback_p_value(record: Record, J: int) -> float:
    """The p-value of the hypothesis that no input depends on past outputs; 1 without noise.

    The least p-value of the inputs, times their number (Bonferroni).
    """
    scales = [np.where((size := np.std(x, axis=0)) > 0.0, size, 1.0) for x in record[:2]]
    record = record._replace(y=record.y / scales[0], u=record.u / scales[1])
    after, e = explained_by_past(record, J, False)
    noisy = np.std(e.y, axis=0) > NOISE_FREE
    rows = after.starts(J + 1)
    blocks = [Window(after.u, 0, J), Window(e.y[:, noisy], 0, J), Window(after.u, J, 1)]
    a, b, r = (window.width for window in blocks)
    left = len(rows) - a - b
    if b == 0 or left < 1:
        return 1.0
    R = compressed(blocks, rows, 1)[:, -r:]
    explained, rest = np.sum(R[a : a + b] ** 2, axis=0), np.sum(R[a + b :] ** 2, axis=0)
    random = rest > NOISE_FREE**2 * np.sum(R**2, axis=0)  # not a function of its own past
    ratio = explained[random] / b / (rest[random] / left)
    return float(min(1.0, r * np.min(f_distribution.sf(ratio, b, left), initial=1.0)))


def relative_squares(model: StateSpace, record: Record, simulated: bool) -> Array:
    """Mean square error of each output over its variance (m,), of one step or a simulation.

    NaN where the simulation diverges, zero for an output that does not vary.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        predicted = [
            model.simulate(u, model.initial_state(y, u, free_run=True))
            if simulated
            else model.predict(y, u, 1, model.initial_state(y, u))
            for y, u in record.parts()
        ]
        square = np.mean((np.vstack(predicted) - record.y) ** 2, axis=0)
    variance = np.var(record.y, axis=0)
    ratio = np.divide(square, variance, out=np.zeros_like(square), where=variance > 0.0)
    return np.asarray(ratio)
