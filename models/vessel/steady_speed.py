"""The speed at which a vessel with inputs moves straight ahead."""

import numpy as np
from scipy.optimize import brentq

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

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
    return float(brentq(lambda u: acceleration(np.array([u]))[0], low, high, xtol=1e-12))
