"""Findings of an identified state-space model: its fit and its physical form.

The fit is 100 (1 - |y - y_hat| / |y - mean y|) per cent. A biased model can predict one step nearly
perfectly, because the predictor corrects it at every sample; predictions of ten steps and a free
run from the first sample show the bias.

Physical form of the state-space model: inertia and damping from its poles.

With the pose as output and two states a degree of freedom, z = (y, y_dot) = [C; C A_c] x is a
state, A_c the logarithm of A over the period. In it

    y_ddot = A_21 y + A_22 y_dot + B_2 [tau, phi]    so that    M = B_2tau^-1,
    damping = -M A_22,   coefficients of further terms phi = -M B_2phi.

Roll and pitch have restoring moments: their columns of the stiffness -M A_21 become the
coefficients of sin(phi) and sin(theta). No other motion of a vessel has a stiffness, and the pose
does not respond to the force without delay (C B_c = 0): deviations from this are reported. A pose
that responds with a delay, as with a thruster lag, has C B_c = -delay M^-1.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import logm

from seatrial.models.errors import IdentificationError
from seatrial.models.findings import Finding
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
    accelerations_of,
    velocities_of,
)
from seatrial.models.simulation.statespace import StateSpace, zero_order_hold
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel

RESTORING = {"roll": "sin(phi)", "pitch": "sin(theta)"}
REAL = 1e-6  # imaginary part of a logarithm below which it is rounding
SINGULAR = 1e-9  # eigenvalue of A, or ratio of B_2, that counts as zero


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


def physical_form(model: StateSpace, condition_limit: float) -> PhysicalForm:
    """The physical form of a discrete model.

    Raises IdentificationError when there is none, or when the condition number of the transform
    is not below `condition_limit`.
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
    if not condition < condition_limit:
        raise IdentificationError(
            f"no physical form: the transform to pose and velocity is ill-conditioned, "
            f"got {condition:.3g}, expected less than {condition_limit:g}"
        )
    lower = (transform @ A @ np.linalg.inv(transform))[m:]
    forced = transform @ B
    inertia = _inertia(forced[m:, :m])
    return PhysicalForm(
        inertia=inertia,
        damping=-inertia @ lower[:, m:],
        stiffness=-inertia @ lower[:, :m],
        extra=-inertia @ forced[m:, m:],
        delay=-np.diag(forced[:m, :m] @ inertia),
        condition=condition,
        model=replace(model.transformed(transform), D=model.D),
    )


def continuous(model: StateSpace) -> tuple[Array, Array]:
    """A_c (n, n) and B_c (n, r) whose zero-order hold is A and B.

    Raises IdentificationError when there are none.
    """
    eigenvalues, period = model.eigenvalues, float(model.period_s or 1.0)
    negative = (eigenvalues.real < 0.0) & (np.abs(eigenvalues.imag) < REAL)
    if np.any(negative) or np.min(np.abs(eigenvalues)) < SINGULAR:
        raise IdentificationError(
            f"no physical form: the model has an eigenvalue at {np.min(eigenvalues.real):.3g}, "
            f"which a sampled continuous model cannot have"
        )
    logarithm = np.asarray(logm(model.A))
    if np.max(np.abs(np.imag(logarithm))) > REAL * np.max(np.abs(logarithm)):
        raise IdentificationError("no physical form: the logarithm of A is not real")
    A = np.asarray(np.real(logarithm), dtype=np.float64) / period
    held = zero_order_hold(A, np.eye(model.order), period)[1]
    return A, np.asarray(np.linalg.solve(held, model.B), dtype=np.float64)


def _inertia(inverse: Array) -> Array:
    """M from B_2; raises IdentificationError if it is singular or not positive definite."""
    scale = np.max(np.abs(inverse), axis=0, initial=0.0)
    if np.min(scale) <= 0.0 or np.linalg.cond(inverse / scale) > 1.0 / SINGULAR:
        raise IdentificationError("no physical form: a force has no effect on the acceleration")
    inertia = np.linalg.inv(inverse)
    smallest = float(np.min(np.linalg.eigvals(inertia).real))
    if smallest <= 0.0:
        raise IdentificationError(
            f"no physical form: the inertia must be positive definite, "
            f"got an eigenvalue of {smallest:.3g}; nonlinear forces may have to be added by "
            f"identifier.extra_terms"
        )
    return np.asarray(inertia)


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
