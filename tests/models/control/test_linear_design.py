"""The design model: shares of the limits, what acts at rest, and what does not fit."""

import numpy as np
import pytest

from seatrial.models.control.linear_design import design_model
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.disturbance import ConstantForce
from tests.models.control.sailing import LIMITS, WINDAGE, double_integrators, ship

MASS = np.array([2.4e7, 4e7, 4.5e10])


def test_a_ship_without_linear_drag_is_three_double_integrators() -> None:
    model = design_model(ship(), LIMITS, 2.0).model
    np.testing.assert_allclose(model.A, [[*row] for row in np.eye(6) + 2.0 * np.eye(6, k=3)])
    share = np.array(LIMITS) / MASS
    np.testing.assert_allclose(model.B, np.vstack([np.diag(2.0 * share), np.diag(2.0 * share)]))
    found = {one.name: one.value for one in design_model(ship(), LIMITS, 2.0).diagnostics()}
    assert found["controllable_order"] == found["observable_order"] == found["model_order"] == 6.0
    assert found["open_loop_radius"] == pytest.approx(1.0, abs=1e-6)


def test_the_force_at_rest_is_kept_out_of_the_motion() -> None:
    """A force that is constant in NED is no restoring force in yaw."""
    pushed = ship() + ConstantForce(1e5, 2e5, 3e6).table(PLANAR)
    design = design_model(pushed, LIMITS, 1.0, WINDAGE)
    np.testing.assert_allclose(design.model.A, design_model(ship(), LIMITS, 1.0).model.A)
    psi = 0.7
    attitude, calm = np.array([[0.0, 0.0, psi]]), np.zeros((1, 3))
    wind = np.array([[3.0, -4.0]])
    whole = (pushed + WINDAGE.table(PLANAR)).inverse(calm, calm, attitude, wind)
    np.testing.assert_allclose(design.still.inverse(calm, calm, attitude, wind), whole)


def test_a_model_with_its_own_wind_terms_is_not_given_them_twice() -> None:
    own = ship() + WINDAGE.table(PLANAR)
    twice = design_model(own, LIMITS, 1.0, WINDAGE).still
    once = design_model(own, LIMITS, 1.0).still
    assert twice.terms == once.terms
    np.testing.assert_array_equal(twice.theta, once.theta)


def test_the_first_state_is_at_rest_where_it_was_measured() -> None:
    pose = np.array([3.0, -2.0, 0.4])
    start = design_model(ship(), LIMITS, 1.0).start() @ pose
    np.testing.assert_allclose(start, [*pose, 0.0, 0.0, 0.0], atol=1e-9)
    rng = np.random.default_rng(0)
    T = rng.normal(size=(6, 6))  # the same model in a state that means nothing
    physical = design_model(double_integrators(), LIMITS, 1.0).model
    hidden = StateSpace(
        T @ physical.A @ np.linalg.inv(T), T @ physical.B, physical.C @ np.linalg.inv(T),
        physical.D, 1.0,
    )  # fmt: skip
    design = design_model(hidden, (1.0, 1.0, 1.0), 1.0)
    state = np.linalg.solve(T, design.start() @ pose)
    np.testing.assert_allclose(state, [*pose, 0.0, 0.0, 0.0], atol=1e-4)


@pytest.mark.parametrize(
    ("model", "limits", "period_s", "message"),
    [
        (ship(), (1.0, 1.0), 1.0, "got 2 numbers, expected 3 for surge, sway, yaw"),
        (StateSpace(np.eye(2), np.eye(2), np.eye(2), np.eye(2), 1.0), (1.0,) * 2, 1.0, "direct"),
        (StateSpace(np.eye(2), np.eye(2), np.eye(2), 0 * np.eye(2), 0.7), (1.0,) * 2, 1.0, "0.7 s"),
        (StateSpace(np.eye(2), np.eye(2), np.ones((1, 2)), np.zeros((1, 2)), 1.0), (1.0,) * 2, 1.0,
         "1 outputs, expected 2"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(
    model: Vessel | StateSpace, limits: tuple[float, ...], period_s: float, message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        design_model(model, limits, period_s)
