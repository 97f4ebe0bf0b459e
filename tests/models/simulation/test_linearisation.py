"""Linearisation against finite differences of the equations of motion."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from seatrial.models import notation
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.linearisation import gradient, linearise, operating_force
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import N_VARIABLES
from seatrial.models.vessel.derivatives import derivative_table, from_derivatives
from seatrial.models.vessel.kinematics import angle_rate, frame_of_angles
from seatrial.models.vessel.table import Vessel

WINDAGE = {"X_|u_q|u_q": -9.0, "Y_|v_q|v_q": -30.0, "N_V_qv_q": -4.0}


def rates(vessel: Vessel, state: np.ndarray, tau: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """(eta_dot, nu_dot) in the plane or in six degrees of freedom, written as in the books."""
    n = len(vessel.dofs)
    eta, nu, frame = state[:n], state[n:], np.empty((3, 3))
    attitude = eta[3:] if n == 6 else np.array([0.0, 0.0, eta[2]])
    frame_of_angles(attitude, frame)
    air = (frame.T @ [*wind, 0.0])[:2]
    nu_dot = vessel.forward(tau[None, :], nu[None, :], attitude[None, :], air[None, :])[0]
    if n == 3:
        return np.concatenate([frame @ nu, nu_dot])
    turning = np.empty(3)
    angle_rate(attitude, nu[3], nu[4], nu[5], turning)
    return np.concatenate([frame @ nu[:3], turning, nu_dot])


def check_against_differences(
    vessel: Vessel, nu: np.ndarray, attitude: np.ndarray, wind: np.ndarray
) -> None:
    n = len(vessel.dofs)
    tau = operating_force(vessel, nu, attitude, wind)
    pose = np.array([3.0, -2.0, 1.0, *attitude]) if n == 6 else np.array([3.0, -2.0, attitude[2]])
    state = np.concatenate([pose, nu])
    np.testing.assert_allclose(rates(vessel, state, tau, wind)[n:], 0.0, atol=1e-9)
    h, model = 1e-6, linearise(vessel, nu, attitude, wind)
    for j, step in enumerate(h * np.eye(2 * n)):
        up, down = (rates(vessel, state + sign * step, tau, wind) for sign in (1.0, -1.0))
        np.testing.assert_allclose(model.A[:, j], (up - down) / (2.0 * h), rtol=1e-6, atol=1e-7)
    for j, step in enumerate(np.eye(n)):
        difference = rates(vessel, state, tau + step, wind) - rates(vessel, state, tau, wind)
        np.testing.assert_allclose(model.B[:, j], difference, rtol=1e-6, atol=1e-12)


def away_from_zero(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high) | st.floats(-high, -low)


@given(
    arrays(np.float64, 3, elements=away_from_zero(0.05, 2.0)),
    st.floats(-3.0, 3.0),
    arrays(np.float64, 2, elements=away_from_zero(4.0, 9.0)),
)
def test_the_matrices_are_the_finite_differences_of_the_equations_of_motion(
    milliampere: Vessel, nu: np.ndarray, psi: float, wind: np.ndarray
) -> None:
    vessel = milliampere + derivative_table("wind", PLANAR, WINDAGE)
    vessel = vessel + Vessel(
        "drift", PLANAR, basis.terms(["cos(psi)", "|r|sin(psi)"]), np.full((2, 3), 50.0)
    )
    check_against_differences(vessel, nu, np.array([0.0, 0.0, psi]), wind)


@settings(max_examples=30)
@given(
    arrays(np.float64, 6, elements=away_from_zero(0.05, 2.0)),
    arrays(np.float64, 3, elements=away_from_zero(0.05, 1.2)),
    arrays(np.float64, 2, elements=away_from_zero(4.0, 9.0)),
)
def test_six_degrees_of_freedom_turn_by_three_angles(
    nu: np.ndarray, attitude: np.ndarray, wind: np.ndarray
) -> None:
    inertia = np.diag([60.0, 75.0, 90.0, 2.0, 3.0, 3.5])
    derivatives = {"X_|u|u": -2.0, "Y_v": -28.0, "Z_|w|w": -6.0, "K_p": -4.0, "M_q": -5.0}
    vessel = from_derivatives("hull", notation.DOFS, inertia, derivatives | {"N_|r|r": -2.0})
    vessel = vessel + derivative_table("wind", notation.DOFS, WINDAGE | {"K_|v_q|v_q": 3.0})
    terms = basis.terms(["sin(theta)", "cos(theta)sin(phi)", "cos(theta)cos(phi)", "cos(psi)"])
    restoring = np.random.default_rng(0).standard_normal((4, 6)) * 8.0
    vessel = vessel + Vessel("restoring", notation.DOFS, terms, restoring)
    check_against_differences(vessel, nu, attitude, wind)


@settings(max_examples=30)
@given(arrays(np.float64, N_VARIABLES, elements=away_from_zero(0.1, 2.0)))
def test_the_gradient_of_every_term_is_its_finite_difference(x: np.ndarray) -> None:
    terms = basis.full_basis(PLANAR) + basis.terms(["cos(psi)", "|u_dot|rsin(psi)", "V_qu_q"])
    slopes, h = gradient(basis.codes(terms), x), 1e-6
    for j in range(1, N_VARIABLES):
        step = h * np.eye(N_VARIABLES)[j]
        up, down = (basis.evaluate(terms, (x + s * step)[None, :])[0] for s in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, j], (up - down) / (2.0 * h), rtol=1e-6, atol=1e-8)


def test_a_vessel_at_rest_keeps_only_its_linear_damping(milliampere: Vessel) -> None:
    model = linearise(milliampere)
    linear = np.array([milliampere.row(name) for name in ("u", "v", "r")]).T
    expected = -np.linalg.solve(milliampere.inertia, linear)
    np.testing.assert_allclose(model.A[3:, 3:], expected, rtol=1e-12)
    np.testing.assert_array_equal(model.A[:3], np.eye(3, 6, 3))
    assert model.outputs == ("x", "y", "psi")
    assert model.controllable_order == model.observable_order == 6
    assert not model.stable  # the pose integrates


def test_a_single_axis_needs_no_heading() -> None:
    vessel = Vessel("hull", ("surge",), basis.terms(["u_dot", "u", "|u|u"]), [[60.0], [20.0], [2]])
    model = linearise(vessel, np.array([-1.5]))
    np.testing.assert_allclose(model.A, [[0.0, 1.0], [0.0, -(20.0 + 2.0 * 2.0 * 1.5) / 60.0]])
