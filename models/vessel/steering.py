"""The steering of a vessel that moves ahead: its linearisation, the models of Nomoto,
and the speed at which its inputs hold it.

With sway and yaw coupled and the speed constant, x = (v, r) and x_dot = A x + b delta, the yaw rate
over the helm is, by Nomoto,

    r / delta = K (1 + T_3 s) / ((1 + T_1 s) (1 + T_2 s))  ~  K / (1 + T s),  T = T_1 + T_2 - T_3

K and T are negative for a ship that is straight-line unstable. Fossen (2021), section 7.2.
"""

from typing import NamedTuple

import numpy as np
import scipy

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

DIFFERENCE_STEP = (
    1e-6  # of a derivative, relative to the speed, to the speed over a length of 1 m, or to 1
)


class Nomoto(NamedTuple):
    """Gain [1/s] and time constant [s] of the first-order model."""

    gain: float
    time_s: float


class SteeringModel(NamedTuple):
    """x_dot = A x + B u of deviations from moving ahead; SI units, radians."""

    dofs: tuple[str, ...]
    A: Array  # (n_dof, n_dof) by the velocities
    B: Array  # (n_dof, n_inputs) by the inputs

    def nomoto(self, helm: int) -> Nomoto:
        """The first-order model of the yaw rate over an input.

        Raises ConfigurationError if the input does not turn the vessel.
        """
        rows = [self.dofs.index(dof) for dof in ("sway", "yaw") if dof in self.dofs]
        A, b = self.A[np.ix_(rows, rows)], self.B[rows, helm]
        if b[-1] == 0.0:
            raise ConfigurationError(f"helm: input {helm + 1} does not turn the vessel ahead")
        if len(rows) == 1:
            return Nomoto(float(-b[0] / A[0, 0]), float(-1.0 / A[0, 0]))
        numerator, determinant = A[1, 0] * b[0] - A[0, 0] * b[1], np.linalg.det(A)
        time = -np.trace(A) / determinant - b[1] / numerator
        return Nomoto(float(numerator / determinant), float(time))

    @property
    def signs(self) -> tuple[float, ...]:
        """Sign of the yaw acceleration by each input; 1 for one that does not turn the vessel."""
        by_input = self.B[self.dofs.index("yaw")]
        return tuple(np.where(by_input < 0.0, -1.0, 1.0).tolist())

    @property
    def nomotos(self) -> tuple[Nomoto, ...]:
        """The first-order models of all inputs; zeros for one that has none.

        It does not turn the vessel, or turns it without an end, as sway or yaw are undamped.
        """
        turning = np.abs(self.B[self.dofs.index("yaw")])
        turns = turning > 1e-9 * np.max(turning, initial=0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = [self.nomoto(i) if turns[i] else Nomoto(0.0, 0.0) for i in range(len(turns))]
        return tuple(each if np.all(np.isfinite(each)) else Nomoto(0.0, 0.0) for each in found)

    def surge(self, shaft: int) -> tuple[float, float]:
        """(a, b) of du/dt = a u + b n for the surge and an input."""
        i = self.dofs.index("surge")
        return float(self.A[i, i]), float(self.B[i, shaft])

    def along(self, direction: Array) -> "SteeringModel":
        """The model with one input, which changes all of them by a direction (n_inputs,)."""
        return self._replace(B=self.B @ direction[:, None])

    @property
    def differential(self) -> bool:
        """Whether two inputs drive it ahead together and turn it by their difference."""
        if self.B.shape[1] != 2 or not {"surge", "yaw"} <= {*self.dofs}:
            return False
        ahead, turning = (self.B[self.dofs.index(dof)] for dof in ("surge", "yaw"))
        return bool(np.min(ahead) > 0.0 and turning[0] * turning[1] < 0.0)


def steering_model(vessel: Vessel, speed_m_s: float, inputs: Array) -> SteeringModel:
    """Linearise the acceleration ahead at a speed under inputs (n_inputs,), by differences."""
    n, m = len(vessel.dofs), len(inputs)
    nu = np.zeros(n)
    if "surge" in vessel.dofs:  # of others the table is of one speed
        nu[vessel.dofs.index("surge")] = speed_m_s
    size = DIFFERENCE_STEP * np.concatenate([np.full(n, max(speed_m_s, 1e-3)), np.ones(m)])
    steps = np.diag(size)
    points = np.concatenate([steps, -steps])
    moved, commanded = nu + points[:, :n], inputs + points[:, n:]
    rate = vessel.forward(np.zeros_like(moved), moved, inputs=commanded)
    slope = ((rate[: n + m] - rate[n + m :]) / (2.0 * size[:, None])).T
    return SteeringModel(vessel.dofs, slope[:, :n], slope[:, n:])


SPEEDS = 200  # at which a change of sign is looked for
PER_MINUTE = 60.0


def steady_speed(vessel: Vessel, inputs: Array, highest_m_s: float) -> float:
    """Surge velocity [m/s] without surge acceleration under constant inputs (n_inputs,).

    Raises ConfigurationError if the vessel does not reach a steady speed below `highest_m_s`.
    """
    if not vessel.inputs:
        raise ConfigurationError(
            f"{vessel.name} is commanded by forces, expected a vessel with inputs"
        )
    speed = _steady(vessel, inputs, highest_m_s)
    if speed is not None:
        return speed
    shafts = np.array([name == "n" or name.startswith("n_") for name in vessel.inputs])
    slower = np.where(shafts, inputs / PER_MINUTE, inputs)
    hint = ""
    if np.any(slower != inputs) and _steady(vessel, slower, highest_m_s) is not None:
        hint = "; it has one with a sixtieth of n: is n in 1/min instead of 1/s?"
    raise ConfigurationError(
        f"speed_m_s: {vessel.name} has no steady speed below {highest_m_s:g} m/s at the start "
        f"of its inputs, expected a number{hint}"
    )


def _steady(vessel: Vessel, inputs: Array, highest_m_s: float) -> float | None:
    """The highest steady speed [m/s] below `highest_m_s`; None if there is none."""
    surge = vessel.dofs.index("surge")

    def acceleration(speeds: Array) -> Array:
        nu = np.zeros((len(speeds), len(vessel.dofs)))
        nu[:, surge] = speeds
        values = np.tile(inputs, (len(speeds), 1))
        return vessel.forward(np.zeros_like(nu), nu, inputs=values)[:, surge]

    speeds = np.linspace(1e-6, 1.0, SPEEDS) * highest_m_s
    signs = np.sign(acceleration(speeds))
    falls = np.flatnonzero((signs[:-1] > 0.0) & (signs[1:] <= 0.0))
    if not len(falls):
        return None
    low, high = speeds[falls[-1]], speeds[falls[-1] + 1]
    speed = scipy.optimize.brentq(lambda u: acceleration(np.array([u]))[0], low, high, xtol=1e-12)
    return float(speed)
