"""A supply vessel in surge, sway and yaw as one writes it in NumPy, and the same as a table.

    eta_dot = R(psi) nu,    M nu_dot + C(nu) nu + D(nu) nu = tau + tau_wind

Fossen (2011), chapters 6 to 8. Inertia and linear damping are those of the vessel `supply` of the
PythonVehicleSimulator (bis scaled, L = 76.2 m, m = 6000 t); the quadratic damping and the wind
areas are of its size.
"""

import numpy as np

from seatrial.models.notation import PLANAR
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import coriolis
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.wind import Windage

LENGTH, MASS, GRAVITY = 76.2, 6000.0e3, 9.81
SCALE = np.diag([1.0, 1.0, LENGTH])
INERTIA = MASS * SCALE @ [[1.1274, 0, 0], [0, 1.8902, -0.0744], [0, -0.0744, 0.1278]] @ SCALE
LINEAR = [[0.0358, 0, 0], [0, 0.1183, -0.0124], [0, -0.0041, 0.0308]]
LINEAR = MASS * np.sqrt(GRAVITY / LENGTH) * SCALE @ LINEAR @ SCALE
QUADRATIC = np.array([5.0e4, 2.2e5, 1.2e10])  # [N s^2/m^2, N s^2/m^2, Nm s^2]
WINDAGE = Windage(500.0, 1100.0, LENGTH, 0.6, 0.8, 0.1, 1.23)


class SupplyVessel:
    """The plain one: a few small matrices are made at every step."""

    def __init__(self) -> None:
        self.M, self.D = INERTIA.copy(), LINEAR.copy()
        self.inverse = np.linalg.inv(self.M)
        self.areas = WINDAGE.coefficients()

    def rotation(self, psi: float) -> Array:
        c, s = np.cos(psi), np.sin(psi)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def coriolis(self, nu: Array) -> Array:
        u, v, r = nu
        aside = self.M[1, 1] * v + self.M[1, 2] * r
        ahead = self.M[0, 0] * u
        return np.array([[0.0, 0.0, -aside], [0.0, 0.0, ahead], [aside, -ahead, 0.0]])

    def damping(self, nu: Array) -> Array:
        return self.D + np.diag(QUADRATIC * np.abs(nu))

    def wind(self, nu: Array, R: Array, wind_ned: Array) -> Array:
        u_q, v_q = nu[:2] - R[:2, :2].T @ wind_ned
        speed = np.hypot(u_q, v_q)
        d1, d2, d3 = self.areas
        return np.array([-d1 * speed * u_q, -d2 * speed * v_q, 2.0 * d3 * u_q * v_q])

    def step(self, eta: Array, nu: Array, tau: Array, wind_ned: Array, h: float) -> None:
        """Forward Euler, in place."""
        R = self.rotation(eta[2])
        forces = tau + self.wind(nu, R, wind_ned)
        forces = forces - self.coriolis(nu) @ nu - self.damping(nu) @ nu
        eta += h * (R @ nu)
        nu += h * (self.inverse @ forces)


def as_table() -> Vessel:
    """The same vessel as a coefficient table."""
    names = ["u_dot", "v_dot", "r_dot", "u", "v", "r", "|u|u", "|v|v", "|r|r"]
    theta = np.vstack([INERTIA.T, LINEAR.T, np.diag(QUADRATIC)])
    hull = Vessel("supply", PLANAR, basis.terms(names), theta)
    return hull + coriolis(INERTIA, PLANAR) + WINDAGE.table(PLANAR)
