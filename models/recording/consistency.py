"""Whether pose, velocity and acceleration of a recording belong together, and how they do.

    eta_dot = J(eta) nu,    nu_dot = d nu / dt

The derivative of the pose in body axes is compared with the recorded velocity per axis, and the
derivative of the velocity with the recorded acceleration. What does not agree is tried again as
people record it: with axes exchanged or reversed, velocities along the axes of the earth, poses in
ENU for NED, headings that count anticlockwise or from east, and clocks that are apart. The simplest
reading that agrees as well as the best one is taken.

The correlation says whether two signals are of the same motion, the scale whether they are in the
same unit. Both signals have errors, so the scale is that of total least squares on signals of equal
noise-to-signal ratio, sign(rho) sigma_y / sigma_x. The two regressions bound it, rho sigma_y /
sigma_x and sigma_y / (rho sigma_x): Frisch (1934). A low-passed signal of T seconds has about
2 f_c T independent samples, which give the standard error of a correlation by Fisher's z.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from seatrial.models.notation import DOFS
from seatrial.models.recording.motion import PLAIN, READINGS, Motion, Reading
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array

BANDS = (0.25, 0.1, 0.04)  # of the Nyquist frequency: cut-offs of the low-pass, widest first
MIN_INDEPENDENT = 30  # independent samples that a correlation needs
AS_GOOD = 0.03  # mean squared correlation by which a simpler reading may be worse
DEGREE = np.pi / 180.0
LONGEST_LAG_S = 5.0  # [s]
SURE = 0.5  # correlation of an axis whose scale is known
LEAST_TRUSTED = 0.3  # correlation of an excited axis below which a trial refuses a recording
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


@dataclass(frozen=True)
class Consistency:
    """Agreement of each axis as recorded, and how the recording agrees best.

    `best` are the agreements with `reading`, axes exchanged where that is significantly better and
    velocities shifted by `lag_s`, by which they are behind the pose.
    """

    velocities: tuple[Agreement, ...]
    accelerations: tuple[Agreement, ...]
    best: tuple[Agreement, ...]
    reading: Reading
    lag_s: float
    shared_lag_s: float  # of all axes; what exceeds it is the delay of a filter
    lag_error_s: float
    period_s: float
    cutoff_hz: float
    samples: float  # independent ones below the cut-off

    @property
    def untrusted(self) -> tuple[Agreement, ...]:
        """Excited axes whose correlation is too low for an identification."""
        axes = (*self.velocities, *self.accelerations)
        return tuple(a for a in axes if a.excited and a.correlation < LEAST_TRUSTED)

    def significant(self, axis: Agreement) -> bool:
        """Whether an axis agrees at all, with either sign."""
        error = 1.0 / np.sqrt(max(self.samples - 3.0, 1.0))
        return bool(fisher(np.array(axis.correlation)) > CERTAIN * error)


def consistency(
    recording: Recording, measured: Sequence[str] = (), recorded: Sequence[str] | None = None
) -> Consistency:
    """Compare the pose, the velocity and the acceleration of a recording.

    Args:
        recording: the recording.
        measured: axes whose acceleration is recorded, not differentiated.
        recorded: axes whose velocity is recorded, not differentiated; None: all.
    """
    motion = Motion(recording, recorded)
    cutoff = _best_band(motion)
    both = [axis for dofs in (motion.linear, motion.angular)
            for axis in _compared(motion, dofs, cutoff, exchanged=False)]  # fmt: skip
    plain = tuple(sorted(both, key=lambda axis: motion.dofs.index(axis.dof)))
    lag_s = 0.0
    while True:  # a lag of half a period would look like a wrong sign: shift and look once more
        shifted = Motion(_ahead(recording, lag_s), recorded)
        cutoff = _best_band(shifted)
        reading, best = _best_reading(shifted, cutoff)
        more, error = _lag(shifted, cutoff, reading, best)
        first = lag_s == 0.0
        lag_s += more
        if not first or abs(more) < recording.period_s:
            break
    # A clock that is apart delays all axes alike, a filter some more than others: the lag of the
    # axis that is nearest to the pose, 0 if axes are on both sides of it.
    shifted = Motion(_ahead(recording, lag_s), recorded)
    own = [
        lag_s + _lag(shifted, cutoff, reading, (axis,))[0]
        for axis in best
        if axis.excited and abs(axis.correlation) > SURE
    ]
    shared = min(own, key=abs) if own and not min(own) < 0.0 < max(own) else 0.0
    return Consistency(
        plain, _accelerations(motion, cutoff, measured), best, reading, lag_s, shared, error,
        recording.period_s, cutoff, motion.samples(cutoff),
    )  # fmt: skip


def _best_band(motion: Motion) -> float:
    """Cut-off [Hz] of the widest band in which velocities and rates agree best, in any order.

    Bands with fewer than `MIN_INDEPENDENT` independent samples are left out.
    """
    nyquist = 0.5 / motion.period_s
    best, result = -1.0, BANDS[0] * nyquist
    for band in BANDS:
        cutoff = band * nyquist
        if band != BANDS[0] and motion.samples(cutoff) < MIN_INDEPENDENT:
            break
        score = 0.0
        for dofs in filter(None, (motion.angular, motion.linear)):
            rho = correlations(motion.velocity(dofs, cutoff), motion.rates(dofs, cutoff))
            score += float(np.mean(np.max(np.abs(rho), axis=1)))
        if score > best + AS_GOOD:
            best, result = score, cutoff
    return result


def _best_reading(motion: Motion, cutoff_hz: float) -> tuple[Reading, tuple[Agreement, ...]]:
    """The simplest reading that agrees as well as the best one, and the agreement of its axes."""
    tried: list[tuple[float, float, Reading, tuple[Agreement, ...]]] = []
    for reading in READINGS if motion.turns else READINGS[:1]:
        if tried and tried[0][0] >= 1.0 - AS_GOOD and tried[0][1] == 0.0:
            break  # nothing is simpler or better
        axes = (
            *_compared(motion, motion.linear, cutoff_hz, reading),
            *_compared(motion, motion.angular, cutoff_hz, reading),
        )
        known = [axis for axis in axes if motion.moves(axis.dof, cutoff_hz)]
        score = float(np.mean([axis.correlation**2 for axis in known])) if known else 0.0
        flips = sum(axis.correlation < 0.0 for axis in known)
        exchanges = sum(axis.other != axis.dof for axis in axes) / 2.0
        tried.append((score, reading.changes + flips + exchanges, reading, axes))
    best = max(score for score, *_ in tried)
    as_good = [row for row in tried if row[0] >= best - AS_GOOD]
    _, _, reading, axes = min(as_good, key=lambda row: row[1])
    return reading, axes


def _compared(
    motion: Motion, dofs: Sequence[str], cutoff_hz: float, reading: Reading = PLAIN,
    exchanged: bool = True,
) -> tuple[Agreement, ...]:  # fmt: skip
    """Agreement of each axis, with the axes exchanged if that is significantly better."""
    if not dofs:
        return ()
    observed, expected = motion.velocity(dofs, cutoff_hz), motion.rates(dofs, cutoff_hz, reading)
    rho = correlations(observed, expected)
    order = tuple(range(len(dofs)))
    if exchanged and len(dofs) > 1:
        moving = [motion.moves(dof, cutoff_hz) for dof in dofs]
        order = best_order(rho, moving, motion.samples(cutoff_hz))
    return tuple(
        Agreement(
            dof, dofs[j], float(rho[i, j]),
            scale_of(observed[:, i], expected[:, j], float(rho[i, j])),
            i != j or motion.excited(dof, observed[:, i], expected[:, i], cutoff_hz),
        )
        for i, (dof, j) in enumerate(zip(dofs, order, strict=True))
    )  # fmt: skip


def in_degrees(recording: Recording, recorded: Sequence[str], cutoff_hz: float) -> tuple[str, ...]:
    """The angles whose derivatives are about 57.3 times the recorded angular velocities.

    The derivatives are those of each angle by itself: one angle in degrees would spoil the others
    in a rotation. What exceeds 98 % of them is cut, since a heading of 360 degrees jumps to zero.
    """
    motion, large = Motion(recording, recorded), []
    for dof in motion.angular:
        rate = motion.derivative(recording.attitude[:, [DOFS[3:].index(dof)]])
        expected = motion.inside(np.clip(rate, *np.percentile(rate, (2.0, 98.0))), cutoff_hz)
        observed = motion.velocity([dof], cutoff_hz)
        rho = float(correlations(observed, expected)[0, 0])
        scale = abs(scale_of(observed[:, 0], expected[:, 0], rho))
        if abs(rho) > SURE and 0.5 < scale * DEGREE < 2.0:
            large.append(dof)
    return tuple(large)


def _ahead(recording: Recording, seconds: float) -> Recording:
    """The recording with the velocities that each piece holds `seconds` later."""
    if seconds == 0.0:
        return recording
    cuts = np.flatnonzero(recording.piece_starts)[1:]
    pieces = zip(np.split(recording.t, cuts), np.split(recording.nu, cuts), strict=True)
    later = [np.column_stack([np.interp(t + seconds, t, x) for x in nu.T]) for t, nu in pieces]
    return replace(recording, nu=np.concatenate(later))


def _lag(
    motion: Motion, cutoff_hz: float, reading: Reading, axes: Sequence[Agreement]
) -> tuple[float, float]:
    """By how much the velocities are behind the pose, and its standard error [s].

    The error of a delay between band-limited signals of correlation rho with n independent samples
    is sqrt((1 / rho^2 - 1) / n) / (2 pi f_rms); Carter (1987), Proc IEEE 75(2).
    """
    used = [axis for axis in axes if axis.excited]
    period = motion.period_s
    if not used:
        return 0.0, np.inf
    observed = motion.velocity([axis.dof for axis in used], cutoff_hz)
    expected = motion.rates([axis.other for axis in used], cutoff_hz, reading)
    observed = observed * np.sign([axis.scale for axis in used])
    most = round(LONGEST_LAG_S / period)
    seconds = lag(observed, expected, most) * period
    rho = max(abs(axis.correlation) for axis in used)
    share = max(1.0 / max(rho, 0.01) ** 2 - 1.0, 1e-6)
    error = np.sqrt(share / motion.samples(cutoff_hz)) / (2.0 * np.pi * cutoff_hz / np.sqrt(3.0))
    return seconds, float(error)


def _accelerations(
    motion: Motion, cutoff_hz: float, measured: Sequence[str]
) -> tuple[Agreement, ...]:
    """Agreement of the recorded accelerations with the derivative of the velocities."""
    dofs = [dof for dof in motion.dofs if dof in measured]
    if not dofs:
        return ()
    recording, index = motion.recording, [motion.dofs.index(dof) for dof in dofs]
    observed = motion.inside(recording.nu_dot[:, index], cutoff_hz)
    expected = motion.inside(motion.derivative(recording.nu[:, index]), cutoff_hz)
    rho = np.diag(correlations(observed, expected))
    return tuple(
        Agreement(
            dof, dof, float(rho[i]), scale_of(observed[:, i], expected[:, i], float(rho[i])),
            motion.accelerates(dof, observed[:, i], expected[:, i], cutoff_hz),
        )
        for i, dof in enumerate(dofs)
    )  # fmt: skip


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
