"""The thruster lead of the feedforward."""

from typing import Any

import numpy as np
import pytest

from seatrial.models.control.pid import PidFeedforward
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.voyage import NO_OUTLOOK, Log, Voyage
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from tests.trials import composed, sailed

LAG = SecondOrderLag(2.0, 0.8)
NONE = (0.0,) * 3


def lap(lead: bool, model: Vessel | None = None, period_s: float = 0.1) -> Voyage:
    """The ferry's lap in the calm, with the controller built on its true model, or on another."""
    options = [f"controller.thruster_lead={str(lead).lower()}", f"sample_time_s={period_s}"]
    one = composed("controller=pid_ff", "identifier=none", *options, "integration_step_s=0.02")
    return sailed(one, model=model or one.plant.scale * one.vessel.nominal()).voyage


def error_of(voyage: Voyage) -> float:
    """Mean error of the position [m]."""
    difference: Any = (voyage.log.eta_d - voyage.log.eta)[:, :2]
    return float(np.mean(np.hypot(*difference.T)))


def test_with_the_true_model_the_lead_tracks_within_a_centimetre(milliampere: Vessel) -> None:
    assert error_of(lap(lead=True)) <= 0.01
    assert error_of(lap(lead=True, period_s=0.02)) <= 0.006
    assert error_of(lap(lead=False)) > 0.04
    assert error_of(lap(lead=False, model=milliampere)) > 0.2  # the nominal model


def test_the_lead_is_a_backward_difference_and_nothing_at_the_first_sample() -> None:
    mass = np.diag([10.0, 20.0, 30.0])
    vessel = from_derivatives("box", PLANAR, mass, {}, False)
    pid = PidFeedforward(NONE, NONE, NONE, thruster_lead=True, thruster=LAG)
    parameters, state = pid.build(vessel, 0.1)
    step, still = CONTROLLERS[type(parameters)], np.zeros(3)
    wanted = [np.array([1.0, 0.0, 0.0]), np.array([1.5, 0.0, 0.2])]
    commands = []
    for acceleration in wanted:
        tau, tau_fb = np.empty(3), np.empty(3)
        step(parameters, state, still, still, still, still, acceleration, tau, tau_fb)
        commands.append(tau)
    np.testing.assert_allclose(commands[0], mass @ wanted[0])
    change = mass @ (wanted[1] - wanted[0]) / 0.1
    np.testing.assert_allclose(commands[1], mass @ wanted[1] + 0.8 * change)


def test_the_command_does_not_jump_when_the_model_does(milliampere: Vessel) -> None:
    pid = PidFeedforward((100.0, 550.0, 940.0), (30.0, 30.0, 0.0), (850.0, 890.0, 1850.0))
    rng = np.random.default_rng(0)
    reference = rng.normal(size=(3, 3)) * 0.3
    eta, nu = rng.normal(size=(2, 3))
    log = Log(*(np.zeros((5, 3)) for _ in Log._fields))
    log.eta_d[:], log.nu_d[:], log.nu_dot_d[:] = reference
    parameters, state = pid.build(milliampere, 0.1)

    def command(table: Any, integral: Array) -> Array:
        tau = np.empty(3)
        CONTROLLERS[type(table)](table, integral, eta, nu, *reference, tau, np.empty(3))
        return tau

    before = command(parameters, state.copy())
    adapted = pid.adapt(parameters, state, 0.5 * milliampere, 0.1, NO_OUTLOOK, log, 4)
    after = command(adapted, state)
    np.testing.assert_allclose(after[:2], before[:2], rtol=1e-12)
    assert abs(after[2] - before[2]) > 1.0  # no integral in yaw that could take it


def test_feedback_while_exciting_and_none_in_an_evaluation() -> None:
    one = composed("identifier=none", "controller.deployed_feedback=false")
    exciting, evaluated = (sailed(one, deployed=deployed).voyage for deployed in (False, True))
    assert np.all(np.mean(np.abs(exciting.log.tau_fb), axis=0) > 10.0)
    assert not np.any(evaluated.log.tau_fb)
    with pytest.raises(ConfigurationError, match="deployed_feedback and feedforward are both off"):
        PidFeedforward(NONE, NONE, NONE, feedforward=False, deployed_feedback=False)


def test_the_spectral_radius_is_that_of_the_sampled_loop() -> None:
    """A mass in surge, by the written recursion; no number where nothing is to settle."""
    m, h, kp, ki, kd = 10.0, 0.5, 4.0, 0.5, 8.0
    vessel = from_derivatives("box", ("surge",), np.array([[m]]), {}, False)
    (found,) = PidFeedforward((kp,), (ki,), (kd,)).diagnostics(vessel, h)
    state, sizes = np.array([1.0, 0.0, 0.0]), []  # eta, nu, integral
    for _ in range(400):
        tau = -kp * state[0] + ki * state[2] - kd * state[1]
        pose = state[0] + h * state[1] + 0.5 * h**2 * tau / m
        state = np.array([pose, state[1] + h * tau / m, state[2] - h * state[0]])
        sizes.append(float(np.linalg.norm(state)))
    decay = (max(sizes[300:]) / max(sizes[200:300])) ** 0.01
    assert found.value == pytest.approx(decay, abs=5e-3)
    assert found.value < 1.0
    (fast,) = PidFeedforward((kp,), (ki,), (100.0,)).diagnostics(vessel, h)
    assert fast.value > 1.0  # too much damping for the sample time
    assert PidFeedforward((kp,), (ki,), (kd,), feedback=False).diagnostics(vessel, h) == []
    assert PidFeedforward((0.0,), (ki,), (kd,)).diagnostics(vessel, h) == []


@pytest.mark.parametrize("vessel", ["milliampere", "supply_vessel", "modulus_ship"])
def test_the_vessels_own_gains_settle(vessel: str) -> None:
    one = composed("controller=pid_ff", f"vessel={vessel}")
    (found,) = one.controller.diagnostics(one.vessel.nominal(), one.sample_time_s)
    assert 0.5 < found.value < 1.0
