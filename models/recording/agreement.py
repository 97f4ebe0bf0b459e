"""How well two sets of signals that should be equal agree, axis by axis.

The correlation says whether two signals are of the same motion, the scale whether they are in the
same unit. Both signals have errors, so the scale is that of total least squares on signals of equal
noise-to-signal ratio, sign(rho) sigma_y / sigma_x. The two regressions bound it, rho sigma_y /
sigma_x and sigma_y / (rho sigma_x): Frisch (1934). A low-passed signal of T seconds has about
2 f_c T independent samples, which give the standard error of a correlation by Fisher's z.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from seatrial.models.vessel.basis import Array

CERTAIN = 3.0  # standard errors that make a difference of two correlations
LEAST_ENERGY = 0.25  # of the largest, by which a part of a signal is normalised
ALMOST_ONE = 0.999  # correlations above it are equal


@dataclass(frozen=True)
class Agreement:
    """Agreement of a recorded velocity or acceleration with the derivative of what it changes.

    `scale` times the recorded values is the derivative. `other` is the axis whose derivative was
    compared, usually `dof` itself.
    """

    dof: str
    other: str
    correlation: float  # of the sign of the scale
    scale: float
    excited: bool  # both signals vary more than their noise

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest size of the scale, from the regression of each on the other."""
        rho = max(abs(self.correlation), 1e-6)
        return rho * abs(self.scale), abs(self.scale) / rho


def correlations(observed: Array, expected: Array) -> Array:
    """Correlation of every column of (N, k) with every column of (N, m), shape (k, m).

    Zero where a column is constant.
    """
    a, b = (signals - np.mean(signals, axis=0) for signals in (observed, expected))
    size = np.outer(np.linalg.norm(a, axis=0), np.linalg.norm(b, axis=0))
    return np.asarray(np.divide(a.T @ b, size, out=np.zeros_like(size), where=size > 0.0))


def scale_of(observed: Array, expected: Array, correlation: float) -> float:
    """The factor on `observed` (N,) that gives `expected` (N,), both with errors; 1 if unknown.

    Means count if they exceed the variation, as the forward speed of a ship on its way does.
    """
    if all(abs(np.mean(x)) > np.std(x) for x in (observed, expected)):
        return float(np.mean(expected) / np.mean(observed))
    size = float(np.std(observed))
    if not size > 0.0 or not np.std(expected) > 0.0:
        return 1.0
    return float(np.copysign(np.std(expected) / size, correlation))


def best_order(rho: Array, excited: Sequence[bool], samples: float) -> tuple[int, ...]:
    """The order of the expected axes that agrees best with the observed ones; rho (k, k).

    Axes stay as they are unless exchanging them makes a significant difference: the sum of Fisher's
    z over the excited axes must rise by `CERTAIN` standard errors. `samples` are independent ones.
    """
    k = len(rho)
    straight = tuple(range(k))
    z = fisher(rho)
    error = 1.0 / np.sqrt(max(samples - 3.0, 1.0))

    def gain(order: Sequence[int]) -> float:
        moved = [i for i in range(k) if order[i] != i and excited[i]]
        better = sum(float(z[i, order[i]] - z[i, i]) for i in moved)
        return better - CERTAIN * float(error) * len(moved)

    best = max(permutations(straight), key=gain)
    moved = [i for i in straight if best[i] != i]
    sure = gain(best) > 0.0 and all(
        abs(rho[i, best[i]]) > abs(rho[i, i]) for i in moved if excited[i]
    )
    return best if sure else straight


def fisher(rho: Array) -> Array:
    """Fisher's z of the size of correlations; its standard error is 1 / sqrt(n - 3)."""
    return np.asarray(np.arctanh(np.minimum(np.abs(rho), ALMOST_ONE)))


def lag(
    observed: Array, expected: Array, most: int, known: NDArray[np.bool_] | None = None
) -> float:
    """By how many samples `observed` (N, k) is behind `expected` (N, k), to a fraction of one.

    The peak of the sum of the normalised cross-correlations of the columns, which must agree in
    sign, within `most` samples to both sides; a parabola through its three largest values. Where
    `expected` is not known everywhere, `known` (N,) says where; what is observed at these times,
    after the shift, is normalised alone.
    """
    most = min(most, len(observed) // 4)
    if most < 1 or (known is not None and not np.any(known)):
        return 0.0
    a = observed - np.mean(observed, axis=0)
    b = expected - np.mean(expected if known is None else expected[known], axis=0)
    energy = np.sum(a * a, axis=0, keepdims=True)
    if known is not None:
        b[~known] = 0.0
        energy = _shifted(a * a, known[:, None].astype(np.float64))
        energy = np.maximum(energy, LEAST_ENERGY * np.max(energy, axis=0))
    size = np.sqrt(energy * np.sum(b * b, axis=0))
    valid = np.max(size, axis=0) > 0.0
    if not np.any(valid):
        return 0.0
    sums = np.sum(_shifted(a[:, valid], b[:, valid]) / size[:, valid], axis=1)
    shifts = np.arange(-most, most + 1)
    values = sums[shifts]
    peak = int(np.argmax(values))
    if peak in (0, len(values) - 1):
        return float(shifts[peak])
    before, top, after = values[peak - 1 : peak + 2]
    bend = before - 2.0 * top + after
    inside = 0.5 * float(before - after) / float(bend) if bend < 0.0 else 0.0
    return float(shifts[peak] + inside)


def _shifted(a: Array, b: Array) -> Array:
    """The sums of a[t + s] b[t] over t, at index s (negative from the end), shape (n, k)."""
    n = 1 << (2 * len(a) - 1).bit_length()
    spectrum = np.fft.rfft(a, n, axis=0) * np.conj(np.fft.rfft(b, n, axis=0))
    return np.asarray(np.fft.irfft(spectrum, n, axis=0))
