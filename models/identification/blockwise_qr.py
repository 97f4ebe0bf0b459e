"""Factorisations of tall matrices, one row a sample, piece by piece.

LAPACK sweeps over a whole matrix once a column; a piece of some thousand rows stays in the
processor's cache meanwhile, and most of it need not be in memory. R of the rows so far with the
next piece below it has the R of all of them, and a product of factors with orthonormal columns
has orthonormal columns: Golub and Van Loan (2013), Matrix Computations, section 5.2; Demmel,
Grigori, Hoemmen and Langou (2012), SIAM J. Sci. Comput. 34, A206-A239.
"""

from collections.abc import Iterable

import numpy as np

from seatrial.models.vessel.basis import Array

TOGETHER = 2048  # rows


def turns(n: int) -> list[slice]:
    """n rows, `TOGETHER` at a time."""
    return [slice(a, min(a + TOGETHER, n)) for a in range(0, n, TOGETHER)]


def triangle(pieces: Iterable[Array]) -> Array:
    """R of the QR factorisation of the pieces below one another, one in memory at a time."""
    R: Array | None = None
    for piece in pieces:
        below = piece if R is None else np.vstack([R, piece])
        R = np.asarray(np.linalg.qr(below, mode="r"), dtype=np.float64)
    if R is None:
        raise ValueError("triangle: got no rows")
    return R


def qr(x: Array) -> tuple[Array, Array]:
    """Q (N, P) and R (P, P) of x (N, P), N at least P; Q may take the place of x."""
    rows = max(TOGETHER, 4 * x.shape[1])
    if len(x) < 2 * rows:
        Q, R = np.linalg.qr(x)
        return Q, R
    pieces = np.array_split(x, len(x) // rows)  # views
    factors = []
    for piece in pieces:
        piece[:], R = np.linalg.qr(piece)
        factors.append(R)
    turned, R = np.linalg.qr(np.vstack(factors))
    for piece, turn in zip(pieces, np.split(turned, len(pieces)), strict=True):
        piece[:] = piece @ turn
    return x, R


def svd(x: Array) -> tuple[Array, Array, Array]:
    """U (N, P), singular values (P,) and V' (P, P) of x (N, P); U may take the place of x."""
    if len(x) < 2 * TOGETHER:
        u, s, vt = np.linalg.svd(x, full_matrices=False)
        return u, s, vt
    Q, R = qr(x)
    u, s, vt = np.linalg.svd(R)
    for turn in turns(len(Q)):
        Q[turn] = Q[turn] @ u
    return Q, s, vt
