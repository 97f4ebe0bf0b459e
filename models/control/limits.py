"""Whether the limits can hold the vessel against the weather at all."""

import numpy as np

from models.basis import Array
from models.kinematics import in_body
from models.vessel import PLANAR, Vessel
from models.weather import Weather

HEADINGS = 72  # tried where the heading is not known in advance


def largest_disturbance(plant: Vessel, weather: Weather, heading: Array) -> Array:
    """The largest force that standing still in the weather needs [N, Nm], shape (n_dof,).

    `heading` (N,) [rad] is the one that will be sailed, where it is known in advance; else, with
    no rows, the worst of all headings counts. Noise and waves are not held against.
    """
    n = len(weather.force_ned)
    if plant.dofs == PLANAR and len(heading) < n:
        turns = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
        worst = [largest_disturbance(plant, weather, np.full(n, psi)) for psi in turns]
        return np.asarray(np.max(worst, axis=0))
    psi = heading[:n] if plant.dofs == PLANAR else np.zeros(n)
    current, wind = _whole(weather.current_ned, n), _whole(weather.wind_ned, n)
    through, air = in_body(current, psi), in_body(wind, psi)
    nu, attitude = np.zeros((n, len(plant.dofs))), np.zeros((n, 3))
    attitude[:, 2] = psi
    for column, dof in enumerate(("surge", "sway")):
        if dof in plant.dofs:
            nu[:, plant.dofs.index(dof)] = -through[:, column]
    # The table's air velocity is nu - wind with the nu it is given: that through the water.
    force = plant.inverse(np.zeros_like(nu), nu, attitude, air - through)
    given = weather.force_ned.copy()
    if plant.dofs == PLANAR:
        given[:, :2] = in_body(given[:, :2], psi)
    return np.asarray(np.max(np.abs(force - given), axis=0))


def _whole(values: Array, n: int) -> Array:
    return values if len(values) else np.zeros((n, 2))
