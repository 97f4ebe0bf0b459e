"""The equation of motion of a vessel as a CasADi function, from its expressions.

Coefficients are an argument, so that one function holds for all tables of the same terms.
"""

import logging
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.symbolic_rates import n_acting, symbolic_rates
from seatrial.models.symbols import ENTRY, entries, evaluate
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.plant_table import PlantTable
from seatrial.models.vessel.pose import Kinematics, Quaternion

if TYPE_CHECKING:
    ca: Any
else:
    import lazy_loader

    ca = lazy_loader.load("casadi")  # an extra

log = logging.getLogger(__name__)
ARGUMENTS = "eta", "nu", "acting", "force", "wind", "current", "coefficients"
SPELLED = {
    "add": "plus", "subtract": "minus", "multiply": "times", "divide": "rdivide",
    "absolute": "fabs", "minimum": "fmin", "maximum": "fmax", "less": "lt", "less_equal": "le",
    "greater": "gt", "greater_equal": "ge", "where": "if_else", "arctan2": "atan2",
}  # fmt: skip
SMALLEST = 1e-24  # under a square root, whose derivative is then finite at rest


@lru_cache
def solver_of(wanted: str) -> str:
    """The solver by its name; ipopt where this build of CasADi lacks it, which is logged once.

    Raises ConfigurationError if CasADi is not installed.
    """
    try:
        known = ca.has_nlpsol(wanted)
    except ModuleNotFoundError as error:
        raise ConfigurationError("casadi is not installed: pip install 'seatrial[nmpc]'") from error
    if not known:
        log.warning("this build of CasADi lacks %s: ipopt solves the problems of nmpc", wanted)
    return wanted if known else "ipopt"


def coefficients(plant: PlantTable) -> Array:
    """The numbers of a table: its entries, those of M^-1 that can be non-zero, its devices'."""
    inverse = plant.inverse_inertia[np.asarray(plant.coupled)]
    return np.concatenate([plant.entries, inverse, plant.parameters])


def rates_function(kinematics: Kinematics, plant: PlantTable, rounding: float = 0.0) -> Any:
    """The function (eta, nu, acting, force, wind, current, coefficients) -> (eta_dot, nu_dot).

    Arguments are those of `symbolic_rates`; `coefficients` are those of any table of the same
    structure. With a `rounding` e, |x| is sqrt(x^2 + e^2), which has derivatives for an optimiser.
    """
    n = len(plant.velocity_index)
    n_pose = n + isinstance(kinematics, Quaternion)
    numbers = entries("coefficients", len(coefficients(plant)))
    of_table, of_devices = len(plant.entries), len(numbers) - len(plant.parameters)
    inverse = np.zeros((n, n), dtype=object)
    inverse[np.asarray(plant.coupled)] = numbers[of_table:of_devices]
    symbolic = plant._replace(
        entries=numbers[:of_table], inverse_inertia=inverse, parameters=numbers[of_devices:]
    )
    sizes = n_pose, n, n_acting(plant), n, 2, 2, len(numbers)
    given = {name: ca.SX.sym(name, size) for name, size in zip(ARGUMENTS, sizes, strict=True)}

    def apply(operation: str, operands: Any, uses: int) -> Any:
        if operation == ENTRY:
            name, index = operands
            return given[name][index]
        if operation == "negative":
            return -operands[0]
        if operation == "absolute" and rounding:
            return ca.sqrt(operands[0] ** 2 + rounding**2)
        if operation == "sqrt":
            return ca.sqrt(operands[0] + SMALLEST)
        return getattr(ca, SPELLED.get(operation, operation))(*operands)

    outputs = [
        ca.vertcat(*evaluate(list(rates), apply))
        for rates in symbolic_rates(kinematics, symbolic, disturbed=True)
    ]
    return ca.Function("rates", [*given.values()], outputs, [*ARGUMENTS], ["eta_dot", "nu_dot"])
