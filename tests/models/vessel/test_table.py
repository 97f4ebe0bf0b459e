"""Vessels as coefficient tables: derivatives, addition, inverse and forward dynamics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.vessel import basis
from seatrial.models.vessel.derivatives import coriolis, from_derivatives
from seatrial.models.vessel.table import Vessel, coefficient_unit

finite = st.floats(-10.0, 10.0)
motions = arrays(np.float64, (6, 3), elements=st.floats(-2.0, 2.0))

M = np.array([[2389.657, 0.0, 0.0], [0.0, 2533.911, 62.386], [0.0, 28.141, 5068.910]])


def printed_force(nu_dot: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """M nu_dot + C(nu) nu + D(nu) nu, written out from Jervan (2020), (2.4)-(2.6) and Table A.1."""
    u, v, r = nu
    c13, c23 = -M[0, 1] * u - M[1, 1] * v - M[1, 2] * r, M[0, 0] * u
    coriolis_matrix = np.array([[0, 0, c13], [0, 0, c23], [-c13, -c23, 0]])
    d11 = 27.632 + 110.064 * abs(u) + 13.965 * u**2
    d22 = 52.947 + 116.486 * abs(v) + 1540.383 * abs(r) + 24.313 * v**2
    d23 = -24.732 - 572.141 * abs(v) + 115.457 * abs(r)
    d32 = -3.524 + 0.832 * abs(v) - 336.827 * abs(r)
    d33 = 122.860 + 121.957 * abs(v) + 874.428 * abs(r) - 0.0 * r**2
    damping = np.array([[d11, 0, 0], [0, d22, d23], [0, d32, d33]])
    return np.asarray(M @ nu_dot + coriolis_matrix @ nu + damping @ nu)


@given(motions, motions)
def test_table_a1_through_derivatives_equals_the_written_matrices(
    milliampere: Vessel, nu_dot: np.ndarray, nu: np.ndarray
) -> None:
    expected = [printed_force(a, v) for a, v in zip(nu_dot, nu, strict=True)]
    np.testing.assert_allclose(milliampere.inverse(nu_dot, nu), expected, atol=1e-8, rtol=1e-12)


@given(arrays(np.float64, (6, 6), elements=finite), arrays(np.float64, 6, elements=finite))
def test_coriolis_does_no_work(inertia: np.ndarray, nu: np.ndarray) -> None:
    """In the plane and in six degrees of freedom."""
    for dofs in (PLANAR, DOFS):
        n = len(dofs)
        table = coriolis(inertia[:n, :n], dofs)
        force = table.inverse(np.zeros((1, n)), nu[None, :n])[0]
        assert abs(nu[:n] @ force) <= 1e-9 * (1.0 + np.abs(force).max() * np.abs(nu).max())


@given(motions, motions)
def test_forward_dynamics_undoes_inverse_dynamics(
    milliampere: Vessel, nu_dot: np.ndarray, nu: np.ndarray
) -> None:
    tau = milliampere.inverse(nu_dot, nu)
    np.testing.assert_allclose(milliampere.forward(tau, nu), nu_dot, atol=1e-9)


@given(motions, motions, st.floats(-3.0, 3.0))
def test_tables_add_and_scale_as_their_forces_do(
    milliampere: Vessel, nu_dot: np.ndarray, nu: np.ndarray, factor: float
) -> None:
    rng = np.random.default_rng(0)
    full = basis.full_basis(PLANAR)
    other = Vessel("residual", PLANAR, full, rng.normal(size=(len(full), 3)))
    force = milliampere.inverse(nu_dot, nu) + factor * other.inverse(nu_dot, nu)
    total = milliampere + factor * other
    np.testing.assert_allclose(total.inverse(nu_dot, nu), force, atol=1e-7, rtol=1e-10)
    back = total - factor * other
    np.testing.assert_allclose(back.on(milliampere.terms).theta, milliampere.theta, atol=1e-9)


@pytest.mark.parametrize(
    ("term", "dof", "unit"),
    [
        ("r_dot", "sway", "kg m"),
        ("u", "surge", "kg/s"),
        ("u^3", "surge", "kg s/m^2"),
        ("|r|r", "yaw", "kg m^2"),
        ("cos(psi)", "sway", "N"),
        ("1", "yaw", "Nm"),
    ],
)
def test_coefficient_units(term: str, dof: str, unit: str) -> None:
    assert coefficient_unit(basis.term(term), dof) == unit


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Q_u", "expected a name"), ("X", "expected a name"), ("X_abc", "expected"),
        ("Z_w", "heave"), ("X_q", "derivatives.X_q: got q, expected the motion in surge, sway"),
        ("Y_|w|v", "got w"), ("N_qdot", "got q_dot"), ("Y_phi", "got phi"),
    ],
)  # fmt: skip
def test_wrong_derivatives_are_refused(name: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        from_derivatives("ship", PLANAR, M, {name: 1.0})


def test_an_inertia_that_is_not_positive_is_refused(milliampere: Vessel) -> None:
    with pytest.raises(ConfigurationError, match="positive definite"):
        (-1.0 * milliampere).plant_table()


def test_a_product_of_accelerations_cannot_be_sailed(milliampere: Vessel) -> None:
    odd = Vessel("odd", PLANAR, basis.terms(["u_dotv"]), np.ones((1, 3)))
    with pytest.raises(ConfigurationError, match="cannot be solved"):
        (milliampere + odd).plant_table()
