"""The second-order modulus ship: its terms written out, in current and wind, and its damping."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from seatrial.models.notation import PLANAR
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.weather.wind import WindDerivatives
from tests.trials import composed

motions = arrays(np.float64, 3, elements=st.floats(-2.0, 2.0))
INERTIA = np.array([[26.0, 0.0, 0.0], [0.0, 34.0, 1.0], [0.0, 1.0, 2.8]])


def needed(table: object, nu: np.ndarray, wind: np.ndarray | None = None) -> np.ndarray:
    """F(0, nu) of one motion."""
    still = np.zeros((1, 3))
    body = None if wind is None else wind[None]
    return np.asarray(table.inverse(still, nu[None], still, body)[0])  # type: ignore[attr-defined]


@given(motions)
def test_the_terms_are_those_of_a_second_order_modulus_model(nu: np.ndarray) -> None:
    """x_i, |x_i|, x_i x_j and x_i |x_j|; Ljungberg, slides. Inertia gives Coriolis's x_i x_j."""
    derivatives = {"X_u": -1.0, "X_|u|u": -3.0, "Y_|v|": 0.2, "Y_|v|r": -1.5, "N_uv": 0.7}
    u, v, r = nu
    momentum = INERTIA @ nu
    expected = [
        -momentum[1] * r + u + 3.0 * abs(u) * u,
        momentum[0] * r - 0.2 * abs(v) + 1.5 * abs(v) * r,
        momentum[1] * u - momentum[0] * v - 0.7 * u * v,
    ]
    table = from_derivatives("ship", PLANAR, INERTIA, derivatives)
    np.testing.assert_allclose(needed(table, nu), expected, atol=1e-9)


@given(motions, arrays(np.float64, 2, elements=st.floats(-8.0, 8.0)))
def test_wind_has_a_relative_velocity_of_its_own(nu: np.ndarray, wind: np.ndarray) -> None:
    vessel = composed("vessel=modulus_ship", "disturbance=wind")
    assert isinstance(vessel.disturbance.wind.windage, WindDerivatives)
    table = vessel.disturbance.wind.table(PLANAR)
    ahead, aside = nu[:2] - wind
    expected = [0.03 * abs(ahead) * ahead, 0.09 * abs(aside) * aside, 0.01 * abs(aside) * aside]
    np.testing.assert_allclose(needed(table, nu, wind), expected, atol=1e-9)
