"""Whether pose, velocity and acceleration of a recording belong together.

    eta_dot = J(eta) nu,    nu_dot = d nu / dt

The derivative of the pose in body axes is compared with the recorded velocity per axis, and the
derivative of the velocity with the recorded acceleration.

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

from seatrial.models.notation import DOFS
from seatrial.models.recording.motion import Motion
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import noise_floor
from seatrial.models.vessel.basis import Array

BANDS = (0.25, 0.1, 0.04)  # of the Nyquist frequency: cut-offs of the low-pass, widest first
MIN_INDEPENDENT = 30  # independent samples that a correlation needs
AS_GOOD = 0.03  # agreement by which a simpler map, or a wider band, may be worse
LONGEST_LAG_S = 5.0  # [s]
SURE = 0.5  # correlation of an axis whose scale is known
LEAST_TRUSTED = 0.3  # correlation of an excited axis below which a trial refuses a recording
SAME_SCALE = 1.39  # scales within this factor of one are nearer to it than to the knot
CERTAIN = 3.0  # standard errors that make a difference of two correlations
LEAST_ENERGY = 0.25  # of the largest, by which a part of a signal is normalised
ALMOST_ONE = 0.999  # correlations above it are equal


@dataclass(frozen=True)
class Agreement:
    """Agreement of a recorded velocity or acceleration with the derivative of what it changes.

    `scale` times the recorded values is the derivative.
    """

    kind: str  # velocity | acceleration
    dof: str
    correlation: float  # of the sign of the scale
    scale: float
    moves: bool  # the recorded signal varies more than its noise
    excited: bool  # both signals do
    significant: bool  # the correlation, of either sign, is not that of independent signals

    @property
    def quality(self) -> float:
        """Squared correlation with its sign, less for a scale other than one; at most 1."""
        size = max(abs(self.scale), 1e-9)
        return self.correlation * abs(self.correlation) * 2.0 / (size + 1.0 / size)

    @property
    def off(self) -> bool:
        """Whether neither regression gives a scale near one."""
        rho, size = max(abs(self.correlation), 1e-6), abs(self.scale)
        return size / rho < 1.0 / SAME_SCALE or rho * size > SAME_SCALE

    @property
    def certain(self) -> bool:
        """Whether the axis says something of signs and scales."""
        return self.excited and self.significant


@dataclass(frozen=True)
class Consistency:
    """Agreement of each axis, and by how much the velocities are behind the pose.

    `order` tells of which axis the derivative of the pose belongs to a recorded velocity.
    """

    velocities: tuple[Agreement, ...]
    accelerations: tuple[Agreement, ...]
    order: dict[str, str]
    lag_s: float
    shared_lag_s: float  # of all axes; what exceeds it is the delay of a filter
    lag_error_s: float
    band: float  # cut-off, of the Nyquist frequency
    cutoff_hz: float

    @property
    def axes(self) -> tuple[Agreement, ...]:
        """Velocities and accelerations."""
        return (*self.velocities, *self.accelerations)

    @property
    def quality(self) -> float:
        """Mean quality of all axes that move."""
        known = [axis.quality for axis in self.axes if axis.moves]
        return float(np.mean(known)) if known else 0.0

    @property
    def untrusted(self) -> tuple[Agreement, ...]:
        """Excited axes whose correlation is too low for an identification."""
        return tuple(a for a in self.axes if a.excited and a.correlation < LEAST_TRUSTED)


def consistency(
    recording: Recording,
    measured: Sequence[str] = (),
    recorded: Sequence[str] | None = None,
    band: float | None = None,
) -> Consistency:
    """Compare the pose, the velocity and the acceleration of a recording.

    Args:
        recording: the recording.
        measured: axes whose acceleration is recorded, not differentiated.
        recorded: axes whose velocity is recorded, not differentiated; None: all.
        band: cut-off of the low-pass, of the Nyquist frequency; None: where they agree best.
    """
    motion = Motion(recording, recorded)
    nyquist = 0.5 / motion.period_s
    band = band or _best_band(motion)
    cutoff = band * nyquist
    noise = noise_floor(recording.nu, recording.piece_starts, motion.period_s).deviation
    samples, order = motion.samples(cutoff), dict[str, str]()

    def agreement(kind: str, dof: str, observed: Array, expected: Array) -> Agreement:
        deviation = float(noise[motion.dofs.index(dof)])
        own, other = deviation, float(motion.pose_noise[DOFS.index(dof)])
        if kind == "acceleration":
            own, other = 0.0, deviation
        rho = float(correlations(observed[:, None], expected[:, None])[0, 0])
        moves = motion.exceeds(observed, own, cutoff)
        excited = moves and motion.exceeds(expected, other, cutoff, order=1)
        sure = bool(fisher(np.array(rho)) > CERTAIN * _error(samples))
        return Agreement(kind, dof, rho, scale_of(observed, expected, rho), moves, excited, sure)

    axes, pairs = {}, {}
    for dofs in filter(None, (motion.linear, motion.angular)):
        observed, expected = motion.velocity(dofs, cutoff), motion.rates(dofs, cutoff)
        for i, dof in enumerate(dofs):
            axes[dof] = agreement("velocity", dof, observed[:, i], expected[:, i])
            pairs[dof] = observed[:, i], expected[:, i]
        moving = [axes[dof].moves for dof in dofs]
        best = best_order(correlations(observed, expected), moving, samples)
        order |= {dof: dofs[j] for dof, j in zip(dofs, best, strict=True)}
    accelerations = []
    for dof in (dof for dof in motion.dofs if dof in measured):
        own = [motion.dofs.index(dof)]
        observed = motion.inside(recording.nu_dot[:, own], cutoff)
        expected = motion.inside(motion.derivative(recording.nu[:, own]), cutoff)
        accelerations.append(agreement("acceleration", dof, observed[:, 0], expected[:, 0]))
    used = [pairs[dof] for dof, axis in axes.items() if axis.excited]
    return Consistency(
        tuple(axes[dof] for dof in motion.dofs if dof in axes), tuple(accelerations), order,
        *_lags(used, motion, cutoff), band, cutoff,
    )  # fmt: skip


def _best_band(motion: Motion) -> float:
    """The widest band in which velocities and rates agree best, in any order.

    Bands with fewer than `MIN_INDEPENDENT` independent samples are left out.
    """
    best, result = -1.0, BANDS[0]
    for band in BANDS:
        cutoff = 0.5 * band / motion.period_s
        if band != BANDS[0] and motion.samples(cutoff) < MIN_INDEPENDENT:
            break
        score = 0.0
        for dofs in filter(None, (motion.angular, motion.linear)):
            rho = correlations(motion.velocity(dofs, cutoff), motion.rates(dofs, cutoff))
            score += float(np.mean(np.max(np.abs(rho), axis=1)))
        if score > best + AS_GOOD:
            best, result = score, band
    return result


def _lags(
    pairs: Sequence[tuple[Array, Array]], motion: Motion, cutoff_hz: float
) -> tuple[float, float, float]:
    """By how much velocities are behind the pose, by how much all are, and the standard error [s].

    The error of a delay between band-limited signals of correlation rho with n independent samples
    is sqrt((1 / rho^2 - 1) / n) / (2 pi f_rms); Carter (1987), Proc IEEE 75(2). A clock that is
    apart delays all axes alike, a filter some more than others: all axes are behind by the lag of
    the one that is nearest to the pose, 0 if axes are on both sides of it.
    """
    if not pairs:
        return 0.0, 0.0, np.inf
    period = motion.period_s
    observed, expected = (np.column_stack([pair[k] for pair in pairs]) for k in (0, 1))
    total = lag(observed, expected, round(LONGEST_LAG_S / period))
    k = round(total)
    observed = observed[max(k, 0) : len(observed) + min(k, 0)]
    expected = expected[max(-k, 0) : len(expected) - max(k, 0)]
    rho = np.diag(correlations(observed, expected))
    near = max(round(0.5 / cutoff_hz / period), 1)  # a later peak is another one
    own = [k + lag(np.sign(rho[i]) * observed[:, [i]], expected[:, [i]], near)
           for i in np.flatnonzero(np.abs(rho) > SURE)]  # fmt: skip
    shared = min(own, key=abs) if own and not min(own) < 0.0 < max(own) else 0.0
    most = float(np.max(np.abs(rho)))
    share = max(1.0 / max(most, 0.01) ** 2 - 1.0, 1e-6)
    error = np.sqrt(share / motion.samples(cutoff_hz)) / (2.0 * np.pi * cutoff_hz / np.sqrt(3.0))
    return total * period, shared * period, float(error)


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


def best_order(rho: Array, moving: Sequence[bool], samples: float) -> tuple[int, ...]:
    """The order of the expected axes that agrees best with the observed ones; rho (k, k).

    Axes stay as they are unless exchanging them makes a significant difference: the sum of Fisher's
    z over the moving axes must rise by `CERTAIN` standard errors. `samples` are independent ones.
    """
    z, straight = fisher(rho), tuple(range(len(rho)))

    def gain(order: Sequence[int]) -> float:
        moved = [i for i in straight if order[i] != i and moving[i]]
        better = [float(z[i, order[i]] - z[i, i]) for i in moved]
        sure = all(difference > 0.0 for difference in better)
        return sum(better) - CERTAIN * _error(samples) * len(moved) if sure else -1.0

    return max(permutations(straight), key=gain)


def fisher(rho: Array) -> Array:
    """Fisher's z of the size of correlations; its standard error is 1 / sqrt(n - 3)."""
    return np.asarray(np.arctanh(np.minimum(np.abs(rho), ALMOST_ONE)))


def _error(samples: float) -> float:
    """Standard error of Fisher's z."""
    return float(1.0 / np.sqrt(max(samples - 3.0, 1.0)))


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
