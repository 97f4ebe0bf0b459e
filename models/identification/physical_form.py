"""The physical form of an identified state-space model: inertia and damping from its poles.

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
import scipy

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.notation import FORCE_UNIT, POSE_UNIT, accelerations_of, velocities_of
from seatrial.models.simulation.statespace import StateSpace, zero_order_hold
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel

RESTORING = {"roll": "sin(phi)", "pitch": "sin(theta)"}
CONDITION_LIMIT = 1e3  # of the transformation to pose and velocity
REAL = 1e-6  # imaginary part of a logarithm below which it is rounding
ZERO_EIGENVALUE = 1e-9  # eigenvalue of A, or ratio of B_2, that counts as zero


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
    """The physical form of a discrete model.

    Raises IdentificationError when there is none, or when the condition number of the transform
    is not below CONDITION_LIMIT.
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


def _inertia(inverse: Array) -> Array:
    """M from B_2; raises IdentificationError if it is singular or not positive definite."""
    scale = np.max(np.abs(inverse), axis=0, initial=0.0)
    if np.min(scale) <= 0.0 or np.linalg.cond(inverse / scale) > 1.0 / ZERO_EIGENVALUE:
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
