"""How long one evaluation of a vessel's right-hand side takes.

    python tests/benchmarks/derivatives.py

nu_dot and eta_dot of each vessel, compiled, in a loop that feeds each result back, so that no
evaluation can be left out; best of several repetitions on one core. A figure to look at: no test
asserts a time.
"""

from time import perf_counter
from typing import Any

import numpy as np

from models.basis import Array
from models.compiled import kernel
from models.dynamics import Scratch, rates, scratch
from models.pose import kinematics_of, state_of
from models.vessel import PlantTable
from models.weather import Weather
from tests.trials import composed

VESSELS = (
    "beluga_full", "beluga_diagonal", "beluga_linear", "milliampere", "supply_vessel",
    "modulus_ship", "surge_nonlinear",
)  # fmt: skip
EVALUATIONS, REPETITIONS = 100_000, 7


@kernel
def _evaluate(
    count: int, kinematics: Any, plant: PlantTable, eta: Array, nu: Array, tau: Array,
    weather: Weather, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> float:  # fmt: skip
    for _ in range(count):
        rates(kinematics, plant, eta, nu, tau, weather, 0, work, eta_dot, nu_dot)
        nu[0] += 1e-12 * nu_dot[0]
    return nu[0]


def nanoseconds(name: str) -> tuple[int, float]:
    """Number of terms, and the time of one evaluation [ns]."""
    vessel = composed(f"vessel={name}", "excitation=prbs").vessel
    n = len(vessel.dofs)
    table = vessel.nominal().plant_table()
    kinematics = kinematics_of(vessel.dofs, vessel.attitude)
    eta = state_of(kinematics, np.linspace(0.1, 0.3, n))
    weather = Weather(*(np.zeros((1, n)) for _ in range(4))).sailed()
    work = scratch(len(table.codes), n, len(eta))
    rest = (eta, np.linspace(0.5, 0.1, n), np.ones(n), weather, work, np.zeros_like(eta))
    best = np.inf
    for _ in range(REPETITIONS + 1):  # the first one compiles
        begun = perf_counter()
        _evaluate(EVALUATIONS, kinematics, table, *rest, np.zeros(n))
        best = min(best, perf_counter() - begun)
    return len(table.codes), 1e9 * best / EVALUATIONS


if __name__ == "__main__":
    print(f"{'vessel':<20}{'terms':>8}{'ns':>10}")
    for name in VESSELS:
        terms, time = nanoseconds(name)
        print(f"{name:<20}{terms:>8}{time:>10.0f}")
