"""Standard errors that know that residuals of motion are autocorrelated.

A low-pass makes neighbouring residuals alike, so the textbook error, for white residuals, is far
too small. An estimate is linear in the residuals, theta_hat - theta = sum_i g_i e_i, and with an
autocovariance gamma of the residuals

    stationary   var = sum_lag w(lag) gamma_e(lag) sum_i g_i g_(i+lag)
    hac          var = sum_lag w(lag) sum_i (g_i e_i) (g_(i+lag) e_(i+lag))

both with the Bartlett weights w of Newey and West (1987) and the bandwidth of Andrews (1991).
`hac` allows residuals whose size changes with the motion, but needs many independent manoeuvres:
three turns in a training lap leave it half of the true spread in yaw. `stationary` does not. Or
blocks of residuals are drawn again (Kuensch, 1989), the regressors kept, and the model refitted.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.fft import next_fast_len

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array

ErrorKind = Literal["stationary", "hac"]
PIECE = 8192  # samples that are transformed together, at least


def check_bootstrap(bootstrap: int | None, block_s: float) -> None:
    """Refuse too few replicates and empty blocks."""
    if bootstrap is not None and bootstrap < 20:
        raise ConfigurationError(f"bootstrap must be at least 20 or null, got {bootstrap}")
    if not block_s > 0.0:
        raise ConfigurationError(f"block_s must be positive, got {block_s}")


def stationary_variance(gain: Array, rest: Array) -> Array:
    """Variance of sum_i g_i e_i for gains (N, P) and a stationary residual (N,), shape (P,).

    Of several residuals (N, K), each by itself, shape (P, K).
    """
    residuals = rest.reshape(len(rest), -1)
    widths = bandwidth(autocovariances(residuals, 2), len(rest))
    lags = _lags(widths, len(rest))
    own, along = autocovariances(residuals, lags), autocovariances(gain, lags)
    variance = along.T @ (bartlett_weights(widths, lags) * own) / len(rest)
    return np.asarray(variance.reshape(gain.shape[1:] + rest.shape[1:]))


def hac_variance(influence: Array) -> Array:
    """Variance of the sum of influence series (N, P), shape (P,)."""
    centred = influence - np.mean(influence, axis=0)
    widths = bandwidth(autocovariances(centred, 2), len(centred))
    lags = _lags(widths, len(centred))
    own = autocovariances(centred, lags)
    return np.asarray(np.sum(bartlett_weights(widths, lags) * own, axis=0))


def autocovariances(series: Array, lags: int | None = None) -> Array:
    """Sum over samples of x_i x_(i+lag), lags 0 to `lags` - 1, shape (lags, P), by FFT.

    `lags` None are all N. Few of a long record come from pieces of it, each with the samples that
    its own meet: pieces that fit into the cache, not a transform of the whole.
    """
    n = len(series)
    lags = n if lags is None else min(lags, n)
    piece = min(n, max(PIECE, 4 * lags))
    size = next_fast_len(piece + lags - 1, real=True)
    spectrum = np.zeros((size // 2 + 1, series.shape[1]), dtype=np.complex128)
    for a in range(0, n, piece):
        those = np.fft.rfft(series[a : a + piece], size, axis=0)
        met = np.fft.rfft(series[a : a + piece + lags - 1], size, axis=0)
        spectrum += those.conj() * met
    return np.asarray(np.fft.irfft(spectrum, size, axis=0)[:lags])


def bandwidth(covariances: Array, n: int) -> Array:
    """Bartlett bandwidth of series of n samples from their first two autocovariances, (P,).

    1.1447 (alpha N)^(1/3), alpha = 4 rho^2 / ((1 - rho)^2 (1 + rho)^2), from a first-order
    autoregression. Andrews (1991), Econometrica 59, eqs. (6.2) and (6.4).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = np.clip(np.nan_to_num(covariances[1] / covariances[0]), -0.99, 0.99)
    alpha = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    return np.asarray(np.minimum(1.1447 * np.cbrt(alpha * n), n - 1.0))


def bartlett_weights(widths: Array, lags: int) -> Array:
    """Weights of both signs of each lag, shape (lags, P), for bandwidths (P,)."""
    weights = np.clip(1.0 - np.arange(lags)[:, None] / (widths + 1.0), 0.0, None)
    weights[1:] *= 2.0
    return np.asarray(weights)


def _lags(widths: Array, n: int) -> int:
    """How many lags have a weight at the widest bandwidth."""
    return min(n, int(np.ceil(np.max(widths, initial=0.0))) + 1)


def residual_blocks(rest: Array, length: int, rng: np.random.Generator) -> Array:
    """Residuals (N, K) drawn again in blocks of `length` samples that may begin anywhere.

    The record is closed to a ring so that every sample is as likely; all columns move together.
    """
    n = len(rest)
    starts = rng.integers(n, size=-(-n // length))
    index = (starts[:, None] + np.arange(length)).ravel()[:n] % n
    drawn = rest[index]
    return np.asarray(drawn - np.mean(drawn, axis=0))


def block_bootstrap(
    fit: Callable[[Array], Array],
    rest: Array,
    length: int,
    replicates: int,
    rng: np.random.Generator,
) -> Array:
    """Standard deviation of fit(residuals drawn again) over the replicates."""
    length = max(length, 1)
    fits = [fit(residual_blocks(rest, length, rng)) for _ in range(replicates)]
    return np.asarray(np.std(fits, axis=0, ddof=1))
