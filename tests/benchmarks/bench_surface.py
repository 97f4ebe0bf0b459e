"""The surface analysis against scikit-learn's regression, model by model; about a minute."""

from typing import Any, NamedTuple

import numpy as np
from sklearn import config_context
from sklearn.cross_decomposition import PLSRegression

from seatrial.models.identification.plsr import Columns, columns, mean_squares, output_moment
from seatrial.models.identification.surface_plsr import MIN_COUNT, exists, whole_surface
from seatrial.models.vessel.basis import Array
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite
from tests.trials import composed

AXES = 3


class Surfaces(NamedTuple):
    """Coefficients on Z (axes, order, number of terms, J) and the MSE of what was left out."""

    theta: Array
    mse: Array  # (axes, order, number of terms), NaN where there is no model


def lap() -> tuple[Columns, Array]:
    """Z of the first half of the ferry's lap, measured with noise, and of the second."""
    trial = composed("identifier=surface_plsr", "disturbance=noise")
    excited = excite(trial, Streams(trial.seed))
    nominal, lag = trial.vessel.nominal(), trial.vessel.thruster
    training, testing = (
        trial.identifier.samples(excited.recording.part(which), nominal, lag)
        for which in (excited.training, excited.testing)
    )
    z = columns(training)
    return z, z.like(testing)


def ours(z: Columns, held_out: Array) -> Surfaces:
    """By the covariances, all terms and orders in one compiled call an axis."""
    moment, left = z.z.T @ z.z, held_out.T @ held_out
    theta = [whole_surface(output_moment(moment, z.n_x, k), z.beta) for k in range(AXES)]
    mse = [mean_squares(output_moment(left, z.n_x, k), theta[k])[..., 0] for k in range(AXES)]
    kept = exists(z.n_x)
    return Surfaces(
        np.array([one[:, :, 1:, 0] for one in theta]),
        np.array([np.where(kept, one, np.nan) for one in mse]),
    )


def theirs(z: Columns, held_out: Array) -> Surfaces:
    """A fit for every model, from the samples; scikit-learn's checks of its input switched off."""
    n = z.n_x
    x, left = z.x[:, 1:] / z.beta, held_out[:, 1 : 1 + n] / z.beta
    found = Surfaces(np.zeros((AXES, n, n, n)), np.full((AXES, n, n), np.nan))
    with config_context(assume_finite=True, skip_parameter_validation=True):
        for k in range(AXES):
            y, y_left = z.y[:, k], held_out[:, 1 + n + k]
            for order in range(1, n + 1):
                kept = np.arange(n)
                while len(kept) >= max(MIN_COUNT, order):
                    fitted = PLSRegression(order, scale=False).fit(x[:, kept], y)
                    size, rest = len(kept) - 1, y_left - fitted.predict(left[:, kept])
                    found.theta[k, order - 1, size, kept] = fitted.coef_[0] / z.beta[kept]
                    found.mse[k, order - 1, size] = np.mean(rest**2)
                    kept = np.delete(kept, np.argmin(np.abs(fitted.coef_[0])))
    return found


def test_surface(in_turn: Any) -> None:
    z, held_out = lap()
    mine, other = ours(z, held_out), theirs(z, held_out)
    models = np.count_nonzero(~np.isnan(other.mse))
    assert models == 3 * 464
    largest = np.max(np.abs(other.theta), axis=3, keepdims=True)
    assert np.all(np.abs(mine.theta - other.theta) <= 1e-8 * largest)
    np.testing.assert_allclose(mine.mse, other.mse, rtol=1e-8)
    in_turn(
        lambda: ours(z, held_out), lambda: theirs(z, held_out),
        item="2", what=f"surface analysis, 3 x 464 models of {len(z.z):,} samples",
        name="covariances", peer_name="scikit-learn's PLSRegression one by one", wanted=10.0,
        rounds=3, calls=10, warm=False,
        note="coefficients agree to 1e-8 of a model's largest, the MSE on as many samples to 1e-8",
    )  # fmt: skip
