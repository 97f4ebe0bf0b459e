"""Linear-quadratic control with integral action, in incremental form.

    J = 1/2 sum (y_k - r)' Q (y_k - r) + Delta u_k' P Delta u_k
    u_k = u_{k-1} + G1 (x_k - x_{k-1}) + G2 (y_{k-1} - r_k)

Bargouth (2022), (3.38)-(3.46). A constant disturbance cancels in the increments, so it leaves no
steady-state error. At an amplitude limit the increment is clipped, which prevents integral windup.
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.control.controller import Model
from seatrial.models.control.estimator import Memory
from seatrial.models.control.linear_controller import LinearController, LinearTable
from seatrial.models.control.linear_design import DesignModel, riccati
from seatrial.models.simulation.statespace import StateSpace, spectral_radius
from seatrial.models.vessel.basis import Array


def lqi_gain(model: StateSpace, Q: Array, P: Array) -> Array:
    """Gain G (r, n + m) of Delta u = G (Delta x, y_{k-1} - r), from the Riccati equation.

    Q (m, m) weights the output error, P (r, r) the input increments. Raises ConfigurationError
    when the Riccati equation has no stabilising solution.
    """
    augmented = model.with_integral_action()
    A, B = augmented.A, augmented.B
    S = riccati(
        A, B, augmented.C.T @ Q @ augmented.C, P, "controller=lqi: the design is not stable"
    )
    return -np.asarray(np.linalg.solve(P + B.T @ S @ B, B.T @ S @ A))


@dataclass(frozen=True)
class Lqi(LinearController):
    """LQ control with integral action on the pose; `input_weight` weights the increments."""

    def gain(self, design: DesignModel) -> Array:
        """Gain (r, n + m) of (Delta x, y_{k-1} - r), as a fraction of the limits."""
        return lqi_gain(design.model, np.diag(self.error_weight), np.diag(self.input_weight))

    def build(self, model: Model, period_s: float) -> tuple[LinearTable, Memory]:
        """Parameters and initial state of the compiled step, for a model and loop period [s]."""
        design = self.design(model, period_s)
        gain, (n, r), m = self.gain(design), design.model.B.shape, len(design.model.C)
        of_pose = gain[:, n:]  # theta = (Delta x, y_{-1}, r_1, d_0, u_{-1}), relative to y_{-1}
        of_theta = np.hstack([gain[:, :n], np.zeros((r, m)), -of_pose, np.zeros((r, 2 * r))])
        rows = self.command_rows(period_s)
        return self.law(design, of_theta, 1, True, rows, regulator=True)

    def radius(self, design: DesignModel) -> float:
        """Spectral radius of the closed loop."""
        augmented = design.model.with_integral_action()
        return spectral_radius(augmented.A + augmented.B @ self.gain(design))
