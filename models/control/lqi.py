"""Linear-quadratic control with integral action, in incremental form.

    J = 1/2 sum (y_k - r)' Q (y_k - r) + Delta u_k' P Delta u_k
    u_k = u_{k-1} + G1 (x_k - x_{k-1}) + G2 (y_{k-1} - r_k)

Bargouth (2022), (3.38)-(3.46). A constant disturbance cancels in the increments, so it leaves no
steady-state error. At an amplitude limit the increment is clipped, which prevents integral windup.
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.control.linear_controller import Law, LinearController
from seatrial.models.control.linear_design import DesignModel, riccati
from seatrial.models.simulation.statespace import StateSpace
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

    def law(self, design: DesignModel) -> Law:
        """theta = (Delta x, y_{-1}, r_1, d_0, u_{-1}); r_1 is relative to y_{-1}."""
        weights = np.diag(self.error_weight), np.diag(self.input_weight)
        gain, (n, r) = lqi_gain(design.model, *weights), design.model.B.shape
        of_theta = np.hstack([gain, -gain[:, n:], np.zeros((r, 2 * r))])
        return Law(np.ascontiguousarray(of_theta), regulator=True)
