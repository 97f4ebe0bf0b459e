"""The equation of motion of a vessel as expressions, from the functions behind the kernels."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.models.simulation.dynamics import rates, scratch
from seatrial.models.symbols import entries, in_symbols
from seatrial.models.vessel.plant_table import PlantTable
from seatrial.models.vessel.pose import Kinematics, Quaternion
from seatrial.models.weather.weather import Weather

Symbols = NDArray[Any]  # of `Symbol`s and numbers
NONE = np.zeros((0, 0))


def symbolic_rates(
    kinematics: Kinematics, plant: PlantTable, disturbed: bool = False
) -> tuple[Symbols, Symbols]:
    """eta_dot (n_pose,) and nu_dot (n_dof,) as expressions, see `dynamics.rates`.

    Their arguments are `eta` (n_pose,), `nu` (n_dof,), `acting`, the forces (n_dof,) or inputs
    (n_inputs,), and `wind` and `current`, the velocities of air and water to north and east [m/s];
    if `disturbed` also `force`, a force in NED (n_dof,). Coefficients in `plant` can be symbols as
    well, `entries("coefficients", n)`.

    Raises ConfigurationError if a device has an operation without an expression.
    """
    n = len(plant.velocity_index)
    n_pose = n + isinstance(kinematics, Quaternion)
    eta, nu, acting = entries("eta", n_pose), entries("nu", n), entries("acting", n_acting(plant))
    weather = Weather(
        NONE, NONE, NONE, entries("force", n)[None] if disturbed else NONE,
        current_ned=entries("current", 2)[None], wind_ned=entries("wind", 2)[None],
    )  # fmt: skip
    zeros = partial(np.full, fill_value=0.0, dtype=object)
    work = scratch(len(plant.codes), n, n_pose, zeros)
    in_symbols(rates)(
        kinematics, plant, eta, nu, acting, weather, 0, work, work.eta_dot, work.nu_dot
    )
    return work.eta_dot, work.nu_dot


def n_acting(plant: PlantTable) -> int:
    """Number of inputs, or of forces if these are commanded."""
    return len(plant.inputs) or len(plant.velocity_index)
