"""The covariance algorithm against NIPALS of scikit-learn and published loadings."""

from typing import NamedTuple

import numpy as np
import pytest
from sklearn.cross_decomposition import PLSRegression
from sklearn.datasets import load_linnerud

from seatrial.models.identification.plsr import (
    Block,
    LeftOut,
    all_orders,
    left_out_mse,
    partial_least_squares,
)
from seatrial.models.recording.recording import blocks


class Components(NamedTuple):
    weights: np.ndarray  # (J, orders)
    loadings: np.ndarray  # (J, orders)
    output_loadings: np.ndarray  # (K, orders)
    coefficients: np.ndarray  # (orders, J, K)


def components(xx: np.ndarray, xy: np.ndarray, orders: int) -> Components:
    (n_x, n_y), shape = xy.shape, (xy.shape[0], orders)
    found = Components(
        np.zeros(shape), np.zeros(shape), np.zeros((n_y, orders)), np.zeros((orders, n_x, n_y))
    )
    partial_least_squares(np.ascontiguousarray(xx), np.ascontiguousarray(xy), *found)
    return found


def standardised(x: np.ndarray) -> np.ndarray:
    return (x - x.mean(axis=0)) / x.std(axis=0)


def same_up_to_sign(
    found: Components, weights: np.ndarray, loadings: np.ndarray, output: np.ndarray, atol: float
) -> None:
    """Compare W, P and Q; a component may be turned round."""
    signs = np.sign(np.sum(found.weights * weights, axis=0))
    np.testing.assert_allclose(found.weights * signs, weights, atol=atol)
    np.testing.assert_allclose(found.loadings * signs, loadings, atol=atol)
    np.testing.assert_allclose(found.output_loadings * signs, output, atol=atol)


def nipals(x: np.ndarray, y: np.ndarray, orders: int) -> PLSRegression:
    return PLSRegression(orders, tol=1e-20, max_iter=100_000).fit(x, y)


@pytest.fixture(params=[1, 3])
def data(request) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(request.param)
    x = rng.standard_normal((300, 12)) @ rng.standard_normal((12, 12))
    y = x @ rng.standard_normal((12, request.param)) + rng.standard_normal((300, request.param))
    return standardised(x), standardised(y)


def test_equals_scikit_learn(data) -> None:
    """Weights and loadings by NIPALS, and the coefficients of its first components."""
    x, y = data
    found, peer = components(x.T @ x, x.T @ y, 12), nipals(x, y, 12)
    same_up_to_sign(found, peer.x_weights_, peer.x_loadings_, peer.y_loadings_, 1e-8)
    for orders in (1, 3, 7, 12):
        expected = nipals(x, y, orders).coef_.T
        np.testing.assert_allclose(found.coefficients[orders - 1], expected, atol=1e-8)


def test_published_linnerud_loadings() -> None:
    # scikit-learn's test_sanity_check_pls_regression, checked there against the R packages
    # plspm, mixOmics and pls; its power iteration stopped at 1e-6, hence the tolerance
    weights = [
        [-0.61330704, -0.00443647, 0.78983213],
        [-0.74697144, -0.32172099, -0.58183269],
        [-0.25668686, 0.94682413, -0.19399983],
    ]
    loadings = [
        [-0.61470416, -0.24574278, 0.78983213],
        [-0.65625755, -0.14396183, -0.58183269],
        [-0.51733059, 1.00609417, -0.19399983],
    ]
    output = [
        [0.32456184, 0.29892183, 0.20316322],
        [0.42439636, 0.61970543, 0.19320542],
        [-0.13143144, -0.26348971, -0.17092916],
    ]
    x, y = (standardised(part) for part in load_linnerud(return_X_y=True))
    found = components(x.T @ x, x.T @ y, 3)
    same_up_to_sign(found, *(np.array(table) for table in (weights, loadings, output)), 2e-6)
    peer = nipals(x, y, 3)
    same_up_to_sign(found, peer.x_weights_, peer.x_loadings_, peer.y_loadings_, 1e-8)


def test_the_last_order_is_least_squares_and_the_divisor_beta_says_what_comes_first(data) -> None:
    x, y = data
    z = np.column_stack([np.ones(len(x)), x + np.arange(12.0), y - 2.0])
    exact = np.linalg.lstsq(z[:, :13], z[:, 13:], rcond=None)[0]
    beta = np.where(np.arange(12) < 6, 1.0, 3.0)
    even, scaled = (all_orders(z.T @ z, divisor, 12) for divisor in (np.ones(12), beta))
    for found in (even, scaled):
        np.testing.assert_allclose(found[-1], exact, atol=1e-8)
    share = np.abs(scaled[0]) / np.abs(even[0])
    assert np.all(share[7:] < share[1:7].min(axis=0))


def test_a_fit_that_has_explained_everything_stops() -> None:
    rng = np.random.default_rng(0)
    x = standardised(rng.standard_normal((50, 2)) @ rng.standard_normal((2, 6)))
    found = components(x.T @ x, x.T @ x[:, :1], 6)
    assert np.all(np.isfinite(found.coefficients))
    np.testing.assert_allclose(x @ found.coefficients[-1], x[:, :1], atol=1e-6)


def test_pairs_are_moments_of_the_rows() -> None:
    """Each block is left out once; sums of the blocks' moments are those of the rows themselves."""
    rng = np.random.default_rng(0)
    z = np.column_stack([np.ones(61), rng.standard_normal((61, 4))])
    rows = blocks(61, 3)
    parts = tuple(Block.of(z[:, :3], block) for block in rows)
    left_out = LeftOut(parts, None)
    pairs = left_out.pairs(left_out.moments(z[:, 3:]))
    for (used, left), block in zip(pairs, rows, strict=True):
        kept = np.delete(z, np.arange(61)[block], axis=0)
        np.testing.assert_allclose(used, kept.T @ kept)
        np.testing.assert_allclose(left, z[block].T @ z[block])
    lengths = np.array([len(z[block]) for block in rows])
    sizes = left_out_mse(pairs, lambda _, left: left[0, :1])
    assert sizes == pytest.approx(np.sum(lengths**2) / 61)
    other = np.eye(5)
    ((whole, judged),) = LeftOut(parts, other).pairs(left_out.moments(z[:, 3:]))
    np.testing.assert_allclose(whole, z.T @ z)
    assert judged is other
