"""Linearisation of any vessel about an operating point, from the derivatives of its terms.

The state is (eta, nu), the input tau. With eta_dot = J(eta) nu and M nu_dot = tau - F(nu, eta),

    A = [ d(J nu)/d eta      J        ]      B = [  0   ]      C = [I 0]
        [ -M^-1 dF/d eta  -M^-1 dF/d nu ]        [ M^-1 ]

for deviations from (eta_0, nu_0, tau_0 = F(nu_0, eta_0)). Bargouth (2022), section 3.2, does it
by hand for one vessel; here F is a sum of products of factors x and |x|, whose derivative is a
sum of products again.
"""

import numpy as np

from models import basis
from models.basis import DOFS, INDEX, N_VARIABLES, Array, Codes
from models.kinematics import in_body, rotation
from models.statespace import StateSpace
from models.vessel import PLANAR, Vessel, poses_of


def gradient(codes: Codes, x: Array) -> Array:
    """d phi_k / d x_j, shape (n_terms, N_VARIABLES), at the variables x, shape (N_VARIABLES,).

    The derivative of |x| is sign(x), and 0 at 0: the mean of its one-sided derivatives.
    """
    z = basis.magnify(x)
    slope = np.concatenate([np.ones(N_VARIABLES), np.sign(x)])
    derivative = np.zeros((len(codes), N_VARIABLES))
    for k, factors in enumerate(codes):
        for i, code in enumerate(factors):
            others = np.prod(z[np.delete(factors, i)])
            derivative[k, code % N_VARIABLES] += slope[code] * others
    derivative[:, 0] = 0.0  # the constant
    return derivative


def operating_force(vessel: Vessel, nu: Array, attitude: Array, wind_ned: Array) -> Array:
    """tau_0 = F(0, nu_0, attitude_0) that keeps the velocity [N, Nm], shape (n_dof,)."""
    air = in_body(wind_ned[None, :], attitude[2:])
    still = np.zeros((1, len(nu)))
    return np.asarray(vessel.inverse(still, nu[None, :], attitude[None, :], air)[0])


def linearise(
    vessel: Vessel,
    nu: Array | None = None,
    attitude: Array | None = None,
    wind_ned: Array | None = None,
) -> StateSpace:
    """The continuous model of deviations from a steady motion; state (eta, nu), output eta.

    `nu` [m/s, rad/s], shape (n_dof,), `attitude` (phi, theta, psi) [rad], shape (3,), and
    `wind_ned` (north, east) [m/s], shape (2,), are the operating point, by default rest, level
    north, and still air. A vessel in surge, sway and yaw has eta_dot = R(psi) nu, any other
    eta_dot = nu, as in the simulation. Raises ConfigurationError when the vessel's inertia cannot
    be solved for the accelerations.
    """
    n = len(vessel.dofs)
    nu = np.zeros(n) if nu is None else np.asarray(nu, dtype=np.float64)
    attitude = np.zeros(3) if attitude is None else np.asarray(attitude, dtype=np.float64)
    wind = np.zeros(2) if wind_ned is None else np.asarray(wind_ned, dtype=np.float64)
    plant = vessel.plant_table()
    air = in_body(wind[None, :], attitude[2:])
    x = vessel.variables(np.zeros((1, n)), nu[None, :], attitude[None, :], air)[0]
    by_variable = plant.theta.T @ gradient(plant.codes, x)
    rates = -plant.inverse_inertia @ by_variable @ _variables_by_state(vessel.dofs, x, wind)
    return StateSpace(
        A=np.vstack([_kinematics(vessel, nu, attitude[2]), rates]),
        B=np.vstack([np.zeros((n, n)), plant.inverse_inertia]),
        C=np.eye(n, 2 * n),
        D=np.zeros((n, n)),
        period_s=None,
        inputs=tuple(f"tau_{dof}" for dof in vessel.dofs),
        outputs=poses_of(vessel.dofs),
    )


def _variables_by_state(dofs: tuple[str, ...], x: Array, wind: Array) -> Array:
    """dx / d(eta, nu), shape (N_VARIABLES, 2 n_dof), of the variables that are no accelerations."""
    n = len(dofs)
    slope = np.zeros((N_VARIABLES, 2 * n))
    for column, dof in enumerate(dofs):
        number = DOFS.index(dof)
        slope[INDEX[basis.VELOCITIES[number]], n + column] = 1.0
        if dof in DOFS[3:]:
            angle = ("phi", "theta", "psi")[number - 3]
            cosine, sine = INDEX[f"cos({angle})"], INDEX[f"sin({angle})"]
            slope[cosine, column], slope[sine, column] = -x[sine], x[cosine]
    u_q, v_q, V_q = INDEX["u_q"], INDEX["v_q"], INDEX["V_q"]
    cosine, sine = INDEX["cos(psi)"], INDEX["sin(psi)"]  # nu_q = nu - R(psi)' wind
    slope[u_q] = slope[INDEX["u"]] - wind[0] * slope[cosine] - wind[1] * slope[sine]
    slope[v_q] = slope[INDEX["v"]] + wind[0] * slope[sine] - wind[1] * slope[cosine]
    if x[V_q] > 0.0:
        slope[V_q] = (x[u_q] * slope[u_q] + x[v_q] * slope[v_q]) / x[V_q]
    return slope


def _kinematics(vessel: Vessel, nu: Array, psi: float) -> Array:
    """d(J nu) / d(eta, nu), shape (n_dof, 2 n_dof)."""
    n = len(vessel.dofs)
    if vessel.dofs != PLANAR:
        return np.eye(n, 2 * n, n)
    turning, jacobian = np.zeros((n, n)), rotation(psi)
    north, east, _ = jacobian @ nu
    turning[:2, 2] = -east, north  # d R(psi) nu / d psi
    return np.hstack([turning, jacobian])
