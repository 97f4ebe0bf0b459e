"""How informative manoeuvres are, and the mix of them that tells the coefficients apart best.

    Gamma_q = (1/N) sum_k phi(k) phi(k)'                 of manoeuvre q, phi as in tau = theta' phi
    N* = argmax log det (N_1 Gamma_1 + ... + N_Q Gamma_Q),  N_1 + ... + N_Q = N,  N_q >= 0

Ljungberg (slides), "Informative mix of sub-experiments". With the instruments of a noise-free
simulation in the place of the regressors, Z = Phi, every Gamma_q is symmetric and the problem
concave: D-optimal design. The terms are free in every degree of freedom, so the information of
all coefficients is as many copies of Gamma as there are degrees of freedom, and has the same
optimum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array

Integers = NDArray[np.int64]
GAP = 1e-6  # at which the search for the optimum ends
MOST_STEPS = 200_000
SINGULAR = 1e-12  # of an eigenvalue, relative to the largest, of scaled information
SHARE = 0.2  # of a term in a combination that counts as part of it


@dataclass(frozen=True, eq=False)
class Weights:
    """Shares w_q >= 0 of the manoeuvres, shape (Q,), of sum one, and how far from the optimum."""

    share: Array
    gap: float  # max_q tr(Gamma^-1 Gamma_q) - n, zero at the optimum


def information(phi: Array) -> Array:
    """Gamma = (1/N) sum_k phi(k) phi(k)', shape (n, n), of regressors phi (N, n)."""
    return np.asarray(phi.T @ phi / len(phi))


def log_det(gammas: Array, counts: Array) -> float:
    """log det of sum_q N_q Gamma_q; -inf where it is singular. gammas (Q, n, n), counts (Q,)."""
    sign, value = np.linalg.slogdet(np.tensordot(counts, gammas, axes=1))
    return float(value) if sign > 0.0 else -np.inf


def scaled(gammas: Array) -> Array:
    """The same with every term in units of its own size over all manoeuvres, (Q, n, n).

    That adds a constant to every log det.
    """
    size = np.sqrt(np.mean(np.diagonal(gammas, axis1=1, axis2=2), axis=0))
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(gammas / np.outer(size, size))


def inseparable(gamma: Array, names: Sequence[str]) -> tuple[str, ...]:
    """The terms that scaled information (n, n) does not tell apart; none where it does."""
    values, ways = np.linalg.eigh(gamma)
    if values[0] > SINGULAR * values[-1]:
        return ()
    weight = np.abs(ways[:, 0]) / np.max(np.abs(ways[:, 0]))
    return tuple(name for name, share in zip(names, weight, strict=True) if share > SHARE)


def sensitivities(gammas: Array, share: Array) -> Array:
    """d_q = tr(Gamma^-1 Gamma_q) with Gamma = sum_q w_q Gamma_q, shape (Q,).

    Kiefer and Wolfowitz (1960): w is optimal where no d_q exceeds n, the size of Gamma.
    """
    inverse = np.linalg.inv(np.tensordot(share, gammas, axes=1))
    return np.asarray(np.einsum("ij,qji->q", inverse, gammas))


def optimal(gammas: Array, names: Sequence[str], gap: float = GAP) -> Weights:
    """The D-optimal shares by the multiplicative algorithm w_q <- w_q d_q / n.

    Titterington (1976). log det never falls from one step to the next. A manoeuvre that no optimum
    contains is left out as soon as the gap shows it: Harman and Pronzato (2007), theorem 1.
    Raises ConfigurationError where all manoeuvres together do not tell the terms apart.
    """
    gammas = scaled(gammas)
    together = inseparable(np.mean(gammas, axis=0), names)
    if together:
        raise ConfigurationError(
            f"excitation.candidates: all manoeuvres together do not tell {', '.join(together)} "
            "apart"
        )
    n = gammas.shape[1]
    share = np.full(len(gammas), 1.0 / len(gammas))
    for _ in range(MOST_STEPS):
        d = sensitivities(gammas, share)
        left = float(np.max(d) - n)
        if left <= gap:
            break
        share *= d / n
        share[d < _threshold(left, n)] = 0.0
        share /= np.sum(share)
    return Weights(share, left)


def _threshold(left: float, n: int) -> float:
    """d_q below which a manoeuvre is in no optimum, with max_q d_q = n + left.

    The least eigenvalue of Gamma^-1 Gamma* with a trace of at most n + left and an inverse of
    trace at most n, times n; so it holds for information of any rank.
    """
    least = 1.0 + 0.5 * left - 0.5 * np.sqrt(left * (4.0 + left - 4.0 / n))
    return float(n * least * (1.0 - 1e-9))


def largest_remainder(share: Array, total: int) -> Integers:
    """Whole counts of sum `total` by the largest remainder (Hamilton), shape (Q,).

    Of equal remainders the first are rounded up.
    """
    exact = share / np.sum(share) * total
    counts = np.floor(exact + 1e-9).astype(np.int64)
    remainder = np.round(exact - counts, 9)
    order = np.argsort(-remainder, kind="stable")
    counts[order[: total - int(np.sum(counts))]] += 1
    return counts
