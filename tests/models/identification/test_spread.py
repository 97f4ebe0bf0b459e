"""Models drawn from the distribution of an identified one."""

import numpy as np
import pytest

from seatrial.models.vessel import basis
from tests.models.identification.test_devices_jointly import changed, joint, noisy, parts, value
from tests.models.identification.test_steered import (
    WRONG,
    identified,
    listed,
    mistaken,
    problem,
    recorded,
    vessel,
)


@pytest.mark.parametrize("identifier", ["ls", "iv"])
def test_drawn_coefficients_have_the_errors_and_correlations_of_the_fit(identifier: str) -> None:
    """Mean, deviation and correlation of the draws; those of least squares are of (X'X)^-1."""
    truth = vessel("mariner")
    own = problem("mariner", truth, mistaken(truth, WRONG))
    own = type(own)(noisy(own.training, 0, 0.02), own.validation, own.nominal, None)
    more = ("identifier.orientation_terms=false",) if identifier == "iv" else ()
    result = identified(
        identifier, own, listed(WRONG), "identifier.lowpass_hz=null",
        "identifier.inertia_factor=null", *more,
    )  # fmt: skip
    tables = np.array([one.on(result.residual.terms).theta for one in result.draws(2000)])
    errors = result.std_error
    mean = result.model.on(result.residual.terms).theta
    np.testing.assert_allclose(np.std(tables, axis=0), errors, rtol=0.08)
    assert np.all(np.abs(np.mean(tables, axis=0) - mean) < 4.0 * errors / np.sqrt(len(tables)))
    if identifier == "ls":
        phi = own.training.variables()
        x = basis.evaluate(result.residual.terms, phi)
        covariance = np.linalg.inv(x.T @ x)
        root = np.sqrt(np.diag(covariance))
        expected = covariance / np.outer(root, root)
        for k in range(3):
            np.testing.assert_allclose(np.corrcoef(tables[:, :, k].T), expected, atol=0.1)


@pytest.mark.slow
def test_drawn_devices_have_the_errors_of_the_fit() -> None:
    """Rudder and hull are drawn together."""
    nominal = vessel("kvlcc2")
    own = parts(noisy(recorded("kvlcc2", changed(nominal, rudder__a_H=1.2), 600), 0, 0.05), nominal)
    labels = "identifier.free=[rudder.a_H,yaw.rU]"
    result = joint(
        "output_error", own, labels, "identifier.horizon=100", "identifier.horizons=[]",
        "identifier.prior=null",
    )  # fmt: skip
    models = result.draws(1000)
    values = np.array([(value(m, "rudder.a_H"), m.coefficient("yaw", "rU")) for m in models])
    expected = result.device_errors["rudder.a_H"]
    assert np.std(values[:, 0]) == pytest.approx(expected, rel=0.1)
    covariance = result.spread.covariance
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.corrcoef(values.T)[0, 1] == pytest.approx(correlation[0, 1], abs=0.1)
