"""The spread of a fit over segments, on a linear fit whose errors are known."""

import numpy as np
import pytest

from seatrial.models.identification.uncertainty import SegmentSpread

SEGMENTS, LENGTH, TRIALS = 60, 50, 400
BEGIN = np.arange(0, SEGMENTS * LENGTH, LENGTH)


def regressors() -> np.ndarray:
    """Two columns that are nearly alike: their sum is known far better than each, (N, 1, 2)."""
    rng = np.random.default_rng(0)
    one = np.repeat(rng.standard_normal(SEGMENTS), LENGTH)
    other = one + 0.05 * np.repeat(rng.standard_normal(SEGMENTS), LENGTH)
    return np.stack([one, other], axis=1)[:, None, :]


def noise(rng: np.random.Generator, slow: float) -> np.ndarray:
    """White, and an offset of each segment, which grows with the first column, (N, 1)."""
    offset = slow * np.repeat(rng.standard_normal(SEGMENTS), LENGTH) * regressors()[:, 0, 0] ** 2
    return (rng.standard_normal(SEGMENTS * LENGTH) + offset)[:, None]


def spread_of(J: np.ndarray, e: np.ndarray, prior: float = 0.0) -> tuple[np.ndarray, SegmentSpread]:
    """Estimates (2,) of parameters that are zero, and their spread."""
    flat = J[:, 0]
    inverse = np.linalg.inv(flat.T @ flat + prior * np.eye(2))
    estimate = inverse @ flat.T @ e[:, 0]
    rest = e - (flat @ estimate)[:, None]
    freedom = len(e) / (len(e) - 2)
    return estimate, SegmentSpread(inverse, J @ inverse, rest, BEGIN, freedom, np.full(2, prior))


@pytest.mark.parametrize("slow", [0.0, 0.5])
def test_the_joint_covariance_is_that_of_the_estimates(slow: float) -> None:
    """Of each parameter and of their sum, for white residuals and for those of segments."""
    J, rng = regressors(), np.random.default_rng(1)
    fits = [spread_of(J, noise(rng, slow)) for _ in range(TRIALS)]
    true = np.cov(np.array([estimate for estimate, _ in fits]).T)
    joint = np.mean([spread.joint for _, spread in fits[:40]], axis=0)
    for mix in np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]):
        assert mix @ joint @ mix == pytest.approx(mix @ true @ mix, rel=0.35)


def test_a_prior_has_its_share() -> None:
    """Where the data say nothing the variance is the prior's."""
    J, rng = 1e-6 * regressors(), np.random.default_rng(3)
    _, spread = spread_of(J, noise(rng, 0.0), prior=4.0)
    np.testing.assert_allclose(np.diag(spread.joint), 0.25, rtol=1e-6)
    np.testing.assert_allclose(np.diag(spread.covariance), 0.25, rtol=1e-6)
