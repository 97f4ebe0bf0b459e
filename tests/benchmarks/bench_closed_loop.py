"""The closed loop, one step and one right-hand side; two to four minutes, most of it the loop's.

The 24 minutes without a compiler take some 15 s a turn.
"""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from seatrial.models.compiled import kernel
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.dynamics import Scratch, advance, rates, scratch
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.plant_table import PlantTable
from seatrial.models.vessel.pose import kinematics_of, state_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import LagTable, no_lag
from seatrial.models.weather.weather import Weather
from tests.benchmarks.supply_vessel import SupplyVessel, as_table
from tests.benchmarks.uncompiled import closed_loop, interpreter
from tests.trials import composed

VESSELS = (
    "surge_linear", "surge_nonlinear", "supply_vessel", "modulus_ship", "milliampere",
    "beluga_linear", "beluga_diagonal", "beluga_full",
)  # fmt: skip
EVALUATIONS, REPETITIONS = 100_000, 7
STEPS, STEP_S = 1000, 0.1
WIND = np.array([6.0, -4.0])
FORCE = np.array([1.5e5, 4.0e4, 2.0e6])


def test_closed_loop(in_turn: Any) -> None:
    ours = closed_loop()
    with interpreter() as peer:
        for mine, other in zip(ours(), peer(), strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-9)
        in_turn(
            ours, peer, item="1a", what="closed loop of the milliAmpere, 24 minutes", warm=False,
            name="compiled", peer_name="compiler disabled", wanted=100.0, rounds=3, calls=10,
            note="14,400 instants, 57,600 steps; the interpreter walks the loops over terms, too, "
            "where a user would write NumPy, as the rows on one step do",
        )  # fmt: skip


def full_basis_ferry() -> Vessel:
    """The milliAmpere with a coefficient for each of the 31 terms of the residual's basis."""
    nominal = composed("vessel=milliampere").vessel.nominal()
    names = basis.full_basis(PLANAR)
    small = np.where([one.name.endswith("_dot") for one in names], 0.0, 0.1)
    model: Vessel = nominal + Vessel("residual", PLANAR, names, np.tile(small[:, None], 3))
    return model


@kernel
def _steps(
    count: int, kinematics: Any, plant: PlantTable, lag: LagTable, thrust: Array, tau: Array,
    eta: Array, nu: Array, weather: Weather, work: Scratch, euler: bool,
) -> None:  # fmt: skip
    for _ in range(count):
        advance(
            kinematics, plant, lag, thrust, tau, eta, nu, weather, 0, STEP_S, 1, work, euler
        )  # fmt: skip


def compiled_steps(model: Vessel, tau: Array, euler: bool) -> Callable[[], Array]:
    """Takes STEPS steps from rest, in wind; gives pose and velocity."""
    kinematics, table = kinematics_of(PLANAR), model.plant_table()
    calm = Weather(*(np.zeros((1, 3)) for _ in range(4)))
    weather, work = calm._replace(wind_ned=WIND[None]), scratch(len(table.codes), 3, 3)

    def taken() -> Array:
        eta, nu, thrust = np.zeros(3), np.zeros(3), np.zeros((3, 2))
        lag = no_lag(len(thrust))
        _steps(STEPS, kinematics, table, lag, thrust, tau, eta, nu, weather, work, euler)
        return np.concatenate([eta, nu])

    return taken


def numpy_steps() -> Callable[[], Array]:
    """The same of the plain supply vessel, by Euler."""
    vessel = SupplyVessel()

    def taken() -> Array:
        eta, nu = np.zeros(3), np.zeros(3)
        for _ in range(STEPS):
            vessel.step(eta, nu, FORCE, WIND, STEP_S)
        return np.concatenate([eta, nu])

    return taken


def test_the_same_vessel_step_by_step(in_turn: Any) -> None:
    ours, peer = compiled_steps(as_table(), FORCE, euler=True), numpy_steps()
    assert np.all(np.abs(ours()) > 1e-4)
    np.testing.assert_allclose(ours(), peer(), rtol=1e-9)
    in_turn(
        ours, peer, item="1b", what="1,000 Euler steps of a supply vessel in wind",
        name="compiled table", peer_name="plain NumPy", calls=200,
        note="the same vessel, wind and step: M, C(nu), D(nu) and the wind's force",
    )  # fmt: skip


def test_runge_kutta_beside_euler(in_turn: Any) -> None:
    model = full_basis_ferry()
    assert len(model.plant_table().codes) == 28
    ours = compiled_steps(model, np.array([100.0, 30.0, 20.0]), euler=False)
    assert np.all(np.isfinite(ours()))
    in_turn(
        ours, numpy_steps(), item="1c", what="1,000 steps of a vessel in three degrees of freedom",
        name="28 terms, RK4", peer_name="plain NumPy supply vessel, Euler", wanted=30.0, calls=50,
        note="ours evaluates its right-hand side four times a step, the other once",
        why="the figure depends on the processor",
    )  # fmt: skip


@kernel
def _evaluate(
    count: int, kinematics: Any, plant: PlantTable, eta: Array, nu: Array, tau: Array,
    weather: Weather, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> float:  # fmt: skip
    """Evaluations that feed each result back, so that none can be left out."""
    for _ in range(count):
        rates(kinematics, plant, eta, nu, tau, weather, 0, work, eta_dot, nu_dot)
        nu[0] += 1e-12 * nu_dot[0]
    return nu[0]


def right_hand_side(name: str) -> dict[str, Any]:
    """How many terms a vessel has, and the median time of one evaluation."""
    vessel = composed(f"vessel={name}", "excitation=prbs").vessel
    n, table = len(vessel.dofs), vessel.nominal().plant_table()
    kinematics = kinematics_of(vessel.dofs, vessel.attitude)
    eta = state_of(kinematics, np.linspace(0.1, 0.3, n))
    weather = Weather(*(np.zeros((1, n)) for _ in range(4)))
    work = scratch(len(table.codes), n, len(eta))
    rest = (eta, np.linspace(0.5, 0.1, n), np.ones(n), weather, work, np.zeros_like(eta))
    times = []
    for _ in range(REPETITIONS + 1):  # the first one compiles
        begun = perf_counter()
        _evaluate(EVALUATIONS, kinematics, table, *rest, np.zeros(n))
        times.append(perf_counter() - begun)
    each = 1e9 * float(np.median(times[1:])) / EVALUATIONS
    return {"shown": f"{each:.0f} ns, {len(table.codes)} terms in {n} degrees of freedom"}


def test_right_hand_sides(stated: Any) -> None:
    stated(
        lambda: {name: right_hand_side(name) for name in VESSELS},
        item="1d", what="one right-hand side",
        note="median of 7 loops over 100,000 evaluations",
    )  # fmt: skip
