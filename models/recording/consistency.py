"""Whether pose and velocity of a recording are consistent: eta_dot = J(eta) nu.

The derivative of the pose in body axes is compared with the recorded velocity per axis. Velocities
are R(attitude)' p_dot, angular ones those of the rotation, so that angles may jump. All signals are
low-passed forward and backward, so that their phases stay; the ends of each piece are left out.

The correlation says whether two signals are of the same motion, the scale whether they are in the
same unit. Both signals have errors, so the scale is that of total least squares on signals of equal
noise-to-signal ratio, sign(rho) sigma_y / sigma_x. The two regressions bound it, rho sigma_y /
sigma_x and sigma_y / (rho sigma_x): Frisch (1934). A low-passed signal of T seconds has about
2 f_c T independent samples, which give the standard error of a correlation by Fisher's z.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording import signals
from seatrial.models.recording.recording import Recording, attitude_of, piecewise
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian, turned

BANDS = (0.25, 0.1, 0.04)  # of the Nyquist frequency: cut-offs of the low-pass, widest first
MIN_INDEPENDENT = 30  # independent samples that a correlation needs
AS_GOOD = 0.03  # agreement by which a simpler map, or a wider band, may be worse
LONGEST_LAG_S = 5.0  # [s]
SURE = 0.5  # correlation of an axis whose scale is known
LEAST_TRUSTED = 0.3  # correlation of an excited axis below which a trial refuses a recording
SAME_SCALE = 1.39  # scales within this factor of one are nearer to it than to the knot
CERTAIN = 3.0  # standard errors that make a difference
EXCITED_VARIANCE = 10.0  # variance of an excited signal, in that of its noise below the cut-off
CONSTANT_VARIANCE = 1e-12  # variance of a signal that does not move
BLOCK, REGULAR = 100, 80  # samples among which jumps are looked for, and those that are none
JUMP = 10.0  # times the largest second difference of these


@dataclass(frozen=True)
class Agreement:
    """Agreement of a recorded velocity with the derivative of the pose.

    `scale` times the recorded values is the derivative.
    """

    dof: str
    correlation: float  # of the sign of the scale
    scale: float
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
    """Agreement of each axis, and by how much the velocities are behind the pose."""

    axes: tuple[Agreement, ...]
    cutoff_hz: float
    lag_s: float
    lag_error_s: float  # infinite unless all axes are behind, or all ahead, as by a clock

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
    recording: Recording, recorded: Sequence[str] = DOFS, cutoff_hz: float | None = None
) -> Consistency:
    """Compare the pose and the velocity of a recording.

    Linear velocities are left out if the path cannot be turned into body axes.

    Args:
        recording: the recording.
        recorded: axes whose velocity is recorded, not differentiated from the pose, with which it
            would agree by construction.
        cutoff_hz: of the low-pass; None: where they agree best.
    """
    period, level = recording.period_s, not np.any(recording.attitude)
    path, rates = _path_and_rates(recording, recording.attitude, without_jumps)
    floor = signals.noise_floor(path, recording.piece_starts, period).deviation
    floor[:3] = np.max(floor[:3])  # the axes are turned into each other
    turns = level or set(PLANAR) <= set(recording.dofs)
    used = [i for i, dof in enumerate(recording.dofs)
            if dof in recorded and (turns or dof not in DOFS[:3])]  # fmt: skip
    dofs = tuple(recording.dofs[i] for i in used)
    index, nu = [DOFS.index(dof) for dof in dofs], recording.nu[:, used]
    noise = np.stack([recording.noise.deviation[used], floor[index]])
    both = Recording(dofs, recording.t, nu, nu, rates[:, index], 0.0 * nu, recording.attitude)
    cutoffs = [cutoff_hz] if cutoff_hz else [band * 0.5 / period for band in BANDS]
    cutoff, both = _filtered(both, cutoffs)
    observed, expected = both.nu, both.nu_dot  # of the body, and of the pose
    count = 2.0 * cutoff * period * len(recording)  # independent samples of a signal below it
    rho = np.diag(correlations(observed, expected))
    z = np.arctanh(np.minimum(np.abs(rho), 0.999)) * np.sqrt(max(count - 3.0, 1.0))  # Fisher's
    white = np.array([[1.0], [(2.0 * np.pi * cutoff) ** 2 / 3.0]]) * 2.0 * period * cutoff
    floor = np.maximum(EXCITED_VARIANCE * noise**2 * white, CONSTANT_VARIANCE)  # below the cut-off
    mean, deviation = (np.array([f(x, axis=0) for x in (observed, expected)])
                       for f in (np.mean, np.std))  # fmt: skip
    moves, excited = np.logical_and.accumulate(deviation**2 > floor)
    with np.errstate(divide="ignore", invalid="ignore"):
        scales = np.select(  # means tell it where they exceed the variation, as on a way
            [np.all(np.abs(mean) > deviation, axis=0), np.all(deviation > 0.0, axis=0)],
            [mean[1] / mean[0], np.copysign(deviation[1] / deviation[0], rho)], 1.0,
        )  # fmt: skip
    certain = excited & (z > CERTAIN)
    columns = (dofs, *(x.tolist() for x in (rho, scales, moves, excited, certain)))
    axes = tuple(Agreement(*values) for values in zip(*columns, strict=True))
    return Consistency(axes, cutoff, *_lags(both, np.flatnonzero(excited), cutoff, count))


def _path_and_rates(
    recording: Recording, attitude: Array, change: Callable[[Array], Array] = np.asarray
) -> tuple[Array, Array]:
    """The pose in all degrees of freedom, (N, 6), and its derivative along the axes of the body.

    Angles are those turned about these axes; those of `attitude` (N, 3) [rad] begin each piece. The
    path of each piece is changed before it is differentiated. In other sets than those with surge,
    sway and yaw every axis is by itself.
    """
    path, edges = np.zeros((len(recording), 6)), recording.edges
    path[:, [DOFS.index(dof) for dof in recording.dofs]] = recording.eta
    path[:, 3:] = piecewise(lambda angles: angles[0] + turned(angles), edges, attitude)
    path = piecewise(change, edges, path)
    rates = piecewise(partial(signals.central_difference, period_s=recording.period_s), edges, path)
    if set(PLANAR) <= set(recording.dofs):
        rates[:, :3] = signals.in_body(attitude, rates[:, :3])
    return path, rates


def quality_checks(recording: Recording) -> dict[str, tuple[Array, Array]]:
    """What was measured and what follows from the rest, (N, n_dof); Hoyer (2021), section 5.4.4.

    `integrated_velocity` compares the pose with the integral of the velocity from the first pose of
    each piece, in m or rad, and shows drift. `differentiated_position` compares the velocity with
    the derivative of the pose, in m/s or rad/s, and shows wrong signs, frames and time stamps.
    Where surge, sway and yaw are there, velocities are turned by the attitude; axes that are not
    there, such as heave, which pitch would turn, are taken as zero.
    """
    index, nu = [DOFS.index(dof) for dof in recording.dofs], np.zeros((len(recording), 6))
    nu[:, index] = recording.nu
    attitude, along = attitude_of(recording.dofs, recording.eta), nu.copy()
    pose, rates = _path_and_rates(recording, attitude)
    if set(PLANAR) <= set(recording.dofs):
        along[:, :3] = np.einsum("nij,nj->ni", pose_jacobian(attitude)[:, :3, :3], nu[:, :3])
    way = partial(scipy.integrate.cumulative_trapezoid, dx=recording.period_s, axis=0, initial=0.0)
    integral = piecewise(lambda x, v: x[0] + way(v), recording.edges, pose, along)
    return {"integrated_velocity": (pose[:, index], integral[:, index]),
            "differentiated_position": (nu[:, index], rates[:, index])}  # fmt: skip


def _filtered(both: Recording, cutoffs: Sequence[float]) -> tuple[float, Recording]:
    """The widest band in which velocities and rates agree best, and the recording below it.

    Pieces begin and end half a period of the cut-off away from their ends. Bands with fewer than
    `MIN_INDEPENDENT` independent samples are left out.
    """
    best, result = -1.0, (cutoffs[0], both)
    groups = np.split(np.arange(len(both.dofs)), [sum(dof in DOFS[:3] for dof in both.dofs)])
    for cutoff in cutoffs:
        if best >= 0.0 and 2.0 * cutoff * both.period_s * len(both) < MIN_INDEPENDENT:
            break
        try:
            smooth = both.lowpass(cutoff, 0.5 / cutoff)
        except RecordingError:  # all pieces are too short
            smooth = both
        rho = np.abs(correlations(smooth.nu, smooth.nu_dot))
        score = sum(float(np.mean(np.max(rho[np.ix_(g, g)], axis=1))) for g in groups if len(g))
        if best < 0.0 or score > best + AS_GOOD:
            best, result = score, (cutoff, smooth)
    return result


def _lags(
    both: Recording, used: NDArray[np.intp], cutoff_hz: float, count: float
) -> tuple[float, float]:
    """By how much velocities are behind the pose, and its standard error [s].

    The peak of the sum of the normalised cross-correlations of the axes, which must agree in sign.
    The error of a delay between band-limited signals of correlation rho with n independent samples
    is sqrt((1 / rho^2 - 1) / n) / (2 pi f_rms); Carter (1987), Proc IEEE 75(2). A clock that is
    apart delays all axes alike, a filter some more than others: unless all are behind, or all
    ahead, the error is infinite.
    """
    period = both.period_s
    most = min(round(LONGEST_LAG_S / period), len(both) // 4)
    if not len(used) or not most:
        return 0.0, np.inf
    apart = np.repeat(np.array(both.edges[1:-1], dtype=np.int64), most)  # nothing shifts over gaps
    a, b = (np.insert(x - np.mean(x, axis=0), apart, 0.0, axis=0)
            for x in (both.nu[:, used], both.nu_dot[:, used]))  # fmt: skip
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
    share = max(1.0 / max(float(np.max(np.abs(rho))), 0.01) ** 2 - 1.0, 1e-6)
    error = np.sqrt(share / count) / (2.0 * np.pi * cutoff_hz / np.sqrt(3.0))
    shared = bool(own) and (min(own) > 0.0 or max(own) < 0.0)
    return (total - most) * period, float(error) if shared else np.inf


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
    a, b = (x - np.mean(x, axis=0) for x in (observed, expected))
    size = np.outer(np.linalg.norm(a, axis=0), np.linalg.norm(b, axis=0))
    return np.asarray(np.divide(a.T @ b, size, out=np.zeros_like(size), where=size > 0.0))


def without_jumps(path: Array) -> Array:
    """Signals (N, k) in which a jump, of an instrument that lost the pose, is a step as usual.

    A jump is between two second differences that are `JUMP` times as large as the largest of the
    `REGULAR` smallest ones of their `BLOCK`. Where these are zero, as of values that are held or
    interpolated, nothing is known of jumps.
    """
    count = (len(path) - 2) // BLOCK
    if count < 1:
        return path
    steps, rows, result = np.diff(path, axis=0), np.arange(1.0, len(path)), path.copy()
    bends = np.abs(np.diff(steps, axis=0))
    blocks = bends[: count * BLOCK].reshape(count, BLOCK, -1)
    usual = np.partition(blocks, REGULAR - 1, axis=1)[:, REGULAR - 1]
    usual = usual[np.minimum(np.arange(len(bends)) // BLOCK, count - 1)]
    large = (bends > JUMP * usual) & (usual > signals.STRAIGHT_LINE * np.std(steps, axis=0))
    jumps = np.pad(large[1:] & large[:-1], ((1, 1), (0, 0)))
    for j in np.flatnonzero(np.any(jumps, axis=0)):
        result[1:, j] = path[0, j] + np.cumsum(signals.interpolated(rows, steps[:, j], jumps[:, j]))
    return result
