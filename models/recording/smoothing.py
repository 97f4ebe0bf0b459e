"""Noise of measured signals, and the smoothing that it asks for.

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
from numpy.typing import NDArray

from seatrial.models.vessel.basis import Array

NOISE_BAND = 0.8  # of the Nyquist frequency; above it there is noise alone
ABOVE_FLOOR = 4.0  # density over that of the noise
LOWPASS_ORDER = 4
SEGMENT = 1024  # samples of one periodogram
NEGLIGIBLE_NOISE = 1e-8  # share of noise in a signal's variance that asks for no smoothing
SIGNALS, REGRESSORS = 2.0, 0.75  # cut-offs of the two stages, in f_c
MAX_CUTOFF = 0.9  # of the Nyquist frequency, for a filter


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
    frequency, density = scipy.signal.welch(
        piece, 1.0 / period_s, nperseg=min(len(piece), SEGMENT), axis=0
    )
    nyquist = 0.5 / period_s
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


def lowpass(values: Array, cutoff_hz: float, period_s: float, order: int = LOWPASS_ORDER) -> Array:
    """Zero-phase low-pass of values (N, ...): a Butterworth filter forward and backward.

    The ends are continued by 15 samples, or by as many as a shorter piece of a recording has, which
    are turned about the last value; the filter begins as if its first value had always been there.
    It is `scipy.signal.sosfiltfilt`, which finds that state anew for every piece of a recording.
    """
    sections, state = _sections(cutoff_hz, period_s, order)
    n = min(3 * (order + 1), len(values) - 1)
    before, after = values[n:0:-1], values[-2 : -n - 2 : -1]
    signal = np.concatenate([2.0 * values[:1] - before, values, 2.0 * values[-1:] - after])
    state = state.reshape(*state.shape, *(1,) * (values.ndim - 1))
    for _ in range(2):
        signal = scipy.signal.sosfilt(sections, signal, axis=0, zi=state * signal[0])[0][::-1]
    return np.asarray(signal[n : n + len(values)])


@lru_cache(maxsize=64)
def _sections(cutoff_hz: float, period_s: float, order: int) -> tuple[Array, Array]:
    """The filter and its state after a constant one; they take longer than most recordings."""
    sections = scipy.signal.butter(order, cutoff_hz, fs=1.0 / period_s, output="sos")
    return np.asarray(sections, dtype=np.float64), np.asarray(scipy.signal.sosfilt_zi(sections))
