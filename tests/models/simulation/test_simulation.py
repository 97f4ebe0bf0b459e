"""The closed loop against exact solutions and laws."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.voyage import Voyage, recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.disturbance import ConstantForce, Disturbance
from seatrial.models.weather.noise import MeasurementNoise
from seatrial.models.weather.weather import Weather
from tests.models.control.sailing import drift


def realised(
    seconds: float, dofs: tuple[str, ...], *force: float, noise: MeasurementNoise | None = None
) -> Weather:
    """Noise and a constant force (north [N], east [N], yaw [Nm]), at 10 Hz."""
    case = Disturbance(noise, ConstantForce(*force) if force else None)
    return case.realise(round(10.0 * seconds), dofs, np.random.default_rng(0))


def surge(mass: float = 60.0, linear: float = 20.0, quadratic: float = 0.0) -> Vessel:
    derivatives = {"X_u": -linear, "X_|u|u": -quadratic}
    return from_derivatives("surge", ("surge",), np.array([[mass]]), derivatives)


def pushed(vessel: Vessel, seconds: float, north_n: float) -> Voyage:
    """A vessel in surge, from rest under a constant force."""
    return drift(vessel, realised(seconds, ("surge",), north_n, 0.0, 0.0))


def test_quadratic_surge_equals_the_exact_solution() -> None:
    voyage = pushed(surge(50.0, 0.0, 2.0), 30.0, 32.0)
    terminal = np.sqrt(32.0 / 2.0)
    phase = voyage.t * 2.0 * terminal / 50.0
    np.testing.assert_allclose(voyage.log.nu[:, 0], terminal * np.tanh(phase), atol=1e-7)
    distance = 50.0 / 2.0 * np.log(np.cosh(phase))
    np.testing.assert_allclose(voyage.log.eta[:, 0], distance, atol=1e-6)


@pytest.mark.parametrize("thruster", [None, SecondOrderLag(2.0, 0.8)])
def test_the_integrator_is_of_fourth_order(
    milliampere: Vessel, thruster: SecondOrderLag | None
) -> None:
    goal, calm = np.array([3.0, -4.0, 1.0]), realised(4.0, PLANAR)

    def final(step_s: float) -> Array:
        log = drift(0.5 * milliampere, calm, goal=goal, lag=thruster, step_s=step_s).log
        return np.concatenate([log.eta[-1], log.nu[-1]])

    exact = final(0.1 / 64)
    errors = [np.linalg.norm(final(0.1 / parts) - exact) for parts in (1, 2, 4)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 3.7)


def test_the_log_equals_the_readable_equations(milliampere: Vessel) -> None:
    lag, push = SecondOrderLag(2.0, 0.8), (200.0, 100.0, 30.0)
    plant, weather = 0.5 * milliampere, realised(20.0, PLANAR, *push)
    voyage = drift(plant, weather, goal=np.array([4.0, 2.0, 1.0]), lag=lag, gain=50.0)
    log = voyage.log
    attitude = np.zeros((len(log.eta), 3))
    attitude[:, 2] = log.eta[:, 2]
    nominal = plant + ConstantForce(*push).table(PLANAR)
    force = nominal.inverse(log.nu_dot, log.nu, attitude)
    np.testing.assert_allclose(force, log.tau_actual, atol=1e-8)
    filtered = recording_of(voyage, weather).with_thruster(lag).force("filtered")
    np.testing.assert_allclose(filtered, log.tau_actual, atol=1e-8)


def short_voyage() -> list[Array]:
    """The log of a ferry's few seconds in wind, with thrusters that lag."""
    inertia = np.diag([2000.0, 2500.0, 5000.0])
    ferry = from_derivatives("ferry", PLANAR, inertia, {"X_u": -30.0, "Y_|v|v": -100.0})
    wind, goal = realised(5.0, PLANAR, 200.0, 100.0, 30.0), np.array([4.0, 2.0, 1.0])
    return list(drift(ferry, wind, goal=goal, lag=SecondOrderLag(2.0, 0.8), gain=50.0).log)


def test_the_loop_without_a_compiler_is_the_compiled_loop() -> None:
    code = "import pickle, sys; from tests.models.simulation import test_simulation as test; " \
           "pickle.dump(test.short_voyage(), sys.stdout.buffer)"  # fmt: skip
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=Path(__file__).parents[3], env=environment,
        capture_output=True, check=True,
    )  # fmt: skip
    for compiled, readable in zip(short_voyage(), pickle.loads(done.stdout), strict=True):
        np.testing.assert_allclose(compiled, readable, rtol=1e-12, atol=1e-12)


def test_a_run_away_is_told_with_its_time() -> None:
    with pytest.raises(Diverged, match=r"\|u\| exceeds 50 at t = \d") as caught:
        pushed(surge(), 60.0, 1e5)
    assert caught.value.quantity == "u"
    assert caught.value.time_s == pytest.approx(0.1, abs=0.11)


def test_a_state_that_is_not_a_number_is_a_divergence() -> None:
    with pytest.raises(Diverged):
        pushed(surge(60.0, -400.0), 200.0, 1.0)  # negative damping: doubles every 0.1 s


def test_a_step_longer_than_the_period_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="integration step"):
        drift(surge(), realised(1.0, ("surge",)), step_s=0.2)


def test_noise_is_measured_but_not_sailed_without_feedback(milliampere: Vessel) -> None:
    noise = MeasurementNoise(0.02, 0.2, 0.05, 0.2, 0.01, 0.1)
    quiet, noisy = (
        drift(milliampere, realised(400.0, PLANAR, noise=part), goal=np.array([2.0, 0.0, 0.0])).log
        for part in (None, noise)
    )
    np.testing.assert_array_equal(quiet.nu, noisy.nu)
    spread = np.std(noisy.eta_measured - noisy.eta, axis=0)
    np.testing.assert_allclose(spread, [0.02, 0.02, np.radians(0.2)], rtol=0.05)
    spread = np.std(noisy.nu_measured - noisy.nu, axis=0)
    np.testing.assert_allclose(spread, [0.05, 0.05, np.radians(0.2)], rtol=0.05)
