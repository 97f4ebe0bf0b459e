"""The CasADi function of a vessel has the values of its table and its devices."""

import numpy as np
import pytest

from docs.vessels import parameters_of, vessels
from seatrial.models.control.nmpc import coefficients, rates_function
from seatrial.models.simulation.dynamics import rates, scratch
from seatrial.models.symbols import in_symbols
from seatrial.models.vessel.pose import kinematics_of
from seatrial.models.weather.weather import Weather

pytest.importorskip("casadi", reason="casadi is not installed: pip install '.[nmpc]'")
STATES = 300
FEW = ("milliampere", "milliampere_azimuths")
OTHERS = tuple(name for name in vessels() if name not in FEW)


def relative_difference(name: str) -> float:
    """Largest difference of the two, over the largest value of each axis."""
    parameters, rng = parameters_of(name), np.random.default_rng(5)
    vessel = parameters.nominal()
    n, plant, kinematics = (
        len(vessel.dofs),
        vessel.plant_table(),
        kinematics_of(vessel.dofs, "euler"),
    )
    speed = 0.3 * np.array(parameters.velocity_limits or parameters.scales.velocity_limits)
    low, high = -vessel.inertia.diagonal(), vessel.inertia.diagonal()
    if vessel.inputs:
        low, high = np.array(parameters.input_low), np.array(parameters.input_high)
    none, simulated = np.zeros((0, 0)), in_symbols(rates)  # without machine code
    function, numbers = rates_function(kinematics, plant), coefficients(plant)
    found, expected = np.zeros((STATES, 2, n)), np.zeros((STATES, 2, n))
    for k in range(STATES):
        eta, nu = rng.uniform(-1.0, 1.0, n), speed * rng.normal(size=n)
        acting, force = rng.uniform(low, high), rng.normal(size=n) * vessel.inertia.diagonal()
        wind, current = rng.normal(size=2), 0.1 * rng.normal(size=2)
        weather = Weather(none, none, none, force[None], current[None], wind[None])
        work = scratch(len(plant.codes), n, n)
        simulated(kinematics, plant, eta, nu, acting, weather, 0, work, *expected[k])
        outputs = function(eta, nu, acting, force, wind, current, numbers)
        found[k] = [np.asarray(output).ravel() for output in outputs]
    scale = np.max(np.abs(expected), axis=0)
    return float(np.max(np.abs(found - expected) / np.maximum(scale, 1e-300)))


@pytest.mark.parametrize("names", [FEW, pytest.param(OTHERS, marks=pytest.mark.slow)])
def test_the_rates_are_those_of_the_simulation(
    names: tuple[str, ...], subtests: pytest.Subtests
) -> None:
    for name in names:
        with subtests.test(name):
            assert relative_difference(name) < 1e-12


def test_a_function_holds_for_other_coefficients() -> None:
    vessel = parameters_of("milliampere").nominal()
    light = 0.5 * vessel
    function = rates_function(kinematics_of(vessel.dofs), vessel.plant_table())
    nu, tau, none = np.array([0.4, -0.2, 0.05]), np.array([100.0, 50.0, -30.0]), np.zeros(3)
    numbers = coefficients(light.plant_table())
    _, found = function(none, nu, tau, none, none[:2], none[:2], numbers)
    expected = light.forward(tau[None], nu[None], none[None])[0]
    np.testing.assert_allclose(np.asarray(found).ravel(), expected, rtol=1e-12)
