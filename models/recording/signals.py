"""Measured signals: how they were sampled, their noise, and what is done to them before use.

All functions are pure; time and signals run along the first axis.

White noise has a flat spectrum, motion one that falls with frequency: what Welch's density shows
in the highest fifth of the band is noise. The cut-off f_c is the frequency at which the density
first falls below four times that floor, the largest over the axes. Smoothing is in two stages:
the signals at 2 f_c, before products are formed of them, and every regressor together with the
force at 0.75 f_c. A filter that acts on both sides of a linear equation leaves it true; one that
acts on the velocities alone, below about 0.3 Hz, biases nonlinear terms.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from seatrial.models.recording.times import is_later
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian

GAP = 1.5  # in sample times; a longer time step is a gap
STRAIGHT_LINE = 1e-6  # of the typical second difference: smaller ones are those of a straight line
MADE_UP = 0.3  # share of samples on straight lines, or held, that makes a file a resampled one
MIN_SAMPLES = 20  # samples for an original rate
FEWEST_PAIRS = 100  # amplitudes and their images
IMAGES = 0.5  # coherence of amplitudes beside half the original rate with their images
LIKELY = 50  # rates that are looked at, among them the multiples of the one that is sought
NOISE_BAND = 0.8  # of the Nyquist frequency; above it there is noise alone
ABOVE_FLOOR = 4.0  # density over that of the noise
LOWPASS_ORDER = 4
SEGMENT = 1024  # samples of one periodogram
NEGLIGIBLE_NOISE = 1e-8  # share of noise in a signal's variance that asks for no smoothing
SIGNALS, REGRESSORS = 2.0, 0.75  # cut-offs of the two stages, in f_c
MAX_CUTOFF = 0.9  # of the Nyquist frequency, for a filter


class Sampling(NamedTuple):
    """Times of a source: median rate, gaps, and times that do not increase."""

    rows: int
    duration_s: float
    rate_hz: float
    gaps: int  # steps of more than 1.5 sample times
    longest_gap_s: float
    longest_gap_at_s: float
    missing: float  # share of the duration in gaps, beyond one sample time each
    not_later: int  # times that are not later than the one before


def sampling(t: Array) -> Sampling:
    """Describe times t (N,) [s]."""
    known = t[~np.isnan(t)]
    times, not_later = known[is_later(known)], int(np.sum(~(np.diff(known) > 0.0)))
    steps = np.diff(times) if len(times) > 1 else np.zeros(1)
    period, duration, k = float(np.median(steps)), float(np.sum(steps)), int(np.argmax(steps))
    gaps = steps > GAP * period
    return Sampling(
        len(known), duration, 1.0 / period if period else 0.0, int(np.sum(gaps)), float(steps[k]),
        float(np.sum(steps[:k])), float(np.sum(steps[gaps] - period)) / (duration or 1.0),
        not_later,
    )  # fmt: skip


def original_rate(values: Array, rate_hz: float) -> float | None:
    """The rate [Hz] of the samples that columns (N, k) were interpolated from; None if recorded.

    Linear interpolation leaves second differences of zero between the original samples, a hold
    equal samples, in all columns at once while they move. Each original sample ends a run of them,
    so the runs count the original samples. A smooth interpolation leaves images.
    """
    if len(values) < MIN_SAMPLES or np.any(np.isnan(values)):
        return None
    steps = np.diff(values, axis=0)
    steps = steps[:, np.std(steps, axis=0) > 0.0]
    if not steps.size:
        return None
    bends = np.diff(steps, axis=0)
    bent = np.any(np.abs(bends) > STRAIGHT_LINE * np.std(steps, axis=0), axis=1)
    if (stepping := float(np.mean(np.any(steps != 0.0, axis=1)))) < 1.0 - MADE_UP:
        return rate_hz * stepping
    if np.mean(bent) >= 1.0 - MADE_UP:
        return _rate_of_images(bends, rate_hz)
    # A sample between two of the new ones bends the line at both of them.
    runs = int(np.sum(bent[1:] & ~bent[:-1])) + int(bent[0])
    return rate_hz * runs / len(bent)


def _rate_of_images(bends: Array, rate_hz: float) -> float | None:
    """The lowest rate [Hz] of which second differences (N, k) have images; None: of none.

    A smooth interpolation leaves, of every frequency f, an image at f_0 - f, f_0 being the original
    rate; what was recorded has independent phases there. Gallagher (2005), Detection of linear and
    cubic interpolation in JPEG compressed images, proc. CRV, finds it in second differences.
    """
    most = 3.0 * 1.4826 * np.median(np.abs(bends), axis=0)  # an impulse has all rates alike
    length = 2 * len(bends)  # a rate between two frequencies is seen, too
    windowed = np.clip(bends, -most, most) * np.hanning(len(bends))[:, None]
    spectrum = np.fft.rfft(windowed, length, axis=0)
    width = max(len(spectrum) // 100, 9)
    power = scipy.ndimage.uniform_filter1d(np.abs(spectrum) ** 2, width, axis=0)
    white = np.divide(spectrum, np.sqrt(np.abs(power)), out=0.0 * spectrum, where=power > 0.0)
    # of every sum of two frequencies, the sum of the products of their amplitudes
    sums = scipy.signal.fftconvolve(white, white, axes=0)
    counts = len(white) - np.abs(np.arange(len(sums)) - len(white) + 1)
    strength = np.sum(np.abs(sums) ** 2, axis=1) / counts
    strength[: 2 * FEWEST_PAIRS] = strength[-2 * FEWEST_PAIRS :] = 0.0
    for total in np.sort(np.argsort(strength)[-LIKELY:]):
        reach = min(int(total) // 20, len(white) - 1 - int(total) // 2 - 1)
        lower = np.arange(total // 2 - reach, total // 2)  # beside half the rate
        pairs = white[lower] * white[total - lower]
        phases = pairs / np.maximum(np.abs(pairs), 1e-300)  # a pure tone counts no more than others
        # independent amplitudes have a coherence of 1 / n of n pairs
        if reach >= FEWEST_PAIRS and np.median(np.abs(np.mean(phases, axis=0)) ** 2) > IMAGES:
            return rate_hz * float(total) / length
    return None


class NoiseFloor(NamedTuple):
    """White noise of measured signals (k,), and the cut-off of a low-pass filter against it."""

    deviation: Array  # (k,) standard deviation of the noise
    share: Array  # (k,) of the variance of each signal
    cutoff_hz: float | None  # None: no noise worth a filter


def noise_floor(signals: Array, starts: NDArray[np.bool_], period_s: float) -> NoiseFloor:
    """Noise of signals (N, k) sampled with `period_s` [s]; `starts` (N,) begin a new piece.

    The longest piece without a gap is used.
    """
    edges = np.append(np.flatnonzero(starts), len(signals))
    longest = int(np.argmax(np.diff(edges)))
    piece = signals[edges[longest] : edges[longest + 1]]
    frequency, cross = cross_density(piece, piece, period_s, min(len(piece), SEGMENT))
    density, nyquist = np.real(cross), 0.5 / period_s
    floor = np.median(density[noise_band(frequency, nyquist)], axis=0)
    noise, variance = floor * nyquist, np.var(piece, axis=0)
    share = np.divide(noise, variance, out=np.zeros_like(noise), where=variance > 0.0)
    cutoffs = [
        float(frequency[np.argmax(density[:, j] < ABOVE_FLOOR * floor[j])])
        for j in np.flatnonzero(share > NEGLIGIBLE_NOISE)
    ]
    lowest = frequency[1] if len(frequency) > 1 else nyquist
    cutoff = max(*cutoffs, lowest) if cutoffs else None
    return NoiseFloor(np.sqrt(noise), np.minimum(share, 1.0), cutoff)


def cross_density(
    x: Array, y: Array, period_s: float, length: int
) -> tuple[Array, NDArray[np.complex128]]:
    """Frequencies [Hz] and one-sided cross-density of x and y (N, ...), as scipy.signal.csd.

    Welch's mean over segments of `length` samples by Hann's window, each half over the one before,
    without their own means. (The import of scipy.signal takes longer than most fits.)
    """
    window = np.hanning(length + 1)[:-1] if length > 1 else np.ones(1)
    step = length - length // 2

    def spectra(values: Array) -> NDArray[np.complex128]:
        parts = sliding_window_view(values, length, axis=0)[::step]
        return np.fft.rfft(window * (parts - np.mean(parts, axis=-1, keepdims=True)))

    first = spectra(x)
    density = np.mean(np.conj(first) * (first if y is x else spectra(y)), axis=0).T
    density *= period_s / np.sum(window**2)
    density[1 : (length + 1) // 2] *= 2.0  # for the negative frequencies
    return np.asarray(np.fft.rfftfreq(length, period_s)), density


def noise_band(frequency: Array, nyquist: float) -> NDArray[np.bool_]:
    """The frequencies [Hz] (n,) that show noise alone: the highest fifth, or the last one."""
    return np.asarray(frequency >= min(NOISE_BAND * nyquist, frequency[-1]))


class Smoothing(NamedTuple):
    """Cut-offs [Hz] of the low-pass filters of signals and of regressors with the force."""

    signals_hz: float | None
    regressors_hz: float | None = None


def smoothing_for(cutoff_hz: float | None, period_s: float) -> Smoothing:
    """Both stages for the cut-off f_c of the noise; None: neither."""
    if cutoff_hz is None:
        return Smoothing(None)
    highest = MAX_CUTOFF * 0.5 / period_s
    return Smoothing(*(min(stage * cutoff_hz, highest) for stage in (SIGNALS, REGRESSORS)))


def lowpass(values: Array, cutoff_hz: float, period_s: float) -> Array:
    """Zero-phase low-pass of values (N, ...): a Butterworth filter forward and backward.

    The ends are continued by 15 samples, or by as many as a shorter piece of a recording has, which
    are turned about the last value; the filter begins as if its first value had always been there.
    """
    length = min(3 * (LOWPASS_ORDER + 1), len(values) - 1)
    sections = _sections(cutoff_hz * period_s)
    return np.asarray(scipy.signal.sosfiltfilt(sections, values, axis=0, padlen=length))


@lru_cache(maxsize=64)
def _sections(cutoff: float) -> Array:
    """The filter of a cut-off, of the sample rate: it takes longer than most recordings."""
    return np.asarray(scipy.signal.butter(LOWPASS_ORDER, 2.0 * cutoff, output="sos"))


def outliers(values: Array, window: int = 10, deviations: float = 3.0) -> NDArray[np.bool_]:
    """Samples further than `deviations` standard deviations from a moving mean; values (N,).

    Mean and standard deviation (n - 1) are those of the `window` nearest samples, half of them
    before and half after, *without* the sample itself: if it were included, no sample of ten could
    deviate by more than (10 - 1) / sqrt(10) = 2.85 standard deviations, and no outlier would be
    detected. In pure white noise 1.9 % of the samples count as outliers; in smooth signals, steps
    and ramps none do. Jervan (2020), section 5.2.
    """
    n = len(values)
    if n <= window:
        return np.zeros(n, dtype=bool)
    start = np.clip(np.arange(n) - window // 2, 0, n - window - 1)
    mean = (sum(values[start + k] for k in range(window + 1)) - values) / window
    distance = np.abs(values - mean)
    squares = sum((values[start + k] - mean) ** 2 for k in range(window + 1)) - distance**2
    deviation = np.sqrt(np.maximum(squares, 0.0) / (window - 1))
    rounding = 1e-9 * float(np.max(np.abs(values)))  # a constant signal has no outliers
    return np.asarray(distance > np.maximum(deviations * deviation, rounding))


def interpolated(t: Array, values: Array, wrong: NDArray[np.bool_]) -> Array:
    """Values (N,) with the `wrong` samples replaced by linear interpolation in time t (N,) [s]."""
    if np.all(wrong):
        return values
    return np.where(wrong, np.interp(t, t[~wrong], values[~wrong]), values)


def central_difference(values: Array, period_s: float) -> Array:
    """d/dt along the first axis, [unit/s]; second order, also at the two ends; of one sample zero.

    (x[k+1] - x[k-1]) / (2 h): zero phase, gain sinc(2 f h). Except at the ends, it commutes with
    every linear time-invariant filter.
    """
    if len(values) < 3:
        return np.gradient(values, period_s, axis=0) if len(values) > 1 else np.zeros_like(values)
    return np.asarray(np.gradient(values, period_s, axis=0, edge_order=2))


def in_body(attitude: Array, values: Array) -> Array:
    """Vectors (N, 3) along the axes of the earth in those of the body, attitude (N, 3) [rad]."""
    return np.asarray(np.einsum("nji,nj->ni", pose_jacobian(attitude)[:, :3, :3], values))


def without_sign_flips(quaternions: Array) -> Array:
    """The same rotations, shape (N, 4), with signs such that q . q_next >= 0.

    q and -q are the same rotation; a change of sign at 180 degrees causes spikes in derivatives
    and wrong interpolated values. Hoyer (2021), section 5.4.3.
    """
    products = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))
    return np.asarray(quaternions * signs[:, None])
