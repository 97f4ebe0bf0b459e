"""Force signals of open-loop excitations, pure functions of time. Hoyer (2021), section 6.3.

The thesis calls its pulses ramps; only rectangular pulses of 20 s with 10 s of rest around them
reproduce its figures. Times t [s], forces [N].
"""

from collections.abc import Sequence

import numpy as np

from models.basis import Array

REST_S = 10.0
PULSE_S = 20.0
ROUNDING_S = 1e-9  # an instant is as late as its neighbours within rounding
SINE_PERIODS_S = tuple(float(period) for period in range(1, 92, 10))


def pulses(t: Array, forces: Sequence[float]) -> Array:
    """One pulse of 20 s for each force, with 10 s of rest before, between and after; shape of t."""
    since = np.asarray(t) - REST_S + ROUNDING_S
    index = np.floor(since / (PULSE_S + REST_S)).astype(int)
    on = (since >= 0.0) & (since % (PULSE_S + REST_S) < PULSE_S) & (index < len(forces))
    return np.where(on, np.array(forces)[np.clip(index, 0, len(forces) - 1)], 0.0)


def single_ramp(t: Array) -> Array:
    """One pulse of 30 N; 40 s."""
    return pulses(t, (30.0,))


def triple_ramp(t: Array) -> Array:
    """Pulses of 10, 30 and 60 N; 100 s."""
    return pulses(t, (10.0, 30.0, 60.0))


def sines(t: Array, amplitudes: Sequence[float], periods_s: Sequence[float]) -> Array:
    """X = sum_i A_i sin(2 pi t / P_i), shape of t; eq. (6.6)."""
    phase = 2.0 * np.pi * np.asarray(t)[..., None] / np.asarray(periods_s)
    return np.asarray(np.sin(phase) @ np.asarray(amplitudes, dtype=np.float64))


def single_sine(t: Array) -> Array:
    """A sine of 60 N with a period of 5 s; 100 s."""
    return sines(t, (60.0,), (5.0,))


def many_sine(t: Array) -> Array:
    """Ten sines of 10 N with periods of 1, 11, ..., 91 s; 100 s."""
    return sines(t, (10.0,) * len(SINE_PERIODS_S), SINE_PERIODS_S)
