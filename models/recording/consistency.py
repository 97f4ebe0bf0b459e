"""Whether pose and velocity of a recording belong together: eta_dot = J(eta) nu.

The derivative of the pose in body axes is compared with the recorded velocity per axis.

Velocities are R(attitude)' p_dot, angular ones those of the rotation, so that angles may jump. All
signals are low-passed forward and backward, so that their phases stay, and the ends of each piece,
where the filter lacks data, are left out.

The correlation says whether two signals are of the same motion, the scale whether they are in the
same unit. Both signals have errors, so the scale is that of total least squares on signals of equal
noise-to-signal ratio, sign(rho) sigma_y / sigma_x. The two regressions bound it, rho sigma_y /
sigma_x and sigma_y / (rho sigma_x): Frisch (1934). A low-passed signal of T seconds has about
2 f_c T independent samples, which give the standard error of a correlation by Fisher's z.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
import scipy

from seatrial.models.notation import DOFS, PLANAR, POSE_UNIT, VELOCITY_UNIT
from seatrial.models.recording.preprocessing import central_difference, in_body
from seatrial.models.recording.recording import MIN_PIECE, Recording, attitude_of, piecewise
from seatrial.models.recording.sampling import STRAIGHT_LINE
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian, turned

BANDS = (0.25, 0.1, 0.04)  # of the Nyquist frequency: cut-offs of the low-pass, widest first
MIN_INDEPENDENT = 30  # independent samples that a correlation needs
AS_GOOD = 0.03  # agreement by which a simpler map, or a wider band, may be worse
LONGEST_LAG_S = 5.0  # [s]
SURE = 0.5  # correlation of an axis whose scale is known
LEAST_TRUSTED = 0.3  # correlation of an excited axis below which a trial refuses a recording
SAME_SCALE = 1.39  # scales within this factor of one are nearer to it than to the knot
CERTAIN = 3.0  # standard errors that make a difference of two correlations
EXCITED_VARIANCE = 10.0  # variance of an excited signal, in that of its noise below the cut-off
CONSTANT_VARIANCE = 1e-12  # variance of a signal that does not move
BLOCK, REGULAR = 100, 80  # samples among which jumps are looked for, and those that are none
JUMP = 10.0  # times the largest second difference of these
ALMOST_ONE = 0.999  # correlations above it are equal


@dataclass(frozen=True)
class Agreement:
    """Agreement of a recorded velocity with the derivative of the pose.

    `scale` times the recorded values is the derivative.
    """

    dof: str
    correlation: float  # of the sign of the scale
    scale: float
    steady: bool  # the means of both signals exceed their variation, and tell the scale
    moves: bool  # the recorded signal varies more than its noise
    excited: bool  # both signals do
    certain: bool  # so does their correlation, of either sign, more than of independent signals

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


@dataclass(frozen=True)
class Consistency:
    """Agreement of each axis, and by how much the velocities are behind the pose.

    `swaps` are pairs of axes that agree better if their velocities are exchanged.
    """

    axes: tuple[Agreement, ...]
    swaps: tuple[tuple[str, str], ...]
    lag_s: float
    shared_lag_s: float  # of all axes; what exceeds it is the delay of a filter
    lag_error_s: float
    band: float  # cut-off, of the Nyquist frequency
    cutoff_hz: float

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
    recording: Recording, recorded: Sequence[str] | None = None, band: float | None = None
) -> Consistency:
    """Compare the pose and the velocity of a recording.

    Args:
        recording: the recording.
        recorded: axes whose velocity is recorded, not differentiated from the pose, with which it
            would agree by construction; None: all.
        band: cut-off of the low-pass, of the Nyquist frequency; None: where they agree best.
    """
    dofs, signals, noise = _compared(recording, recorded)
    groups = [[i for i, dof in enumerate(dofs) if dof in DOFS[k : k + 3]] for k in (0, 3)]
    groups, period = [group for group in groups if group], recording.period_s
    band, observed, expected, joints = _filtered(
        recording, signals, groups, (band,) if band else BANDS
    )
    cutoff = band * 0.5 / period
    count = 2.0 * cutoff * period * len(recording)  # independent samples of a signal below it
    rho = correlations(observed, expected)
    z = np.arctanh(np.minimum(np.abs(rho), ALMOST_ONE))  # Fisher's, and its standard error
    error = float(1.0 / np.sqrt(max(count - 3.0, 1.0)))
    white = np.array([[1.0], [(2.0 * np.pi * cutoff) ** 2 / 3.0]]) * 2.0 * period * cutoff
    floor = np.maximum(EXCITED_VARIANCE * noise**2 * white, CONSTANT_VARIANCE)  # below the cut-off
    moves, both = np.logical_and.accumulate(np.var([observed, expected], axis=1) > floor)
    certain = both & (np.diag(z) > CERTAIN * error)
    axes = [
        Agreement(dof, float(rho[i, i]), *_scale(observed[:, i], expected[:, i], rho[i, i]),
                  bool(moves[i]), bool(both[i]), bool(certain[i]))
        for i, dof in enumerate(dofs)
    ]  # fmt: skip
    swaps = []  # pairs whose z rises by CERTAIN for each axis that moves, and falls for none
    for i, j in (pair for group in groups for pair in combinations(group, 2)):
        better = [z[a, b] - z[a, a] for a, b in ((i, j), (j, i)) if axes[a].moves]
        if better and min(better) > 0.0 and sum(better) > CERTAIN * error * len(better):
            swaps.append((dofs[i], dofs[j]))
    used = [i for group in groups for i in group if axes[i].excited]
    lags = _lags(observed[:, used], expected[:, used], joints, period, cutoff, count)
    return Consistency(tuple(axes), tuple(swaps), *lags, band, cutoff)


def _compared(
    recording: Recording, recorded: Sequence[str] | None
) -> tuple[list[str], Array, Array]:
    """Axes; their velocities beside those of the pose (2, N, k); noise of either source (2, k).

    Linear ones are left out if the path cannot be turned into body axes.
    """
    dofs, turns = recording.dofs, set(PLANAR) <= set(recording.dofs)
    path = piecewise(without_jumps, recording.edges, _path(recording, recording.attitude))
    rate = _rates(recording, path, turns * recording.attitude)
    noise = noise_floor(path, recording.piece_starts, recording.period_s).deviation
    noise[:3] = np.max(noise[:3])  # the axes are turned into each other
    level = turns or not np.any(recording.attitude)
    used = [
        i for i, dof in enumerate(dofs)
        if (recorded is None or dof in recorded) and (level or dof not in DOFS[:3])
    ]  # fmt: skip
    index = [DOFS.index(dofs[i]) for i in used]
    signals = np.stack([recording.nu[:, used], rate[:, index]])
    noise = np.stack([recording.noise.deviation[used], noise[index]])
    return [dofs[i] for i in used], signals, noise


def _path(recording: Recording, attitude: Array) -> Array:
    """The pose in all degrees of freedom, (N, 6); angles are those turned about axes of the body.

    Those of `attitude` (N, 3) [rad] begin each piece.
    """
    path = np.zeros((len(recording), 6))
    path[:, [DOFS.index(dof) for dof in recording.dofs]] = recording.eta
    path[:, 3:] = piecewise(lambda angles: angles[0] + turned(angles), recording.edges, attitude)
    return path


def _rates(recording: Recording, path: Array, attitude: Array) -> Array:
    """The derivative of a path (N, 6) along the axes of a body of some attitude (N, 3), (N, 6)."""
    difference = partial(central_difference, period_s=recording.period_s)
    rates = piecewise(difference, recording.edges, path)
    return np.column_stack([in_body(attitude, rates[:, :3]), rates[:, 3:]])


class QualityCheck(NamedTuple):
    """error = measured - calculated, Hoyer (2021), section 5.4.4.

    `integrated_velocity` compares the pose with the integral of the velocity from the first pose,
    in m or rad, and shows drift. `differentiated_position` compares the velocity with the
    derivative of the pose, in m/s or rad/s, and shows wrong signs, frames and time stamps.
    """

    check: str
    dof: str
    unit: str
    measured: Array  # (N,)
    calculated: Array  # (N,)

    @property
    def error(self) -> Array:
        """measured - calculated, shape (N,)."""
        return self.measured - self.calculated

    @property
    def maximum(self) -> float:
        """Largest magnitude of the error."""
        return float(np.max(np.abs(self.error)))


def quality_checks(recording: Recording) -> list[QualityCheck]:
    """Both checks of every degree of freedom, piece by piece.

    Where surge, sway and yaw are there, velocities are turned by the attitude; axes that are not
    there, such as heave, which pitch would turn, are taken as zero. In any other set every
    axis is by itself. Angles are those turned about the axes of the body: no singularity.
    """
    dofs, edges, nu = recording.dofs, recording.edges, np.zeros((len(recording), 6))
    nu[:, [DOFS.index(dof) for dof in dofs]] = recording.nu
    angles = attitude_of(dofs, recording.eta)
    pose, attitude = _path(recording, angles), (set(PLANAR) <= set(dofs)) * angles
    along = np.einsum("nij,nj->ni", pose_jacobian(attitude)[:, :3, :3], nu[:, :3])
    way = partial(scipy.integrate.cumulative_trapezoid, dx=recording.period_s, axis=0, initial=0.0)
    integral = piecewise(
        lambda x, v: x[0] + way(v), edges, pose, np.column_stack([along, nu[:, 3:]])
    )
    rates, checks = _rates(recording, pose, attitude), []
    for dof in dofs:
        i, unit, rate_unit = DOFS.index(dof), POSE_UNIT[dof], VELOCITY_UNIT[dof]
        checks += [
            QualityCheck("integrated_velocity", dof, unit, pose[:, i], integral[:, i]),
            QualityCheck("differentiated_position", dof, rate_unit, nu[:, i], rates[:, i]),
        ]
    return checks


def _filtered(
    recording: Recording, signals: Array, groups: Sequence[Sequence[int]], bands: Sequence[float]
) -> tuple[float, Array, Array, list[int]]:
    """The widest band in which velocities and rates agree best; both; where pieces join.

    They begin and end half a period of its cut-off away from the ends of pieces. Bands with fewer
    than `MIN_INDEPENDENT` independent samples are left out.
    """
    best, result, both = -1.0, None, np.hstack(list(signals))
    for band in bands:
        if result is not None and band * len(recording) < MIN_INDEPENDENT:
            break
        cutoff = band * 0.5 / recording.period_s
        drop = round(0.5 / cutoff / recording.period_s)
        pieces = [
            lowpass(both[a:b], cutoff, recording.period_s)[drop : b - a - drop]
            for a, b in pairwise(recording.edges)
            if b - a > 2 * drop + MIN_PIECE
        ]
        joints = [int(k) for k in np.cumsum([len(piece) for piece in pieces])[:-1]]
        observed, expected = np.hsplit(np.concatenate(pieces) if pieces else both, 2)
        rho = np.abs(correlations(observed, expected))
        score = sum(float(np.mean(np.max(rho[np.ix_(g, g)], axis=1))) for g in groups)
        if result is None or score > best + AS_GOOD:
            best, result = score, (band, observed, expected, joints)
    assert result is not None
    return result


def _lags(
    observed: Array, expected: Array, joints: Sequence[int], period: float, cutoff_hz: float,
    count: float,
) -> tuple[float, float, float]:  # fmt: skip
    """By how much velocities are behind the pose, by how much all are, and the standard error [s].

    The peak of the sum of the normalised cross-correlations of the axes, which must agree in sign.
    The error of a delay between band-limited signals of correlation rho with n independent samples
    is sqrt((1 / rho^2 - 1) / n) / (2 pi f_rms); Carter (1987), Proc IEEE 75(2). A clock that is
    apart delays all axes alike, a filter some more than others: all axes are behind by the lag of
    the one that is nearest to the pose, 0 if axes are on both sides of it.
    """
    most = min(round(LONGEST_LAG_S / period), len(observed) // 4)
    if not observed.shape[1] or not most:
        return 0.0, 0.0, np.inf
    apart = np.repeat(np.asarray(joints, dtype=np.int64), most)  # over which nothing is shifted
    a, b = (np.insert(x - np.mean(x, axis=0), apart, 0.0, axis=0) for x in (observed, expected))
    middle = slice(len(a) - 1 - most, len(a) + most)
    curves = np.column_stack([
        scipy.signal.correlate(x, y, method="fft")[middle] / np.linalg.norm(x) / np.linalg.norm(y)
        for x, y in zip(a.T, b.T, strict=True)
    ])  # fmt: skip
    total = _peak(np.sum(curves, axis=1))
    near = max(round(0.5 / cutoff_hz / period), 1)  # a later peak is another one
    first, rho = max(round(total) - near, 0), curves[round(total)]
    own = [first + _peak(np.sign(rho[i]) * curves[first : round(total) + near + 1, i]) - most
           for i in np.flatnonzero(np.abs(rho) > SURE)]  # fmt: skip
    shared = min(own, key=abs) if own and not min(own) < 0.0 < max(own) else 0.0
    share = max(1.0 / max(float(np.max(np.abs(rho))), 0.01) ** 2 - 1.0, 1e-6)
    error = np.sqrt(share / count) / (2.0 * np.pi * cutoff_hz / np.sqrt(3.0))
    return (total - most) * period, shared * period, float(error)


def _peak(curve: Array) -> float:
    """Where a curve (n,) is largest, to a fraction of a sample, by a parabola of three values."""
    k = int(np.argmax(curve))
    if k in (0, len(curve) - 1):
        return float(k)
    before, top, after = curve[k - 1 : k + 2]
    bend = before - 2.0 * top + after
    return float(k + (0.5 * (before - after) / bend if bend < 0.0 else 0.0))


def correlations(observed: Array, expected: Array) -> Array:
    """Correlation of every column of (N, k) with every column of (N, m), shape (k, m).

    Zero where a column is constant.
    """
    a, b = (signals - np.mean(signals, axis=0) for signals in (observed, expected))
    size = np.outer(np.linalg.norm(a, axis=0), np.linalg.norm(b, axis=0))
    return np.asarray(np.divide(a.T @ b, size, out=np.zeros_like(size), where=size > 0.0))


def _scale(observed: Array, expected: Array, correlation: float) -> tuple[float, bool]:
    """The factor on `observed` (N,) that gives `expected` (N,), both with errors; 1 if unknown.

    Means count if they exceed the variation, as the forward speed of a ship on its way does.
    """
    (mean, size), (other, needed) = ((np.mean(x), np.std(x)) for x in (observed, expected))
    if abs(mean) > size and abs(other) > needed:
        return float(other / mean), True
    known = size > 0.0 and needed > 0.0
    return float(np.copysign(needed / size, correlation)) if known else 1.0, False


def without_jumps(path: Array) -> Array:
    """Signals (N, k) in which a jump, of an instrument that lost the pose, is a step as usual.

    A jump is between two second differences that are `JUMP` times as large as the largest of the
    `REGULAR` smallest ones of their `BLOCK`. Where these are zero, as of values that are held or
    interpolated, nothing is known of jumps.
    """
    count = (len(path) - 2) // BLOCK
    if count < 1:
        return path
    steps = np.diff(path, axis=0)
    bends = np.abs(np.diff(steps, axis=0))
    blocks = bends[: count * BLOCK].reshape(count, BLOCK, -1)
    usual = np.partition(blocks, REGULAR - 1, axis=1)[:, REGULAR - 1]
    usual = usual[np.minimum(np.arange(len(bends)) // BLOCK, count - 1)]
    large = (bends > JUMP * usual) & (usual > STRAIGHT_LINE * np.std(steps, axis=0))
    rows, result = np.arange(1, len(steps) - 1), path.copy()
    for j in range(path.shape[1]):
        jumps = rows[large[1:, j] & large[:-1, j]]
        if len(jumps):
            rest = np.delete(np.arange(len(steps)), jumps)
            steps[jumps, j] = np.interp(jumps, rest, steps[rest, j])
            result[1:, j] = path[0, j] + np.cumsum(steps[:, j])
    return result
