"""Standard errors for autocorrelated residuals, and the distribution of what was identified.

After a low-pass filter neighbouring residuals are correlated, so the textbook standard error for
white residuals is far too small. An estimate is linear in the residuals, theta_hat - theta =
sum_i g_i e_i, and with an autocovariance gamma of stationary residuals

    cov = sum_lag w(lag) gamma(lag) sum_i g_i g_(i+lag)'

with the Bartlett weights w of Newey and West (1987) and the bandwidth of Andrews (1991). Where an
estimate is not linear in the residuals, as one whose order is chosen, blocks of residuals are
resampled with the same regressors, and the model is fitted again: Kuensch (1989). White noise upon
a slow disturbance has two correlation times: `long_run_share` shows it, and a wide bandwidth allows
for it (`enlargement`).

Models are drawn from one covariance: coefficients of a ship are strongly correlated, and what is
predicted with all of them is known far better than each of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy

from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.problem import Identified, Spread
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

PIECE = 8192  # least number of samples in one transform


def stationary_covariance(gain: Array, rest: Array, width: float | None = None) -> Array:
    """Covariance (P, P) of sum_i g_i e_i for gains (N, P) and a stationary residual (N,).

    `width` [samples] replaces the bandwidth of Andrews; the covariance is then enlarged.
    """
    n, scale = len(rest), 1.0
    widths = bandwidth(autocovariances(rest[:, None], 2), n)
    if width is not None:
        widths = np.full_like(widths, min(width, n - 1.0))
        scale = enlargement(widths[0] / n)
    lags = min(n, int(np.ceil(widths[0])) + 1)
    weighted = bartlett_weights(widths, lags) * autocovariances(rest[:, None], lags) / n
    weighted = scale * weighted[:, 0]
    kernel = np.concatenate([0.5 * weighted[:0:-1], weighted[:1], 0.5 * weighted[1:]])
    columns = (scipy.signal.oaconvolve(column, kernel, mode="same") for column in gain.T)
    covariance = np.stack([gain.T @ column for column in columns], axis=1)
    return np.asarray(0.5 * (covariance + covariance.T))


def long_run_covariances(rows: Callable[[slice], Array], rest: Array) -> Array:
    """Covariances (K, q, q) of sum_i r_i e_ik for rows (N, q) and stationary residuals (N, K).

    `rows` gives those of a slice, so that a long record is in memory piece by piece; each is
    convolved with the weighted autocovariances and multiplied with its inner part by FFT.
    """
    n, (widths, K) = len(rest), (bandwidth(autocovariances(rest, 2), len(rest)), rest.shape[1])
    lags = min(n, int(np.ceil(np.max(widths))) + 1)
    weighted = bartlett_weights(widths, lags) * autocovariances(rest, lags) / n
    piece, reach = min(n, max(PIECE, 12 * lags)), lags - 1
    size = scipy.fft.next_fast_len(piece + 2 * reach, real=True)
    kernel = np.zeros((size, K))
    kernel[:lags] += 0.5 * weighted
    kernel[-np.arange(lags)] += 0.5 * weighted
    spectrum = scipy.fft.rfft(kernel, axis=0).real / size
    spectrum[1 : (size + 1) // 2] *= 2.0  # for the negative frequencies
    spectrum = np.concatenate([spectrum, spectrum])  # of real and imaginary parts
    total: Array | None = None
    for a in range(0, n, piece):
        begin = max(a - reach, 0)
        outer = rows(slice(begin, min(a + piece + reach, n)))
        inner = np.zeros_like(outer)
        inner[a - begin : a - begin + piece] = outer[a - begin : a - begin + piece]
        parts = [scipy.fft.rfft(values, size, axis=0) for values in (inner, outer)]
        left, right = (np.concatenate([values.real, values.imag]) for values in parts)
        found = np.stack([left.T @ (weight[:, None] * right) for weight in spectrum.T])
        total = found if total is None else total + found
    assert total is not None
    return np.asarray(0.5 * (total + total.transpose(0, 2, 1)))


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
    independent sample. J (N n, m) is the jacobian of the predictions, `rest` (N, n) in units of its
    deviation, `prior` (m,) the precision about p_0, `unknowns` the number of all, by which the
    residuals are too small, `width` the bandwidth as in `stationary_covariance`.
    """
    precision = tau * prior
    inverse = np.linalg.pinv(jacobian.T @ jacobian + np.diag(precision), hermitian=True)
    gains = (jacobian @ inverse).reshape(*rest.shape, -1).transpose(1, 0, 2)
    parts = [stationary_covariance(g, e, width) for g, e in zip(gains, rest.T, strict=True)]
    freedom = rest.size / max(rest.size - unknowns, 1)
    return np.asarray(freedom * np.sum(parts, axis=0) + tau * (inverse * precision) @ inverse)


def autocovariances(series: Array, lags: int) -> Array:
    """Sum over samples of x_i x_(i+lag), lags 0 to `lags` - 1, shape (lags, P), by FFT.

    For few lags of a long record the sum is computed in pieces that fit into the cache, each with
    the following samples that the lags need.
    """
    n = len(series)
    lags, piece = min(lags, n), min(n, max(PIECE, 4 * lags))
    size = scipy.fft.next_fast_len(piece + lags - 1, real=True)
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


def block_bootstrap(
    fit: Callable[[Array], Array], rest: Array, length: int, replicates: int, rng:
    np.random.Generator,
) -> Array:  # fmt: skip
    """Standard deviation of fit(resampled residuals) over the replicates.

    Residuals (N, K) are resampled, all columns together, in blocks of `length` samples with random
    starts. The record is treated as periodic, so that all samples are equally likely.
    """
    n, length, fits = len(rest), max(length, 1), []
    for _ in range(replicates):
        starts = rng.integers(n, size=-(-n // length))
        drawn = rest[(starts[:, None] + np.arange(length)).ravel()[:n] % n]
        fits.append(fit(drawn - np.mean(drawn, axis=0)))
    return np.asarray(np.std(fits, axis=0, ddof=1))


@dataclass(frozen=True, eq=False)
class TableSpread(Spread):
    """Normal distribution of a table that a regression has found; variances of zero are fixed.

    `within` holds a factor A (n_terms, n_terms) of the correlation A A' of the coefficients of
    every degree of freedom, `across` one (n_dof, n_dof) of that of their residuals.
    """

    within: tuple[Array, ...]
    across: Array

    def draw(
        self, result: Identified, rng: np.random.Generator, share: float = 1.0, kappa2: float = 1.0
    ) -> Vessel:
        """The model with coefficients drawn from the distribution; fixed ones stay."""
        residual = result.residual
        assert result.std_error is not None
        z = rng.standard_normal((len(self.within[0]), len(self.across))) @ self.across.T
        units = np.stack([A @ z[:, k] for k, A in enumerate(self.within)], axis=1)
        change = share * np.sqrt(kappa2) * np.nan_to_num(result.std_error) * units
        return result.model + Vessel("drawn", residual.dofs, residual.terms, change)


@dataclass(frozen=True, eq=False)
class ParameterSpread(Spread):
    """Normal distribution of free parameters (m,), those of devices among them."""

    nominal: Vessel
    free: FreeParameters
    point: Array
    covariance: Array  # (m, m)
    prior: Array | None = None  # (m,) precision of the prior, which inv(covariance) contains
    _factors: dict[float, Array] = field(default_factory=dict, init=False)

    def draw(
        self, result: Identified, rng: np.random.Generator, share: float = 1.0, kappa2: float = 1.0
    ) -> Vessel:
        """The model with parameters drawn from the distribution, devices in plausible ranges."""
        change = self.factor(kappa2) @ rng.standard_normal(len(self.point))
        return self.free.model(self.nominal, self.point + share * change)

    def factor(self, kappa2: float) -> Array:
        """B (m, m) with B B' = ((inv(covariance) - P) / kappa2 + P)^-1, P the prior's precision.

        With A A' = covariance and the eigenvalues and vectors of A'PA = V diag(b) V', the shares of
        the prior in what is known, B is A V diag((1 - b) / kappa2 + b)^(-1/2) V'.
        """
        if kappa2 not in self._factors:
            A = factor_of(self.covariance)
            P = np.zeros(len(A)) if self.prior is None else self.prior
            share, V = np.linalg.eigh(A.T @ (P[:, None] * A))
            share = np.clip(share, 0.0, 1.0)
            self._factors[kappa2] = A @ (V / np.sqrt((1.0 - share) / kappa2 + share)) @ V.T
        return self._factors[kappa2]


def correlation(covariance: Array) -> Array:
    """Correlations (n, n) of a covariance; zero where there is no variance."""
    deviation = np.sqrt(np.diag(covariance))
    inverse = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=deviation > 0.0)
    return np.asarray(covariance * np.outer(inverse, inverse))


def factor_of(covariance: Array) -> Array:
    """A with A A' = covariance (n, n), which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
