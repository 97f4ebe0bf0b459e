"""The speed at which a vessel with inputs moves straight ahead."""

import numpy as np
from scipy.optimize import brentq

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

SPEEDS = 200  # at which a change of sign is looked for


def steady_speed(vessel: Vessel, inputs: Array, highest_m_s: float) -> float:
    """Surge velocity [m/s] without surge acceleration under constant inputs (n_inputs,).

    Raises ConfigurationError if the vessel does not reach a steady speed below `highest_m_s`.
    """
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
        raise ConfigurationError(
            f"speed_m_s: {vessel.name} has no steady speed below {highest_m_s:g} m/s at the start "
            "of its inputs, expected a number"
        )
    low, high = speeds[falls[-1]], speeds[falls[-1] + 1]
    return float(brentq(lambda u: acceleration(np.array([u]))[0], low, high, xtol=1e-12))
