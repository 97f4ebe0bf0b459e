"""Block Hankel matrices of sampled data, their triangular factor, and the share of the past.

Rows of the matrices here are windows in time, columns the samples in a window: the transpose of
the literature's. Windows never reach across a gap in the data, and a bootstrap may repeat them.
Only some rows are in memory at a time, so that a long record needs no more than a short one.
"""

from typing import NamedTuple

import numpy as np

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.blockwise_qr import triangle, turns
from seatrial.models.vessel.basis import Array, Codes

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


class Window(NamedTuple):
    """A block of the Hankel matrix: x_{k+first} ... x_{k+first+length-1} for a window from k on."""

    x: Array  # (N, m)
    first: int
    length: int


def hankel(blocks: list[Window], rows: Codes) -> Array:
    """Transposed block Hankel matrices beside each other, of the windows that start at `rows`."""
    return np.hstack([
        x[rows[:, None] + np.arange(first, first + length)].reshape(len(rows), length * x.shape[1])
        for x, first, length in blocks
    ])  # fmt: skip


def triangular(blocks: list[Window], rows: Codes) -> Array:
    """R, lower triangular, of the LQ factorisation of the stacked block Hankel matrices.

    Raises IdentificationError when there are too few windows, or the inputs (the first block) do
    not excite every direction.
    """
    columns = sum(length * x.shape[1] for x, _, length in blocks)
    if len(rows) < columns:
        raise IdentificationError(
            f"got {len(rows)} windows of data, expected at least {columns}: "
            f"use a longer recording, a shorter period, or smaller L and J"
        )
    R = triangle(hankel(blocks, rows[turn]) for turn in turns(len(rows))).T
    inputs = blocks[0].length * blocks[0].x.shape[1]
    excitation = np.linalg.svd(R[:inputs, :inputs], compute_uv=False)
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
    known = [Window(record.u, 0, J), Window(record.y, 0, J)]
    known += [Window(record.u, J, 1)] if feedthrough else []
    count = sum(one.length * one.x.shape[1] for one in known)
    rows = starts(record, J + 1)
    if len(rows) <= count:
        raise IdentificationError(
            f"got {len(rows)} windows of {J} past samples, expected more than {count}"
        )
    both = [*known, Window(record.y, J, 1)]
    R = triangle(hankel(both, rows[turn]) for turn in turns(len(rows)))
    coefficients = np.linalg.lstsq(R[:, :count], R[:, count:], rcond=1e-12)[0]
    every = starts(record._replace(times=np.arange(len(record.y))), J + 1)
    parts = [hankel(known, every[turn]) @ coefficients for turn in turns(len(every))]
    explained, y = np.vstack(parts), record.y[every + J]
    position = np.full(len(record.y), -1)
    position[every + J] = np.arange(len(every))
    times = position[record.times]
    shorter = Record(explained, record.u[every + J], record.stretch[every + J], times[times >= 0])
    return shorter, shorter._replace(y=y - explained)
