"""The closed loop against exact solutions and laws."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.control.pid import PidFeedforward
from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.guidance import ReferenceFilter
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Voyage, recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.disturbance import ConstantForce, Disturbance
from seatrial.models.weather.noise import MeasurementNoise

CALM = Disturbance(noise=None, force=None)
FILTER = ReferenceFilter(bandwidth_rad_s=0.5, damping=0.7)
LIMITS = {1: (50.0,), 3: (20.0, 20.0, 10.0)}


def sail_timetable(
    vessel: Vessel,
    setpoint: Array,
    seconds: float,
    *,
    weather: Disturbance = CALM,
    thruster: SecondOrderLag | None = None,
    gains: float = 0.0,
    start: Array | None = None,
    step_s: float = 0.05,
    feedforward: bool = True,
    seed: int = 0,
) -> Voyage:
    n, n_dof = round(seconds / 0.1), len(vessel.dofs)
    same = (gains,) * n_dof
    pid = PidFeedforward(same, same, same, feedback=True, feedforward=feedforward)
    return sail(
        Plant(vessel, thruster, LIMITS[n_dof]),
        weather.realise(n, vessel.dofs, np.random.default_rng(seed)),
        (Timetable(np.tile(setpoint, (n, 1))), np.zeros(1)),
        FILTER.table(0.1),
        pid.build(vessel, 0.1),
        np.zeros(n_dof) if start is None else start,
        0.1,
        step_s,
    )


def surge(mass: float = 60.0, linear: float = 20.0, quadratic: float = 0.0) -> Vessel:
    derivatives = {"X_u": -linear, "X_|u|u": -quadratic}
    return from_derivatives("surge", ("surge",), np.array([[mass]]), derivatives)


def test_linear_surge_equals_the_exact_solution() -> None:
    push = Disturbance(noise=None, force=ConstantForce(30.0, 0.0, 0.0))
    voyage = sail_timetable(surge(), np.zeros(1), 20.0, weather=push, feedforward=False)
    terminal, rate = 30.0 / 20.0, 20.0 / 60.0
    exact = terminal * (1.0 - np.exp(-rate * voyage.t))
    np.testing.assert_allclose(voyage.log.nu[:, 0], exact, atol=1e-8)
    distance = terminal * (voyage.t - (1.0 - np.exp(-rate * voyage.t)) / rate)
    np.testing.assert_allclose(voyage.log.eta[:, 0], distance, atol=1e-7)


def test_quadratic_surge_equals_the_exact_solution() -> None:
    push = Disturbance(noise=None, force=ConstantForce(32.0, 0.0, 0.0))
    vessel = surge(50.0, 0.0, 2.0)
    voyage = sail_timetable(vessel, np.zeros(1), 30.0, weather=push, feedforward=False)
    terminal = np.sqrt(32.0 / 2.0)
    exact = terminal * np.tanh(voyage.t * 2.0 * terminal / 50.0)
    np.testing.assert_allclose(voyage.log.nu[:, 0], exact, atol=1e-7)


@pytest.mark.parametrize("thruster", [None, SecondOrderLag(2.0, 0.8)])
def test_the_integrator_is_of_fourth_order(
    milliampere: Vessel, thruster: SecondOrderLag | None
) -> None:
    goal = np.array([3.0, -4.0, 1.0])

    def final(step_s: float) -> Array:
        voyage = sail_timetable(
            0.5 * milliampere, goal, 4.0, thruster=thruster, step_s=step_s, feedforward=True
        )
        return np.concatenate([voyage.log.eta[-1], voyage.log.nu[-1]])

    exact = final(0.1 / 64)
    errors = [np.linalg.norm(final(0.1 / parts) - exact) for parts in (1, 2, 4)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 3.7)


def test_the_log_equals_the_readable_equations(milliampere: Vessel) -> None:
    lag = SecondOrderLag(2.0, 0.8)
    plant = 0.5 * milliampere
    wind = Disturbance(noise=None, force=ConstantForce(200.0, 100.0, 30.0))
    voyage = sail_timetable(
        plant, np.array([4.0, 2.0, 1.0]), 20.0, weather=wind, thruster=lag, gains=50.0
    )
    log = voyage.log
    attitude = np.zeros((len(log.eta), 3))
    attitude[:, 2] = log.eta[:, 2]
    nominal = plant + wind.table(PLANAR)
    force = nominal.inverse(log.nu_dot, log.nu, attitude)
    np.testing.assert_allclose(force, log.tau_actual, atol=1e-8)
    recording = recording_of(voyage, wind.realise(len(log.eta), PLANAR, np.random.default_rng(0)))
    np.testing.assert_allclose(
        recording.with_thruster(lag).force("filtered"), log.tau_actual, atol=1e-8
    )


def short_voyage() -> list[Array]:
    """The log of a ferry's few seconds in wind, with thrusters that lag."""
    ferry = from_derivatives(
        "ferry", PLANAR, np.diag([2000.0, 2500.0, 5000.0]), {"X_u": -30.0, "Y_|v|v": -100.0}
    )
    wind = Disturbance(noise=None, force=ConstantForce(200.0, 100.0, 30.0))
    goal, lag = np.array([4.0, 2.0, 1.0]), SecondOrderLag(2.0, 0.8)
    return list(sail_timetable(ferry, goal, 5.0, weather=wind, thruster=lag, gains=50.0).log)


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
    pushed = Disturbance(noise=None, force=ConstantForce(1e5, 0.0, 0.0))
    with pytest.raises(Diverged, match=r"\|u\| exceeds 50 at t = \d") as caught:
        sail_timetable(surge(), np.zeros(1), 60.0, weather=pushed, feedforward=False)
    assert caught.value.quantity == "u"
    assert caught.value.time_s == pytest.approx(0.1, abs=0.11)


def test_a_state_that_is_not_a_number_is_a_divergence() -> None:
    bad = surge(60.0, -400.0)  # negative damping: doubles every 0.1 s
    pushed = Disturbance(noise=None, force=ConstantForce(1.0, 0.0, 0.0))
    with pytest.raises(Diverged):
        sail_timetable(bad, np.zeros(1), 200.0, weather=pushed, feedforward=False)


def test_a_step_longer_than_the_period_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="integration step"):
        sail_timetable(surge(), np.zeros(1), 1.0, step_s=0.2)


def test_noise_is_measured_but_not_sailed_without_feedback(milliampere: Vessel) -> None:
    noise = Disturbance(MeasurementNoise(0.02, 0.2, 0.05, 0.2, 0.01, 0.1), None)
    quiet = sail_timetable(milliampere, np.array([2.0, 0, 0]), 400.0)
    noisy = sail_timetable(milliampere, np.array([2.0, 0, 0]), 400.0, weather=noise)
    np.testing.assert_array_equal(quiet.log.nu, noisy.log.nu)
    spread = np.std(noisy.log.eta_measured - noisy.log.eta, axis=0)
    np.testing.assert_allclose(spread, [0.02, 0.02, np.radians(0.2)], rtol=0.05)
    spread = np.std(noisy.log.nu_measured - noisy.log.nu, axis=0)
    np.testing.assert_allclose(spread, [0.05, 0.05, np.radians(0.2)], rtol=0.05)
