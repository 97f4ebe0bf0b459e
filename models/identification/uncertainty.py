"""Standard errors that know that residuals of motion are autocorrelated.

A low-pass makes neighbouring residuals alike, so the textbook error (white residuals) is too
small. Two remedies: the long-run variance of each coefficient's influence series with a Bartlett
kernel (Newey & West, 1987; bandwidth by Andrews, 1991), and the block bootstrap (Kuensch, 1989).
"""

from collections.abc import Callable

import numpy as np

from models.basis import Array
from models.errors import ConfigurationError


def check_bootstrap(bootstrap: int | None, block_s: float) -> None:
    """Refuse too few replicates and empty blocks."""
    if bootstrap is not None and bootstrap < 20:
        raise ConfigurationError(f"bootstrap must be at least 20 or null, got {bootstrap}")
    if not block_s > 0.0:
        raise ConfigurationError(f"block_s must be positive, got {block_s}")


def hac_standard_errors(influence: Array, parameters: int) -> Array:
    """Standard errors from influence series (N, P): sqrt of their long-run variance, shape (P,).

    Each column sums to the error of one coefficient; `parameters` were fitted together, for which
    the variance is enlarged by N / (N - parameters).
    """
    n = len(influence)
    psi = influence - np.mean(influence, axis=0)
    covariances = _autocovariances(psi)
    bandwidth = bartlett_bandwidth(covariances, n)
    lags = np.arange(n)[:, None]
    weights = np.clip(1.0 - lags / (bandwidth + 1.0), 0.0, None)
    weights[1:] *= 2.0
    variance = np.sum(weights * covariances, axis=0) * n / max(n - parameters, 1)
    return np.asarray(np.sqrt(np.clip(variance, 0.0, None)))


def bartlett_bandwidth(covariances: Array, n: int) -> Array:
    """Andrews' bandwidth for the Bartlett kernel from a first-order autoregression, shape (P,).

    covariances (N, P) by lag; 1.1447 (alpha n)^(1/3), alpha = 4 rho^2 / ((1 - rho)^2 (1 + rho)^2).
    Andrews (1991), eqs. (6.2) and (6.4).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = np.nan_to_num(covariances[1] / covariances[0])
    rho = np.clip(rho, -0.99, 0.99)
    alpha = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    return np.asarray(np.minimum(1.1447 * np.cbrt(alpha * n), n - 1.0))


def _autocovariances(psi: Array) -> Array:
    """Sum over samples of psi_i psi_(i+lag), lag 0 to N - 1, shape (N, P), by FFT."""
    n = len(psi)
    spectrum = np.fft.rfft(psi, 2 * n, axis=0)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, 2 * n, axis=0)[:n])


def block_moments(columns: Array, length: int) -> Array:
    """Z'Z of consecutive blocks of about `length` samples, shape (n_blocks, m, m); Z is (N, m)."""
    count = max(round(len(columns) / length), 2)
    return np.array([block.T @ block for block in np.array_split(columns, count)])


def block_bootstrap(
    moments: Array, fit: Callable[[Array], Array], replicates: int, rng: np.random.Generator
) -> Array:
    """Standard deviation of fit(Z'Z) over resampled blocks, shape of what `fit` returns."""
    count = len(moments)
    draws = rng.multinomial(count, np.full(count, 1.0 / count), size=replicates)
    fits = [fit(np.tensordot(draw, moments, axes=1)) for draw in draws]
    return np.asarray(np.std(fits, axis=0, ddof=1))
