"""The gain K of an identified predictor x_{k+1} = A x_k + B u_k + K e_k that forgets its start."""

from dataclasses import replace

import numpy as np

from models.basis import Array
from models.errors import IdentificationError
from models.statespace import StateSpace, spectral_radius

FLOORS = (1e-9, 1e-6, 1e-3, 1.0)  # process noise added to all states, relative to what there is


def observer_gain(A: Array, C: Array) -> Array:
    """A gain G with A - G C stable: the Kalman predictor's for noise of unit size everywhere."""
    return _riccati_gain(A, C, np.eye(len(A)), np.zeros((len(A), len(C))), np.eye(len(C)))


def with_gain(model: StateSpace, K: Array, e: Array) -> tuple[StateSpace, bool]:
    """The model with K, or where A - K C is not stable, with the stable K of the same spectrum.

    Noise of the covariances K R K', K R and R has the same spectrum for both; the second one
    solves the Riccati equation. Data without noise leave K open: then process noise that enters
    as the inputs do, and 1 % of the output's size on it, are assumed.
    """
    m = len(model.C)
    if not np.any(K):
        B = model.B
        S, R = np.zeros((model.order, m)), 1e-4 * np.eye(m)
        return replace(model, K=_riccati_gain(model.A, model.C, B @ B.T, S, R)), True
    model = replace(model, K=K)
    if model.predictor_radius < 1.0:
        return model, False
    R = e.T @ e / len(e)
    R = R + 1e-6 * np.trace(R) / m * np.eye(m)
    return replace(model, K=_riccati_gain(model.A, model.C, K @ R @ K.T, K @ R, R)), True


def _riccati_gain(A: Array, C: Array, Q: Array, S: Array, R: Array) -> Array:
    """K = (A P C' + S)(C P C' + R)^-1 with P of the Riccati equation of the predictor.

    Noise that leaves some state alone has no stabilising solution, or one that cannot be computed:
    then a little more is added to all states.
    """
    from scipy.linalg import solve_discrete_are

    size = max(float(np.trace(Q)) / len(A), float(np.finfo(np.float64).tiny))
    for share in FLOORS:
        try:
            P = solve_discrete_are(A.T, C.T, Q + share * size * np.eye(len(A)), R, s=S)
        except (np.linalg.LinAlgError, ValueError):
            continue
        K = np.asarray(np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T)
        if spectral_radius(A - K @ C) < 1.0:
            return K
    raise IdentificationError(
        f"the identified model has no stable predictor: its outputs do not show every state, "
        f"spectral radius {spectral_radius(A):.4g}"
    )
