"""The noise of a signal is found from its spectrum, and the cut-off from where the motion ends."""

import numpy as np
import pytest
import scipy

from seatrial.models.identification.constrained_table import derivative_response
from seatrial.models.recording.signals import lowpass, noise_floor, smoothing_for

PERIOD_S = 0.1
SAMPLES = 8000


def motion(band_hz: float, rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """A random motion (samples, 2) of deviations 1 and 0.3 with nothing above its band."""
    spectrum = np.fft.rfft(rng.standard_normal((samples, 2)), axis=0)
    spectrum[np.fft.rfftfreq(samples, PERIOD_S) > band_hz] = 0.0
    signal = np.fft.irfft(spectrum, samples, axis=0)
    return np.asarray(signal / np.std(signal, axis=0) * np.array([1.0, 0.3]))


def one_piece(samples: int = SAMPLES) -> np.ndarray:
    return np.arange(samples) == 0


@pytest.mark.parametrize("deviation", [0.003, 0.03, 0.3])
def test_a_known_noise_is_found(deviation: float, rng) -> None:
    noise = deviation * rng.standard_normal((SAMPLES, 2))
    floor = noise_floor(motion(0.3, rng) + noise, one_piece(), PERIOD_S)
    np.testing.assert_allclose(floor.deviation, deviation, rtol=0.05)
    variance = np.array([1.0, 0.09]) + deviation**2
    np.testing.assert_allclose(floor.share, deviation**2 / variance, rtol=0.1)


def test_without_noise_there_is_no_filter(rng) -> None:
    t = PERIOD_S * np.arange(SAMPLES)
    smooth = np.column_stack([np.sin(0.5 * t), np.cos(0.13 * t) + 0.2 * np.sin(1.7 * t)])
    floor = noise_floor(smooth, one_piece(), PERIOD_S)
    assert floor.cutoff_hz is None
    assert smoothing_for(floor.cutoff_hz, PERIOD_S) == (None, None)
    noise = 0.01 * rng.standard_normal(smooth.shape)
    assert noise_floor(smooth + noise, one_piece(), PERIOD_S).cutoff_hz is not None


@pytest.mark.parametrize("band_hz", [0.2, 0.5, 1.0, 2.0])
def test_the_cut_off_follows_the_band_of_the_motion(band_hz: float, rng) -> None:
    noisy = motion(band_hz, rng) + 0.02 * rng.standard_normal((SAMPLES, 2))
    cutoff = noise_floor(noisy, one_piece(), PERIOD_S).cutoff_hz
    resolution = 1.0 / (1024 * PERIOD_S)
    assert band_hz - resolution <= cutoff <= band_hz + 4.0 * resolution


def test_the_longest_piece_counts(rng) -> None:
    """A gap is a step, whose spectrum is not that of noise; the longest piece has none."""
    quiet = motion(0.3, rng) + 0.01 * rng.standard_normal((SAMPLES, 2))
    loud = 10.0 + motion(0.3, rng, 3000) + 0.2 * rng.standard_normal((3000, 2))
    starts = np.zeros(SAMPLES + 3000, dtype=bool)
    starts[[0, 3000]] = True
    floor = noise_floor(np.vstack([loud, quiet]), starts, PERIOD_S)
    np.testing.assert_allclose(floor.deviation, 0.01, rtol=0.05)


def test_a_piece_shorter_than_the_padding_is_filtered() -> None:
    """As little as one sample is left between two gaps of a recording."""
    for count in (1, 2, 15):
        np.testing.assert_allclose(lowpass(np.ones((count, 2)), 1.0, 0.1), 1.0)


def test_a_computed_acceleration_is_told_from_a_measured_one(rng) -> None:
    """Central differences respond with i sin(w dt) / dt; another sensor has noise of its own."""
    velocity = motion(0.3, rng)[:, 0] + 0.02 * rng.standard_normal(SAMPLES)
    central = np.gradient(velocity, PERIOD_S)
    response = derivative_response(velocity, central, PERIOD_S)
    frequency, H = response
    noise = (frequency > 0.5) & (frequency < 4.5)
    expected = np.sin(2.0 * np.pi * frequency * PERIOD_S) / PERIOD_S
    np.testing.assert_allclose(H[noise], expected[noise], rtol=0.05)
    clean = scipy.signal.sosfiltfilt(
        scipy.signal.butter(4, 0.3, fs=1.0 / PERIOD_S, output="sos"), velocity
    )
    measured = np.gradient(clean, PERIOD_S) + 0.02 * rng.standard_normal(SAMPLES)
    assert derivative_response(velocity, measured, PERIOD_S) is None
