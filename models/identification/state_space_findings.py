"""Findings of an identified state-space model, and its fit.

The fit is 100 (1 - |y - y_hat| / |y - mean y|) per cent. A biased model can predict one step nearly
perfectly, because the predictor corrects it at every sample; predictions of ten steps and a free
run from the first sample show the bias.
"""

import numpy as np

from seatrial.models.findings import Finding
from seatrial.models.identification.physical_form import PhysicalForm
from seatrial.models.identification.sampled_data import Sampled, stretches
from seatrial.models.identification.subspace import Realisation
from seatrial.models.identification.validation import HIDES_BIAS, TEN
from seatrial.models.notation import (
    ACCELERATIONS,
    DOFS,
    FORCE_UNIT,
    POSE_UNIT,
    POSES,
    VELOCITIES,
)
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array


def realisation_findings(realisation: Realisation) -> list[Finding]:
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
    findings = [Finding(name, "all", float(value)) for name, value in quantities.items()]
    values = enumerate(realisation.singular_values, start=1)
    return findings + [Finding("singular_value", "all", float(v), i=i) for i, v in values]


def axes_of(outputs: tuple[str, ...]) -> tuple[str, ...]:
    """The degree of freedom of every pose, velocity or acceleration; `all` for other outputs."""
    axes: dict[str, str] = {}
    for names in (POSES, VELOCITIES, ACCELERATIONS):
        axes |= dict(zip(names, DOFS, strict=True))
    return tuple(axes.get(name.removeprefix("body "), "all") for name in outputs)


def model_findings(
    model: StateSpace, lags: int, dofs: tuple[str, ...], named: bool = False
) -> list[Finding]:
    """The eigenvalues, and the Markov parameters up to a lag.

    For a Markov parameter i is the lag, j the input and dof the output, which the label names as
    well if `named`; for an eigenvalue i is its number, the largest magnitude first.
    """
    before = [f"{name} of " if named else "" for name in model.outputs]
    findings = []
    for i, value in enumerate(model.eigenvalues, start=1):
        findings.append(Finding("eigenvalue_real", "all", float(value.real), i=i))
        findings.append(Finding("eigenvalue_imag", "all", float(value.imag), i=i))
    for lag, matrix in enumerate(model.markov(lags)):
        findings += [
            Finding(
                "markov", dofs[row], float(value), "", lag, j + 1, before[row] + model.inputs[j]
            )
            for (row, j), value in np.ndenumerate(matrix)
        ]
    return findings


def physical_findings(form: PhysicalForm, dofs: tuple[str, ...]) -> list[Finding]:
    """Condition of the transform, stiffness, and the delay of each pose behind its force."""
    findings = [Finding("physical_form", "all", 1.0)]
    findings.append(Finding("physical_condition", "all", form.condition))
    for row, dof in enumerate(dofs):
        findings.append(Finding("delay", dof, float(form.delay[row]), "s"))
        for j, other in enumerate(dofs):
            unit = f"{FORCE_UNIT[dof]}/{POSE_UNIT[other]}"
            stiffness = float(form.stiffness[row, j])
            findings.append(Finding("stiffness", dof, stiffness, unit, j=j + 1, label=other))
    return findings


def fit_findings(
    model: StateSpace, held_out: Sampled, dofs: tuple[str, ...], named: bool = False
) -> list[Finding]:
    """One-step, ten-step and free-run fit [%] on held-out data, per output.

    The first state of every stretch is estimated from that stretch. If `named`, the label is the
    name of the output.
    """
    predicted: dict[str, list[Array]] = {"one_step": [], "ten_step": [], "free_run": []}
    parts = (stretches(values, held_out.stretch) for values in (held_out.y, held_out.u))
    for y, u in zip(*parts, strict=True):
        start = model.initial_state(y, u)
        predicted["one_step"].append(model.predict(y, u, 1, start))
        predicted["ten_step"].append(model.predict(y, u, TEN, start))
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may diverge
            free = model.initial_state(y, u, free_run=True)
            predicted["free_run"].append(model.simulate(u, free))
    labels = {"one_step": HIDES_BIAS}
    return [
        Finding(f"fit_{name}", dof, float(value), "%", label=output if named else labels.get(name))
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
