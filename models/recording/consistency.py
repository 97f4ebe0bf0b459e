"""Whether pose, velocity and acceleration of a recording belong together.

    eta_dot = J(eta) nu,    nu_dot = d nu / dt

The derivative of the pose in body axes is compared with the recorded velocity per axis, and the
derivative of the velocity with the recorded acceleration.

Velocities are R(attitude)' p_dot, angular ones those of the rotation, so that angles may jump. All
signals are low-passed forward and backward, so that their phases stay, and the ends of each piece,
where the filter lacks data, are left out.

The correlation says whether two signals are of the same motion, the scale whether they are in the
same unit. Both signals have errors, so the scale is that of total least squares on signals of equal
noise-to-signal ratio, sign(rho) sigma_y / sigma_x. The two regressions bound it, rho sigma_y /
sigma_x and sigma_y / (rho sigma_x): Frisch (1934). A low-passed signal of T seconds has about
2 f_c T independent samples, which give the standard error of a correlation by Fisher's z.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.preprocessing import central_difference
from seatrial.models.recording.recording import MIN_PIECE, Recording
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import frame_of_angles, turned

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
STRAIGHT_LINE = 1e-6  # of the typical step: smaller second differences are those of a straight line
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

    `swaps` are pairs of axes that agree better if their velocities are exchanged.
    """

    velocities: tuple[Agreement, ...]
    accelerations: tuple[Agreement, ...]
    swaps: tuple[tuple[str, str], ...]
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


class Motion:
    """Pose, attitude and velocity of a recording, with the rates that the pose implies.

    `recorded` are the axes whose velocity was recorded (None: all); others were differentiated from
    the pose, agree by construction and are not compared. Neither are `linear` ones if the path
    cannot be turned into body axes.
    """

    def __init__(self, recording: Recording, recorded: Sequence[str] | None = None) -> None:
        self.recording, self.dofs = recording, recording.dofs
        self.edges, self.period_s = recording.edges, recording.period_s
        known = self.dofs if recorded is None else [dof for dof in self.dofs if dof in recorded]
        self.turns = set(PLANAR) <= set(self.dofs)
        level = self.turns or not np.any(recording.attitude)
        self.linear = tuple(dof for dof in known if dof in DOFS[:3] and level)
        self.angular = tuple(dof for dof in known if dof in DOFS[3:])

    @cached_property
    def path(self) -> Array:
        """Position and rotation about the body axes (N, 6), without jumps."""
        path = np.zeros((len(self.recording), 6))
        for i, dof in enumerate(self.dofs):
            if dof in DOFS[:3]:
                path[:, DOFS.index(dof)] = self.recording.eta[:, i]
        for a, b in pairwise(self.edges):
            path[a:b, 3:] = turned(self.recording.attitude[a:b])
            path[a:b] = without_jumps(path[a:b])
        return path

    @cached_property
    def rate(self) -> Array:
        """Velocities (N, 6) in body axes that the pose implies."""
        rate = self.derivative(self.path)
        if self.turns:
            frame = np.empty((3, 3, len(rate)))
            frame_of_angles(self.recording.attitude.T, frame)
            rate[:, :3] = np.einsum("jin,nj->ni", frame, rate[:, :3])
        return rate

    @cached_property
    def pose_noise(self) -> Array:
        """Standard deviations (6,) of the noise of the path."""
        noise = noise_floor(self.path, self.recording.piece_starts, self.period_s).deviation
        noise[:3] = np.max(noise[:3])  # the axes are turned into each other
        return np.asarray(noise)

    def samples(self, cutoff_hz: float) -> float:
        """Independent samples of a signal below a cut-off."""
        return 2.0 * cutoff_hz * self.period_s * len(self.recording)

    def velocity(self, dofs: Sequence[str], cutoff_hz: float) -> Array:
        """Low-passed recorded velocities (n, k), away from the ends of pieces."""
        return self.inside(self.recording.nu[:, [self.dofs.index(dof) for dof in dofs]], cutoff_hz)

    def rates(self, dofs: Sequence[str], cutoff_hz: float) -> Array:
        """Low-passed velocities (n, k) that the pose implies."""
        return self.inside(self.rate[:, [DOFS.index(dof) for dof in dofs]], cutoff_hz)

    def derivative(self, values: Array) -> Array:
        """Central differences of values (N, k), piece by piece; zero in a piece of one sample."""
        rate = np.zeros_like(values)
        for a, b in pairwise(self.edges):
            if b - a > 1:
                rate[a:b] = central_difference(values[a:b], self.period_s)
        return rate

    def inside(self, values: Array, cutoff_hz: float) -> Array:
        """Low-passed values (n, k) half a period of the cut-off away from the ends of pieces."""
        drop = round(0.5 / cutoff_hz / self.period_s)
        pieces = [
            lowpass(values[a:b], cutoff_hz, self.period_s)[drop : b - a - drop]
            for a, b in pairwise(self.edges)
            if b - a > 2 * drop + MIN_PIECE
        ]
        return np.concatenate(pieces) if pieces else values

    def joints(self, cutoff_hz: float) -> list[int]:
        """Where the second piece begins in what is `inside`, and the others."""
        drop = round(0.5 / cutoff_hz / self.period_s)
        lengths = [b - a - 2 * drop for a, b in pairwise(self.edges)]
        return [int(k) for k in np.cumsum([n for n in lengths if n > MIN_PIECE])[:-1]]

    def exceeds(self, values: Array, deviation: float, cutoff_hz: float, order: int = 0) -> bool:
        """Whether values (n,) vary more than white noise below the cut-off, or its derivative."""
        noise = deviation**2 * 2.0 * self.period_s * cutoff_hz
        if order:
            noise *= (2.0 * np.pi * cutoff_hz) ** 2 / 3.0
        return bool(np.var(values) > max(EXCITED_VARIANCE * noise, CONSTANT_VARIANCE))


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
    error, swaps = fisher_error(motion.samples(cutoff)), list[tuple[str, str]]()

    def agreement(kind: str, dof: str, observed: Array, expected: Array) -> Agreement:
        deviation = float(noise[motion.dofs.index(dof)])
        own, other = deviation, float(motion.pose_noise[DOFS.index(dof)])
        if kind == "acceleration":
            own, other = 0.0, deviation
        rho = float(correlations(observed[:, None], expected[:, None])[0, 0])
        moves = motion.exceeds(observed, own, cutoff)
        excited = moves and motion.exceeds(expected, other, cutoff, order=1)
        sure = bool(fisher(np.array(rho)) > CERTAIN * error)
        return Agreement(kind, dof, rho, scale_of(observed, expected, rho), moves, excited, sure)

    axes, pairs = {}, {}
    for dofs in filter(None, (motion.linear, motion.angular)):
        observed, expected = motion.velocity(dofs, cutoff), motion.rates(dofs, cutoff)
        for i, dof in enumerate(dofs):
            axes[dof] = agreement("velocity", dof, observed[:, i], expected[:, i])
            pairs[dof] = observed[:, i], expected[:, i]
        moves = [axes[dof].moves for dof in dofs]
        pairs_of = swapped(fisher(correlations(observed, expected)), moves, error)
        swaps += [(dofs[i], dofs[j]) for i, j in pairs_of]
    accelerations = []
    for dof in (dof for dof in motion.dofs if dof in measured):
        own = [motion.dofs.index(dof)]
        observed = motion.inside(recording.nu_dot[:, own], cutoff)
        expected = motion.inside(motion.derivative(recording.nu[:, own]), cutoff)
        accelerations.append(agreement("acceleration", dof, observed[:, 0], expected[:, 0]))
    used = [pairs[dof] for dof, axis in axes.items() if axis.excited]
    return Consistency(
        tuple(axes[dof] for dof in motion.dofs if dof in axes), tuple(accelerations), tuple(swaps),
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
    most = min(round(LONGEST_LAG_S / period), len(observed) // 4)
    joints = motion.joints(cutoff_hz)
    total = lag(observed, expected, np.arange(-most, most + 1), joints)
    k = round(total)
    rho = np.diag(correlations(
        observed[max(k, 0) : len(observed) + min(k, 0)],
        expected[max(-k, 0) : len(expected) - max(k, 0)],
    ))  # fmt: skip
    near = max(round(0.5 / cutoff_hz / period), 1)  # a later peak is another one
    shifts = np.arange(k - near, k + near + 1)
    own = [lag(np.sign(rho[i]) * observed[:, [i]], expected[:, [i]], shifts, joints)
           for i in np.flatnonzero(np.abs(rho) > SURE)]  # fmt: skip
    shared = min(own, key=abs) if own and not min(own) < 0.0 < max(own) else 0.0
    share = max(1.0 / max(float(np.max(np.abs(rho))), 0.01) ** 2 - 1.0, 1e-6)
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


def swapped(z: Array, moving: Sequence[bool], error: float) -> Iterator[tuple[int, int]]:
    """Pairs of axes that agree significantly better with the derivatives of each other.

    z (k, k) is Fisher's z of velocities with derivatives, `error` its standard error: the sum over
    the axes that move must rise by `CERTAIN` of them for each, and none may fall.
    """
    for i, j in combinations(range(len(z)), 2):
        better = [z[a, b] - z[a, a] for a, b in ((i, j), (j, i)) if moving[a]]
        if better and min(better) > 0.0 and sum(better) > CERTAIN * error * len(better):
            yield i, j


def fisher(rho: Array) -> Array:
    """Fisher's z of the size of correlations; its standard error is 1 / sqrt(n - 3)."""
    return np.asarray(np.arctanh(np.minimum(np.abs(rho), ALMOST_ONE)))


def fisher_error(samples: float) -> float:
    """Standard error of Fisher's z of some independent samples."""
    return float(1.0 / np.sqrt(max(samples - 3.0, 1.0)))


def lag(
    observed: Array, expected: Array, shifts: NDArray[np.int64], joints: Sequence[int] = ()
) -> float:
    """By how many samples `observed` (N, k) is behind `expected` (N, k), to a fraction of one.

    The peak of the sum of the normalised cross-correlations of the columns, which must agree in
    sign; a parabola through its three largest values.

    Args:
        observed: signals in pieces.
        expected: those that they are compared with.
        shifts: consecutive numbers of samples that are tried, (n,).
        joints: where pieces begin, over which nothing is shifted.
    """
    most = int(np.max(np.abs(shifts), initial=0))
    if len(shifts) < 3 or most >= len(observed):
        return 0.0
    apart = np.repeat(np.asarray(joints, dtype=np.int64), most)
    a, b = (np.insert(x - np.mean(x, axis=0), apart, 0.0, axis=0) for x in (observed, expected))
    size = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    n = 1 << (2 * len(a) - 1).bit_length()
    spectrum = np.fft.rfft(a, n, axis=0) * np.conj(np.fft.rfft(b, n, axis=0))
    values = np.fft.irfft(spectrum, n, axis=0)[shifts]  # the sums of a[t + s] b[t] over t
    sums = np.sum(np.divide(values, size, out=np.zeros_like(values), where=size > 0.0), axis=1)
    peak = int(np.argmax(sums))
    if peak in (0, len(sums) - 1):
        return float(shifts[peak])
    before, top, after = sums[peak - 1 : peak + 2]
    bend = before - 2.0 * top + after
    inside = 0.5 * float(before - after) / float(bend) if bend < 0.0 else 0.0
    return float(shifts[peak] + inside)


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
