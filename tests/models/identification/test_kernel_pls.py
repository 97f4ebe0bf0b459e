"""The covariance algorithm against NIPALS, scikit-learn and published loadings."""

import numpy as np
import pytest
from sklearn.cross_decomposition import PLSRegression
from sklearn.datasets import load_linnerud

from seatrial.models.identification.kernel_pls import (
    Block,
    LeftOut,
    all_orders,
    components,
    left_out_mse,
)
from seatrial.models.recording.recording import blocks


def nipals(E: np.ndarray, F: np.ndarray, orders: int) -> tuple[np.ndarray, ...]:
    """W, P, Q and Theta_pre of every order, as Jervan (2020), eqs. (3.5)-(3.8) and (3.11)."""
    E, F = E.copy(), F.copy()
    W, P, Q, theta = [], [], [], []
    for _ in range(orders):
        u = F[:, [int(np.argmax(np.var(F, axis=0)))]]
        for _ in range(100_000):
            w = E.T @ u / (u.T @ u)
            w /= np.sqrt(w.T @ w)
            t = E @ w
            p = E.T @ t / (t.T @ t)
            q = F.T @ t / (t.T @ t)
            last, u = u, F @ q / (q.T @ q)
            if np.max(np.abs(u - last)) < 1e-14 * np.max(np.abs(u)):
                break
        E, F = E - t @ p.T, F - t @ q.T
        W, P, Q = [*W, w], [*P, p], [*Q, q]
        w_, p_, q_ = np.hstack(W), np.hstack(P), np.hstack(Q)
        theta.append(w_ @ np.linalg.solve(p_.T @ w_, q_.T))
    return w_, p_, q_, np.array(theta)


def standardised(x: np.ndarray) -> np.ndarray:
    return (x - x.mean(axis=0)) / x.std(axis=0)


def same_up_to_sign(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    signs = np.sign(np.sum(found * expected, axis=0))
    np.testing.assert_allclose(found * signs, expected, atol=tolerance)


@pytest.fixture(params=[1, 3])
def data(request) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(request.param)
    x = rng.standard_normal((300, 12)) @ rng.standard_normal((12, 12))
    y = x @ rng.standard_normal((12, request.param)) + rng.standard_normal((300, request.param))
    return standardised(x), standardised(y)


def test_equals_nipals(data) -> None:
    E, F = data
    w, p, q, theta = nipals(E, F, 12)
    found = components(E.T @ E, E.T @ F, 12)
    same_up_to_sign(found.weights, w, 1e-8)
    same_up_to_sign(found.loadings, p, 1e-8)
    signs = np.sign(np.sum(found.weights * w, axis=0))
    np.testing.assert_allclose(found.output_loadings * signs, q, atol=1e-8)
    np.testing.assert_allclose(found.coefficients, theta, atol=1e-8)


@pytest.mark.parametrize("orders", [1, 3, 7, 12])
def test_equals_scikit_learn(data, orders) -> None:
    x, y = data
    peer = PLSRegression(orders, tol=1e-20, max_iter=100_000).fit(x, y)
    found = components(x.T @ x, x.T @ y, orders)
    np.testing.assert_allclose(found.coefficients[-1], peer.coef_.T, atol=1e-8)


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
    same_up_to_sign(found.weights, np.array(weights), 2e-6)
    same_up_to_sign(found.loadings, np.array(loadings), 2e-6)
    same_up_to_sign(found.output_loadings, np.array(output), 2e-6)
    converged = PLSRegression(3, tol=1e-20, max_iter=100_000).fit(x, y)
    same_up_to_sign(found.weights, converged.x_weights_, 1e-8)
    same_up_to_sign(found.loadings, converged.x_loadings_, 1e-8)
    same_up_to_sign(found.output_loadings, converged.y_loadings_, 1e-8)


def test_the_last_order_is_least_squares(data) -> None:
    x, y = data
    z = np.column_stack([np.ones(len(x)), x, y])
    found = all_orders(z.T @ z, np.ones(12), 12)[-1]
    exact = np.linalg.lstsq(z[:, :13], y, rcond=None)[0]
    np.testing.assert_allclose(found, exact, atol=1e-9)


def test_the_divisor_beta_changes_what_comes_first_but_not_the_last_order(data) -> None:
    x, y = data
    z = np.column_stack([np.ones(len(x)), x, y])
    beta = np.where(np.arange(12) < 6, 1.0, 3.0)
    even, scaled = (all_orders(z.T @ z, b, 12) for b in (np.ones(12), beta))
    np.testing.assert_allclose(even[-1], scaled[-1], atol=1e-9)
    share = np.abs(scaled[0]) / np.abs(even[0])
    assert np.all(share[7:] < share[1:7].min(axis=0))


def test_a_fit_that_has_explained_everything_stops() -> None:
    rng = np.random.default_rng(0)
    x = standardised(rng.standard_normal((50, 2)) @ rng.standard_normal((2, 6)))
    found = components(x.T @ x, x.T @ x[:, :1], 6)
    assert np.all(np.isfinite(found.coefficients))
    np.testing.assert_allclose(x @ found.coefficients[-1], x[:, :1], atol=1e-6)


def test_coefficients_from_moments_have_the_constant_of_least_squares() -> None:
    z = np.random.default_rng(0).normal([0.0, 3.0, -2.0, 5.0, 1.0], 1.0, (60, 5))
    z[:, 0] = 1.0
    (expected, *_) = np.linalg.lstsq(z[:, :3], z[:, 3:])
    np.testing.assert_allclose(all_orders(z.T @ z, np.ones(2), 2)[-1], expected, rtol=1e-9)


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
