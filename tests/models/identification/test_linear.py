"""Least squares block by block against LAPACK's on all rows at once."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from seatrial.models.errors import IdentificationError
from seatrial.models.identification import least_squares as linear
from seatrial.models.identification import residual, uncertainty
from seatrial.models.identification.residual import Samples, turns
from seatrial.models.identification.uncertainty import bandwidth, long_run_covariances
from seatrial.models.vessel import basis

TERMS = basis.terms(["u", "1", "v", "r", "uv", "cos(theta)"])


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(residual, "BLOCK_ROWS", 50)
    monkeypatch.setattr(uncertainty, "PIECE", 90)


def samples_of(n: int, rng: np.random.Generator) -> Samples:
    """Four columns of very different sizes, the constant, one that does not vary; two targets."""
    x = rng.standard_normal((n, 4)) * [1e-3, 1.0, 1e3, 1.0] + [0.0, 5.0, 0.0, 1.0]
    x[:, 3] += 0.9 * x[:, 0] * 1e3
    phi = np.column_stack([x[:, 0], np.ones(n), x[:, 1:], np.full(n, 7.0)])
    epsilon = phi @ rng.standard_normal((6, 2)) + rng.standard_normal((n, 2))
    return Samples(TERMS, phi, epsilon, epsilon)


@pytest.mark.parametrize("n", [7, 60, 100, 149, 731])
def test_r_is_that_of_the_whole(n: int, rng) -> None:
    x = rng.standard_normal((n, 7)) * 10.0 ** np.arange(-3, 4)
    x[:, 1] = 1e-7 * x[:, 0] + x[:, 2] / 100.0
    R = linear.triangle(x[turn] for turn in turns(n))
    np.testing.assert_array_equal(R, np.triu(R))
    np.testing.assert_allclose(R.T @ R, x.T @ x, atol=1e-14 * np.linalg.norm(x) ** 2)
    own = np.linalg.svd(R, compute_uv=False)
    np.testing.assert_allclose(own, np.linalg.svd(x, compute_uv=False), atol=1e-14 * own[0])


@pytest.mark.parametrize("penalty", [0.0, 3.0])
def test_coefficients_of_each_axis_minimise_the_sum(penalty: float, rng) -> None:
    """The normal equations with a ridge, and what the fit of other targets adds."""
    n, penalties = 330, penalty * np.array([1.0, 2.0])
    samples, change = samples_of(n, rng), rng.standard_normal((n, 2))
    found, again = (
        linear.Decomposition.of(each).fit(penalties)
        for each in (samples, replace(samples, epsilon=samples.epsilon + change))
    )
    phi = samples.phi[:, :5]
    size = np.linalg.norm(phi, axis=0)
    for k in range(2):
        normal = phi.T @ phi + np.diag(penalties[k] * np.var(phi, axis=0))
        side = phi.T @ samples.epsilon[:, k] / size
        expected = np.linalg.solve(normal / np.outer(size, size), side) / size
        np.testing.assert_allclose(found.theta[:5, k], expected, rtol=1e-8)
        own, added = change[:, k] @ found.rows(slice(n)) @ found.shares[k], again.theta[:, k]
        added = added - found.theta[:, k]
        np.testing.assert_allclose(own, added, atol=1e-9 * np.max(np.abs(added)))
    assert np.all(found.theta[5] == 0.0)


def stationary_covariance(gain: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """G' T G with the weighted autocovariances of the residual in a Toeplitz matrix T."""
    n, lag = len(rest), np.arange(len(rest))
    gamma = np.correlate(rest, rest, "full")[n - 1 :] / n
    width = bandwidth(gamma[:2, None], n)[0]
    return gain.T @ toeplitz(gamma * np.clip(1.0 - lag / (width + 1.0), 0.0, None)) @ gain


@pytest.mark.parametrize("penalty", [0.0, 3.0])
def test_standard_errors_are_those_of_stationary_residuals(penalty: float, rng) -> None:
    fitted = linear.Decomposition.of(samples_of(400, rng)).fit(penalty * np.array([1.0, 2.0]))
    errors = fitted.standard_errors()
    rest = fitted.rest * np.sqrt(400 / (400 - fitted.parameters))
    for k in range(2):
        gains = fitted.rows(slice(400)) @ fitted.shares[k]
        variance = np.diag(stationary_covariance(gains[:, :5], rest[:, k]))
        np.testing.assert_allclose(errors[:5, k], np.sqrt(variance), rtol=1e-9)
    assert np.all(np.isnan(errors[5]))


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_covariances_in_pieces_are_those_of_the_whole(rho: float, rng) -> None:
    from scipy.signal import lfilter

    columns = rng.standard_normal((1000, 3))
    rest = lfilter([1.0], [1.0, -rho], rng.standard_normal((1000, 2)), axis=0)
    own = long_run_covariances(lambda rows: columns[rows], rest)
    for found, e in zip(own, rest.T, strict=True):
        np.testing.assert_allclose(found, stationary_covariance(columns, e), rtol=1e-9, atol=1e-9)


def test_dependent_columns_are_named(rng) -> None:
    samples = samples_of(200, rng)
    samples.phi[:, 4] = samples.phi[:, 2] - 3.0 * samples.phi[:, 3] / 1e3
    with pytest.raises(IdentificationError, match="does not distinguish v, r, uv from each other"):
        linear.Decomposition.of(samples).fit()
