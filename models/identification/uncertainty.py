"""Standard errors for autocorrelated residuals.

After a low-pass filter neighbouring residuals are correlated, so the textbook standard error for
white residuals is far too small. An estimate is linear in the residuals, theta_hat - theta =
sum_i g_i e_i, and with an autocovariance gamma of the residuals

    stationary   var = sum_lag w(lag) gamma_e(lag) sum_i g_i g_(i+lag)
    hac          var = sum_lag w(lag) sum_i (g_i e_i) (g_(i+lag) e_(i+lag))

both with the Bartlett weights w of Newey and West (1987) and the bandwidth of Andrews (1991).
`hac` allows a variance of the residuals that changes with the motion, but needs many independent
manoeuvres: with three turns in a training lap it gives half of the true standard error in yaw.
`stationary` does not need them. The alternative is a block bootstrap (Kuensch, 1989): blocks of
residuals are resampled with the same regressors, and the model is fitted again.

That bandwidth is of one correlation time. White noise upon a slow disturbance has two: neighbouring
residuals are hardly correlated, yet distant ones are. `long_run_share` shows it, and a wide
bandwidth allows for it (`enlargement`).
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
import scipy
import scipy.signal
from scipy.fft import next_fast_len

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import MOST_REPEATS
from seatrial.models.vessel.basis import Array

ErrorKind = Literal["stationary", "hac"]
PIECE = 8192  # least number of samples in one transform


def check_bootstrap(bootstrap: int | None, block_s: float) -> None:
    """Raise ConfigurationError for fewer than 20 or too many replicates, or empty blocks."""
    if bootstrap is not None and bootstrap < 20:
        raise ConfigurationError(f"bootstrap must be at least 20 or null, got {bootstrap}")
    if bootstrap is not None and bootstrap > MOST_REPEATS:
        raise ConfigurationError(f"bootstrap must be at most {MOST_REPEATS}, got {bootstrap}")
    if not block_s > 0.0:
        raise ConfigurationError(f"block_s must be positive, got {block_s}")


def stationary_variance(gain: Array, rest: Array, width: float | None = None) -> Array:
    """Variance of sum_i g_i e_i for gains (N, P) and a stationary residual (N,), shape (P,).

    For several residuals (N, K) it is computed for each, shape (P, K). `width` [samples] replaces
    the bandwidth of Andrews; the variance is then enlarged by `enlargement`.
    """
    weighted = _weighted_autocovariances(rest.reshape(len(rest), -1), width)
    variance = autocovariances(gain, len(weighted)).T @ weighted
    return np.asarray(variance.reshape(gain.shape[1:] + rest.shape[1:]))


def stationary_covariance(gain: Array, rest: Array, width: float | None = None) -> Array:
    """Covariance (P, P) of sum_i g_i e_i; the diagonal is `stationary_variance`.

    Gains (N, P), residual (N,).
    """
    weighted = _weighted_autocovariances(rest[:, None], width)[:, 0]
    kernel = np.concatenate([0.5 * weighted[:0:-1], weighted[:1], 0.5 * weighted[1:]])
    columns = (scipy.signal.oaconvolve(column, kernel, mode="same") for column in gain.T)
    covariance = np.stack([gain.T @ column for column in columns], axis=1)
    return np.asarray(0.5 * (covariance + covariance.T))


def _weighted_autocovariances(rest: Array, width: float | None) -> Array:
    """Those of residuals (N, K), means over samples with Bartlett's weights, (lags, K)."""
    n = len(rest)
    widths = bandwidth(autocovariances(rest, 2), n)
    if width is not None:
        widths = np.full_like(widths, min(width, n - 1.0))
    lags = _lags(widths, n)
    weighted = bartlett_weights(widths, lags) * autocovariances(rest, lags) / n
    return weighted if width is None else np.asarray(weighted * enlargement(widths[0] / n))


def enlargement(share: float) -> float:
    """Of a variance by Bartlett's weights over a fixed `share` of the samples.

    With it 1.96 standard deviations are a 95 % interval: the sum has few independent parts.
    Kiefer and Vogelsang (2005), Econometric Theory 21, Table 1.
    """
    critical = 1.96 + 2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3
    return (critical / 1.96) ** 2


def long_run_share(rest: Array, width: float) -> Array:
    """Variance at low frequency of residuals (N, K) over that of white noise, shape (K,).

    Low are frequencies that `width` [samples] cannot resolve; white noise has 1.
    """
    centred = rest - np.mean(rest, axis=0)
    lags = min(len(rest), int(width) + 1)
    own = autocovariances(centred, lags)
    total = np.sum(bartlett_weights(np.full(own.shape[1], width), lags) * own, axis=0)
    return np.asarray(np.divide(total, own[0], out=np.ones_like(total), where=own[0] > 0.0))


def parameter_covariance(
    jacobian: Array, rest: Array, prior: Array, tau: float, unknowns: int, width: float | None
) -> Array:
    """Covariance of parameters p_hat that minimise |rest|^2 + tau (p - p_0)' diag(prior) (p - p_0).

    With H = J'J + tau diag(prior), p_hat - p = H^-1 J' e has the covariance for stationary
    residuals e that do not depend on each other, and the prior's share H^-1 tau^2 diag(prior) H^-1:
    together about tau H^-1, where tau is the number of samples that say as much as one
    independent sample.

    Args:
        jacobian: J of the predictions by the parameters, shape (N n, m).
        rest: residuals in units of their deviation, shape (N, n).
        prior: precision of the prior about p_0, shape (m,).
        tau: of the residuals.
        unknowns: number of all unknowns, by which the residuals are too small.
        width: bandwidth as in `stationary_variance`.

    Returns:
        The covariance, shape (m, m).
    """
    precision = tau * prior
    inverse = np.linalg.pinv(jacobian.T @ jacobian + np.diag(precision), hermitian=True)
    gains = (jacobian @ inverse).reshape(*rest.shape, -1).transpose(1, 0, 2)
    parts = [stationary_covariance(g, e, width) for g, e in zip(gains, rest.T, strict=True)]
    freedom = rest.size / max(rest.size - unknowns, 1)
    return np.asarray(freedom * np.sum(parts, axis=0) + tau * (inverse * precision) @ inverse)


def hac_variance(influence: Array) -> Array:
    """Variance of the sum of influence series (N, P), shape (P,)."""
    centred = influence - np.mean(influence, axis=0)
    widths = bandwidth(autocovariances(centred, 2), len(centred))
    lags = _lags(widths, len(centred))
    own = autocovariances(centred, lags)
    return np.asarray(np.sum(bartlett_weights(widths, lags) * own, axis=0))


def autocovariances(series: Array, lags: int | None = None) -> Array:
    """Sum over samples of x_i x_(i+lag), lags 0 to `lags` - 1, shape (lags, P), by FFT.

    `lags` None computes all N. For few lags of a long record the sum is computed in pieces that fit
    into the cache, each with the following samples that the lags need.
    """
    n = len(series)
    lags = n if lags is None else min(lags, n)
    piece = min(n, max(PIECE, 4 * lags))
    size = next_fast_len(piece + lags - 1, real=True)
    spectrum = np.zeros((size // 2 + 1, series.shape[1]), dtype=np.complex128)
    for a in range(0, n, piece):
        piece_spectrum = np.fft.rfft(series[a : a + piece], size, axis=0)
        shifted_spectrum = np.fft.rfft(series[a : a + piece + lags - 1], size, axis=0)
        spectrum += piece_spectrum.conj() * shifted_spectrum
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
    """Bartlett weights for the sum over both signs of each lag, (lags, P), bandwidths (P,)."""
    weights = np.clip(1.0 - np.arange(lags)[:, None] / (widths + 1.0), 0.0, None)
    weights[1:] *= 2.0
    return np.asarray(weights)


def _lags(widths: Array, n: int) -> int:
    """Number of lags with a non-zero weight at the largest bandwidth."""
    return min(n, int(np.ceil(np.max(widths, initial=0.0))) + 1)


def residual_blocks(rest: Array, length: int, rng: np.random.Generator) -> Array:
    """Resample residuals (N, K) in blocks of `length` samples with random starts.

    The record is treated as periodic, so that all samples are equally likely. All columns are
    resampled together.
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
    """Standard deviation of fit(resampled residuals) over the replicates."""
    length = max(length, 1)
    fits = [fit(residual_blocks(rest, length, rng)) for _ in range(replicates)]
    return np.asarray(np.std(fits, axis=0, ddof=1))
