"""A predictor that is stable by construction, and poles that are not outside the unit circle.

The predictor x_{k+1} = (A - K C) x_k + B u_k + K y_k forgets its first state if A - K C is stable.
The K of a regression need not make it so. If it does not, the Riccati equation of the predictor is
solved with the covariances of the same noise; its stabilising solution has the same spectrum, and
it exists if (A, C) is detectable and the noise excites every pole on the unit circle.
Anderson and Moore (1979), Optimal Filtering, chapters 4 and 9.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import schur, solve_discrete_are

from seatrial.models.errors import IdentificationError
from seatrial.models.simulation.statespace import StateSpace, spectral_radius
from seatrial.models.vessel.basis import Array

FLOORS = (1e-9, 1e-6, 1e-3, 1.0)  # process noise added to all states, relative to the mean of Q


def observer_gain(A: Array, C: Array) -> Array:
    """A gain G (n, m) with A - G C stable: that of the Kalman predictor for unit covariances."""
    return _riccati_gain(A, C, np.eye(len(A)), np.zeros((len(A), len(C))), np.eye(len(C)))


def with_gain(model: StateSpace, K: Array, e: Array) -> tuple[StateSpace, bool]:
    """The model with gain K (n, m), or with the stable K of the same spectrum.

    If A - K C is not stable, the Riccati equation with the covariances K R K', K R and R gives the
    stable gain with the same noise spectrum; R is that of the innovations e (N, m). If rounding
    prevents its solution, the gain is that of `observer_gain`. Data without noise do not determine
    K: then process noise at the inputs and measurement noise of 1 % of the output are assumed. Also
    returns whether the gain was recomputed. Raises IdentificationError if no gain is stable, as
    (A, C) is not detectable.
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
    try:
        stable = _riccati_gain(model.A, model.C, K @ R @ K.T, K @ R, R)
    except IdentificationError:  # a K of hardly any data may be too large for the equation
        stable = observer_gain(model.A, model.C)
    return replace(model, K=stable), True


def _riccati_gain(A: Array, C: Array, Q: Array, S: Array, R: Array) -> Array:
    """K = (A P C' + S)(C P C' + R)^-1 with P of the Riccati equation of the predictor.

    If the noise does not excite every state, there may be no stabilising solution; then process
    noise is added to all states, in increasing amounts.
    """
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
        f"the identified model has no stable predictor: it is not detectable from its outputs, "
        f"spectral radius {spectral_radius(A):.4g}"
    )


def onto_unit_circle(A: Array) -> tuple[Array, int]:
    """A with the poles outside the unit circle moved radially onto it, and their number.

    A = Q T Q' with Q orthogonal and T block triangular; the diagonal blocks have the poles, and
    only they change. Noferini and Poloni (2021), Nearest Omega-stable matrix via Riemannian
    optimization, Numerische Mathematik 148, project the Schur form in this way for given Q.
    """
    T, Q = schur(A)
    i = moved = 0
    while i < len(T):
        pair = i + 1 < len(T) and T[i + 1, i] != 0.0
        block = slice(i, i + 1 + int(pair))
        radius = spectral_radius(T[block, block])
        if radius > 1.0:
            T[block, block] /= radius
            moved += 1 + int(pair)
        i = block.stop
    return np.asarray(Q @ T @ Q.T), moved
