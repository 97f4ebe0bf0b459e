"""How a recording was sampled: rate, gaps, repeated times, and files made of slower ones.

Linear interpolation leaves second differences of zero between the original samples, a hold leaves
equal samples. Each original sample ends a run of them, so the runs count the original samples. A
smooth interpolation leaves, of every frequency f, an image at f_0 - f, f_0 being the original rate;
what was recorded has independent amplitudes there. Gallagher (2005), Detection of linear and cubic
interpolation in JPEG compressed images, proc. CRV, finds the same period in second differences.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from seatrial.models.recording.times import is_later
from seatrial.models.vessel.basis import Array

GAP = 1.5  # in sample times; a longer time step is a gap
STRAIGHT_LINE = 1e-6  # of the typical second difference: smaller ones are those of a straight line
MADE_UP = 0.3  # share of samples on straight lines, or held, that makes a file a resampled one
MIN_SAMPLES = 20  # samples for an original rate
FEWEST_PAIRS = 100  # amplitudes and their images
IMAGES = 0.5  # share of the power beside half the original rate that is that of images
LIKELY = 50  # rates that are looked at, among them the multiples of the one that is sought


@dataclass(frozen=True)
class Sampling:
    """Times of a source: median rate, gaps, and times that do not increase."""

    count: int
    duration_s: float
    rate_hz: float
    gaps: int  # steps of more than 1.5 sample times
    longest_gap_s: float
    longest_gap_at_s: float
    missing: float  # share of the duration in gaps, beyond one sample time each
    not_later: int  # times that are not later than the one before

    def __str__(self) -> str:
        text = f"{self.count} rows in {self.duration_s:.0f} s, {self.rate_hz:.3g} Hz"
        if self.gaps:
            text += (
                f", {self.gaps} gaps, the longest {self.longest_gap_s:.3g} s at "
                f"{self.longest_gap_at_s:.0f} s, {100.0 * self.missing:.0f} % missing"
            )
        return text


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

    All columns must lie on straight lines at the same samples, while they move.
    """
    if len(values) < MIN_SAMPLES or np.any(np.isnan(values)):
        return None
    steps = np.diff(values, axis=0)
    moving = np.std(steps, axis=0) > 0.0
    if not np.any(moving):
        return None
    steps = steps[:, moving]
    bent = np.any(np.abs(np.diff(steps, axis=0)) > STRAIGHT_LINE * np.std(steps, axis=0), axis=1)
    if (stepping := float(np.mean(np.any(steps != 0.0, axis=1)))) < 1.0 - MADE_UP:
        return rate_hz * stepping
    if 1.0 - float(np.mean(bent)) <= MADE_UP:
        return _rate_of_images(values[:, moving], rate_hz)
    # A sample between two of the new ones bends the line at both of them.
    runs = int(np.sum(bent[1:] & ~bent[:-1])) + int(bent[0])
    return rate_hz * runs / len(bent)


def _rate_of_images(values: Array, rate_hz: float) -> float | None:
    """The lowest rate [Hz] of which the upper half of the spectrum of columns (N, k) has images."""
    bends = np.diff(values, 2, axis=0)
    most = 3.0 * 1.4826 * np.median(np.abs(bends), axis=0)  # an impulse has all rates alike
    window = np.hanning(len(bends))[:, None]
    length = 2 * len(bends)  # a rate between two frequencies is seen, too
    spectrum = np.fft.rfft(np.clip(bends, -most, most) * window, length, axis=0)
    width = max(len(spectrum) // 100, 9)
    power = scipy.ndimage.uniform_filter1d(np.abs(spectrum) ** 2, width, axis=0)
    white = np.divide(spectrum, np.sqrt(np.abs(power)), out=0.0 * spectrum, where=power > 0.0)
    padded = 2 * len(white)
    # of every sum of two frequencies, the sum of the products of their amplitudes
    products = np.fft.ifft(np.fft.fft(white, padded, axis=0) ** 2, axis=0)[: 2 * len(white) - 1]
    counts = np.minimum(np.arange(1, len(products) + 1), np.arange(len(products), 0, -1))
    strength = np.sum(np.abs(products) ** 2, axis=1) / counts
    strength[: 2 * FEWEST_PAIRS] = strength[-2 * FEWEST_PAIRS :] = 0.0
    for total in np.sort(np.argsort(strength)[-LIKELY:]):
        reach = min(int(total) // 20, len(white) - 1 - int(total) // 2 - 1)
        if reach < FEWEST_PAIRS:  # independent amplitudes have a coherence of 1 / n of n pairs
            continue
        lower = np.arange(total // 2 - reach, total // 2)  # beside half the rate
        pairs = white[lower] * white[total - lower]
        size = np.abs(pairs)  # a pure tone counts no more than any other frequency
        turns = np.divide(pairs, size, out=np.zeros_like(pairs), where=size > 0.0)
        if np.median(np.abs(np.mean(turns, axis=0)) ** 2) > IMAGES:
            return rate_hz * float(total) / length
    return None
