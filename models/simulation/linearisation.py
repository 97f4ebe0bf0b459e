"""Linearisation of any vessel about an operating point, from the derivatives of its terms.

The state is (eta, nu), the input tau. With eta_dot = J(eta) nu and M nu_dot = tau - F(nu, eta),

    A = [ d(J nu)/d eta      J        ]      B = [  0   ]      C = [I 0]
        [ -M^-1 dF/d eta  -M^-1 dF/d nu ]        [ M^-1 ]

for deviations from (eta_0, nu_0, tau_0 = F(nu_0, eta_0)). Bargouth (2022), section 3.2, derives
this for one vessel. Here F is a sum of products of factors x and |x|, so its derivative is a sum
of products as well.
"""

import numpy as np

from seatrial.models import notation
from seatrial.models.notation import DOFS, PLANAR, POSES, poses_of
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import INDEX, N_VARIABLES, Array, Codes
from seatrial.models.vessel.kinematics import cross_matrix, frame_of_angles, pose_jacobian
from seatrial.models.vessel.table import Vessel


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
    """Force tau_0 = F(0, nu_0, attitude_0) that maintains the velocity [N, Nm], shape (n_dof,)."""
    air = _air(vessel.dofs, attitude, wind_ned)
    still = np.zeros((1, len(nu)))
    return np.asarray(vessel.inverse(still, nu[None, :], attitude[None, :], air)[0])


def linearise(
    vessel: Vessel,
    nu: Array | None = None,
    attitude: Array | None = None,
    wind_ned: Array | None = None,
) -> StateSpace:
    """The continuous model of deviations from a steady motion; state (eta, nu), output eta.

    In surge, sway and yaw eta_dot = R(psi) nu; in six degrees of freedom eta contains
    (phi, theta, psi); for other axes eta_dot = nu, as in the simulation.

    Args:
        vessel: the nonlinear model.
        nu: velocity at the operating point [m/s, rad/s], shape (n_dof,); None means rest.
        attitude: (phi, theta, psi) [rad], shape (3,); None means level and north.
        wind_ned: velocity of the air (north, east) [m/s], shape (2,); None means still air.

    Returns:
        The continuous-time model with input tau [N, Nm].

    Raises:
        ConfigurationError: the equation of motion cannot be solved for the accelerations.
    """
    n = len(vessel.dofs)
    nu = np.zeros(n) if nu is None else np.asarray(nu, dtype=np.float64)
    attitude = np.zeros(3) if attitude is None else np.asarray(attitude, dtype=np.float64)
    wind = np.zeros(2) if wind_ned is None else np.asarray(wind_ned, dtype=np.float64)
    plant = vessel.plant_table()
    air = _air(vessel.dofs, attitude, wind)
    x = vessel.variables(np.zeros((1, n)), nu[None, :], attitude[None, :], air)[0]
    table = vessel.force_table()
    by_variable = table.theta.T @ gradient(table.codes, x)
    by_state = _variables_by_state(vessel.dofs, x, attitude, wind)
    return StateSpace(
        A=np.vstack(
            [
                _kinematics(vessel.dofs, nu, attitude),
                -plant.inverse_inertia @ by_variable @ by_state,
            ]
        ),
        B=np.vstack([np.zeros((n, n)), plant.inverse_inertia]),
        C=np.eye(n, 2 * n),
        D=np.zeros((n, n)),
        period_s=None,
        inputs=tuple(f"tau_{dof}" for dof in vessel.dofs),
        outputs=poses_of(vessel.dofs),
    )


def _variables_by_state(dofs: tuple[str, ...], x: Array, attitude: Array, wind: Array) -> Array:
    """dx / d(eta, nu), shape (N_VARIABLES, 2 n_dof), for all variables but accelerations."""
    n = len(dofs)
    slope = np.zeros((N_VARIABLES, 2 * n))
    for column, dof in enumerate(dofs):
        slope[INDEX[notation.VELOCITIES[DOFS.index(dof)]], n + column] = 1.0
    u_q, v_q, V_q = INDEX["u_q"], INDEX["v_q"], INDEX["V_q"]  # nu_q = nu - R' wind
    slope[u_q], slope[v_q] = slope[INDEX["u"]], slope[INDEX["v"]]
    frames = _frame_slopes(dofs, attitude)
    for column, dof in enumerate(dofs):
        if dof in DOFS[3:]:
            angle = DOFS.index(dof) - 3
            name = POSES[DOFS.index(dof)]
            cosine, sine = INDEX[f"cos({name})"], INDEX[f"sin({name})"]
            slope[cosine, column], slope[sine, column] = -x[sine], x[cosine]
            slope[[u_q, v_q], column] -= wind @ frames[angle][:2, :2]
    if x[V_q] > 0.0:
        slope[V_q] = (x[u_q] * slope[u_q] + x[v_q] * slope[v_q]) / x[V_q]
    return slope


def _air(dofs: tuple[str, ...], attitude: Array, wind_ned: Array) -> Array:
    """The wind in body axes [m/s], shape (1, 2)."""
    return np.asarray(wind_ned @ _frame(dofs, attitude)[:2, :2])[None, :]


def _frame(dofs: tuple[str, ...], attitude: Array) -> Array:
    """Rotation from body to NED, shape (3, 3), by the angles among the degrees of freedom."""
    frame = np.eye(3)
    if dofs in (PLANAR, DOFS):
        frame_of_angles(attitude if dofs == DOFS else attitude * [0.0, 0.0, 1.0], frame)
    return frame


def _frame_slopes(dofs: tuple[str, ...], attitude: Array) -> tuple[Array, Array, Array]:
    """dR / d(phi, theta, psi) of R = R_z R_y R_x, shape (3, 3) each."""
    if dofs not in (PLANAR, DOFS):
        return np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    frame, roll = _frame(dofs, attitude), np.eye(3)
    frame_of_angles(attitude * [float(dofs == DOFS), 0.0, 0.0], roll)
    x, y, z = (cross_matrix(axis) for axis in np.eye(3))
    return frame @ x, frame @ roll.T @ y @ roll, z @ frame


def _kinematics(dofs: tuple[str, ...], nu: Array, attitude: Array) -> Array:
    """d(J nu) / d(eta, nu), shape (n_dof, 2 n_dof)."""
    n = len(dofs)
    turning, jacobian = np.zeros((n, n)), np.eye(n)
    if dofs == PLANAR:
        jacobian = _frame(dofs, attitude)
        turning[:2, 2] = (_frame_slopes(dofs, attitude)[2] @ nu)[:2]
    elif dofs == DOFS:
        jacobian = pose_jacobian(attitude[None])[0]
        by_roll, by_pitch = _angle_rate_slopes(attitude)
        turning[:3, 3:] = np.column_stack([s @ nu[:3] for s in _frame_slopes(dofs, attitude)])
        turning[3:, 3], turning[3:, 4] = by_roll @ nu[3:], by_pitch @ nu[3:]
    return np.hstack([turning, jacobian])


def _angle_rate_slopes(attitude: Array) -> tuple[Array, Array]:
    """Derivatives by phi and theta of T, (phi, theta, psi)_dot = T omega, shape (3, 3) each."""
    (c, cy, _), (s, sy, _) = np.cos(attitude), np.sin(attitude)
    t, k = sy / cy, 1.0 / cy
    by_roll = np.array([[0.0, c * t, -s * t], [0.0, -s, -c], [0.0, c * k, -s * k]])
    by_pitch = np.array([[0.0, s * k * k, c * k * k], [0.0] * 3, [0.0, s * t * k, c * t * k]])
    return by_roll, by_pitch
