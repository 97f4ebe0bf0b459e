"""Block Hankel matrices of sampled data, their triangular factor, and the share of the past.

Rows of the matrices here are windows in time, columns the samples in a window: the transpose of
the literature's. Windows never reach across a gap in the data, and a bootstrap may repeat them.
"""

from typing import NamedTuple

import numpy as np

from models.basis import Array, Codes
from models.errors import IdentificationError

EXCITED = 1e-11  # smallest to largest singular value of the inputs' Hankel matrix


class Record(NamedTuple):
    """Normalised data; `stretch` numbers the contiguous parts, `times` are the samples used."""

    y: Array  # (N, m)
    u: Array  # (N, r)
    stretch: Codes  # (N,), not decreasing
    times: Codes  # a window counts as often as its first sample is in here


def stretches(values: Array, stretch: Codes) -> list[Array]:
    """The rows of each contiguous part."""
    return list(np.split(values, np.flatnonzero(np.diff(stretch)) + 1))


def starts(record: Record, length: int) -> Codes:
    """First samples of the windows of `length` samples that lie within one stretch."""
    n = len(record.y) - length + 1
    whole = record.stretch[length - 1 :] == record.stretch[: max(n, 0)]
    kept = record.times[record.times < n]
    return np.asarray(kept[whole[kept]])


def hankel(x: Array, rows: Codes, first: int, count: int) -> Array:
    """Transposed block Hankel matrix: x_{k+first} ... x_{k+first+count-1} for k in `rows`."""
    window = rows[:, None] + np.arange(first, first + count)
    return np.asarray(x[window].reshape(len(rows), count * x.shape[1]))


def triangular(blocks: list[Array]) -> Array:
    """R, lower triangular, of the LQ factorisation of the stacked block Hankel matrices.

    Raises IdentificationError when there are too few windows, or the inputs (the first block) do
    not excite every direction.
    """
    rows, columns = len(blocks[0]), sum(block.shape[1] for block in blocks)
    if rows < columns:
        raise IdentificationError(
            f"got {rows} windows of data, expected at least {columns}: "
            f"use a longer recording, a shorter period, or smaller L and J"
        )
    R = np.asarray(np.linalg.qr(np.hstack(blocks), mode="r"), dtype=np.float64).T
    excitation = np.linalg.svd(R[: blocks[0].shape[1], : blocks[0].shape[1]], compute_uv=False)
    if excitation[-1] < EXCITED * excitation[0]:
        raise IdentificationError(
            f"the inputs do not excite all {len(excitation)} directions of L samples: "
            f"singular values fall to {excitation[-1] / excitation[0]:.1e} of the largest"
        )
    return R


def explained_by_past(record: Record, J: int, feedthrough: bool) -> tuple[Record, Record]:
    """y_k - e_k and e_k, the least-squares prediction from J past samples and its error.

    The first J samples of every stretch are lost.
    """

    def regressors(rows: Codes) -> Array:
        past = [hankel(record.u, rows, 0, J), hankel(record.y, rows, 0, J)]
        return np.hstack([*past, record.u[rows + J]] if feedthrough else past)

    rows = starts(record, J + 1)
    chosen = regressors(rows)
    if len(rows) <= chosen.shape[1]:
        raise IdentificationError(
            f"got {len(rows)} windows of {J} past samples, expected more than {chosen.shape[1]}"
        )
    coefficients = np.linalg.lstsq(chosen, record.y[rows + J], rcond=1e-12)[0]
    every = starts(record._replace(times=np.arange(len(record.y))), J + 1)
    y = record.y[every + J]
    explained = regressors(every) @ coefficients
    position = np.full(len(record.y), -1)
    position[every + J] = np.arange(len(every))
    times = position[record.times]
    shorter = Record(explained, record.u[every + J], record.stretch[every + J], times[times >= 0])
    return shorter, shorter._replace(y=y - explained)
