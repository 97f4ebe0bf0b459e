"""The autopilot on a ship that is Nomoto's equation, and on KVLCC2 in wind moment and current."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lti

from docs.vessels import parameters_of
from seatrial.models.control.autopilot import Autopilot, AutopilotTable
from seatrial.models.control.mpc import SteeredMpc
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.setpoints import Step
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.steering import Nomoto, SteeringModel, steering_model
from seatrial.models.vessel.thruster import Input
from seatrial.runner.trials.checks import check
from seatrial.runner.trials.closed_loop import SimulatedMission
from tests.models.control.sailing import weather
from tests.trials import composed, sailed

GAIN, TIME_S, SPEED, LENGTH = 0.2, 5.0, 1.0, 4.0
PERIOD_S = 0.05


def nomoto_ship(gain: float = GAIN, time_s: float = TIME_S) -> VesselParameters:
    """T r_dot + r = K delta exactly; sway and surge are damped by themselves."""
    return VesselParameters(
        name="nomoto", dofs=("surge", "sway", "yaw"), coriolis=False, length_m=LENGTH,
        inertia=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), speed_m_s=SPEED,
        derivatives={
            "X_u": -0.1, "X_n": 0.1, "Y_v": -1.0, "N_r": -1.0 / time_s,
            "N_delta": gain / time_s,
        },
        inputs={
            "delta": Input(-0.6, 0.6, rate_limit=0.5), "n": Input(0.0, 4.0, start=1.0)
        },
        velocity_limits=(50.0, 50.0, 50.0),
    )  # fmt: skip


def of_ship(ship: VesselParameters) -> dict[str, Any]:
    """The options that a steering controller takes from its vessel."""
    names = "input_names", "input_start", "input_low", "input_high", "input_rates"
    of_inputs = {name: getattr(ship, name) for name in names}
    return {**of_inputs, "speed_m_s": ship.approach_speed_m_s, "length_m": LENGTH}


def autopilot(ship: VesselParameters, **options: Any) -> Autopilot:
    return Autopilot(**{**of_ship(ship), "shaft": ship.driven_by, **options})


def predictive(ship: VesselParameters) -> SteeredMpc:
    return SteeredMpc(**of_ship(ship), input_lags=ship.input_lags)


def steered(
    ship: VesselParameters, controller: Autopilot | SteeredMpc, heading: float, duration_s: float,
    moment: float = 0.0, ahead: float = 0.0, wind_up: bool = False,
) -> Voyage:  # fmt: skip
    """A step of the heading reference, in a constant moment and a constant force ahead."""
    n = round(duration_s / PERIOD_S)
    parameters, state = controller.build(ship.nominal(), PERIOD_S)
    if wind_up:
        assert isinstance(parameters, AutopilotTable)
        parameters = parameters._replace(track=0.0)
    setpoints = np.tile([0.0, 0.0, heading], (n, 1))
    force = np.tile([ahead, 0.0, moment], (n, 1))
    return sail(
        ship.plant(ship.nominal()), weather(n, force_ned=force),
        (Timetable(setpoints), np.zeros(1)), Step().table(PERIOD_S), (parameters, state),
        np.zeros(3), PERIOD_S, 0.01, start_nu=np.array([SPEED, 0.0, 0.0]),
    )  # fmt: skip


def test_the_first_order_model_of_a_ship_that_is_one() -> None:
    ship = nomoto_ship()
    linear = steering_model(ship.nominal(), SPEED, np.array(ship.input_start))
    np.testing.assert_allclose(linear.nomoto(0), Nomoto(GAIN, TIME_S), rtol=1e-7)
    assert ship.input_signs == (1.0, 1.0)
    assert ship.nomoto_gain == pytest.approx((GAIN, 0.0))


def test_without_damping_there_is_no_first_order_model() -> None:
    """The yaw rate over the helm has no end, so that its gain and its time are not numbers."""
    dofs, A, B = ("sway", "yaw"), np.array([[-1.0, -2.0], [0.0, 0.0]]), np.array([[0.1], [1.0]])
    assert SteeringModel(dofs, A, B).nomotos == (Nomoto(0.0, 0.0),)
    (damped,) = SteeringModel(dofs, A - np.diag([0.0, 0.5]), B).nomotos
    assert damped == pytest.approx((2.0, 2.0))


@pytest.mark.parametrize("gain", [GAIN, -GAIN])
@pytest.mark.parametrize("time_s", [TIME_S, -TIME_S])
@pytest.mark.parametrize("damping", [0.7, 1.0])
def test_the_heading_settles_as_the_poles_promise(
    gain: float, time_s: float, damping: float
) -> None:
    """psi'' + 2 zeta omega psi' + omega^2 psi = omega^2 psi_d, also of an unstable ship."""
    gain = gain if time_s > 0.0 else -gain
    ship = nomoto_ship(gain, time_s)
    controller = autopilot(ship, integral=False, feedforward=False, damping=damping)
    turn, omega = np.radians(2.0), controller.omega
    voyage = steered(ship, controller, turn, 60.0)
    promised = lti([omega**2], [1.0, 2.0 * damping * omega, omega**2]).step(T=voyage.t)[1]
    # the reference comes one instant late; half an instant of delay by the sampled command remains
    psi = voyage.log.eta[:, 2] / turn
    np.testing.assert_allclose(psi[1:], promised[:-1], atol=0.03)
    assert psi[0] == 0.0
    assert psi[-1] == pytest.approx(1.0, rel=1e-3)


def test_no_steady_heading_error_under_a_constant_moment() -> None:
    """Without the integral, k_p e = -moment / N_delta remains."""
    ship, moment = nomoto_ship(), 0.004
    voyage = steered(ship, autopilot(ship), 0.0, 600.0, moment)
    assert np.max(np.abs(voyage.log.eta[:, 2])) > np.radians(1.0)
    assert abs(voyage.log.eta[-1, 2]) < np.radians(0.01)
    proportional = autopilot(ship, integral=False)
    linear = proportional.steered(ship.nominal())
    left = steered(ship, proportional, 0.0, 600.0, moment).log.eta[-1, 2]
    expected = moment / (GAIN / TIME_S) / proportional.gains(linear)[0]
    assert left == pytest.approx(expected, rel=1e-3)


def test_no_steady_speed_error_under_a_constant_resistance() -> None:
    ship = nomoto_ship()
    voyage = steered(ship, autopilot(ship), 0.0, 900.0, ahead=-0.05)
    assert np.min(voyage.log.nu[:, 0]) < 0.9 * SPEED
    assert voyage.log.nu[-1, 0] == pytest.approx(SPEED, rel=1e-3)
    kept = steered(ship, autopilot(ship, shaft=None), 0.0, 900.0, ahead=-0.05)
    assert kept.log.nu[-1, 0] == pytest.approx(SPEED - 0.5, rel=1e-3)


def test_limits_and_rates_are_respected() -> None:
    ship = nomoto_ship()
    log = steered(ship, autopilot(ship), np.pi / 2.0, 60.0).log
    helm = log.tau[:, 0]
    assert np.max(np.abs(helm)) == pytest.approx(0.6)
    change = np.diff(np.concatenate([[0.0], helm]))
    assert np.max(np.abs(change)) == pytest.approx(0.5 * PERIOD_S)


def test_no_wind_up_after_saturation() -> None:
    """A turn of 170 degrees with the helm at its limit: the overshoot is that of a small step."""
    ship = nomoto_ship()
    controller = autopilot(ship)
    overshoots = []
    for step, wind_up in ((np.radians(2.0), False), (np.radians(170.0), False),
                          (np.radians(170.0), True)):  # fmt: skip
        psi = steered(ship, controller, step, 400.0, wind_up=wind_up).log.eta[:, 2]
        overshoots.append(float(np.max(psi)) / step - 1.0)
        assert psi[-1] == pytest.approx(step, rel=1e-2)
    small, large, wound_up = overshoots
    assert large <= small + 0.02
    assert wound_up > 3.0 * max(large, 0.02)


@pytest.mark.nightly
def test_two_propellers_steer_by_their_difference_and_drive_by_their_sum() -> None:
    """Otter and BlueBoat keep heading and speed under a constant moment and resistance."""
    for name, force, moment in (("otter", -20.0, 3.0), ("blueboat", -5.0, 1.0)):
        boat = parameters_of(name)
        pair = boat.input_names
        assert boat.steered_by == boat.driven_by == pair
        controller = autopilot(boat, helm=pair, shaft=pair, length_m=boat.length_m)
        log = steered(boat, controller, np.radians(60.0), 120.0, moment, force).log
        assert log.eta[-1, 2] == pytest.approx(np.radians(60.0), abs=np.radians(0.1))
        assert log.nu[-1, 0] == pytest.approx(boat.approach_speed_m_s, rel=1e-3)
        both = np.array([boat.input_low, boat.input_high])
        assert np.all(both[0] <= log.tau) and np.all(log.tau <= both[1])  # noqa: PT018


def test_the_helm_is_the_rudder_that_turns_the_vessel_most() -> None:
    """Not the planes of an underwater vehicle; a ship has its `delta`."""
    remus, mariner = parameters_of("remus100"), parameters_of("mariner")
    assert (remus.steered_by, remus.driven_by) == ("delta_r", "n")
    assert (mariner.steered_by, mariner.driven_by) == ("delta", None)
    assert parameters_of("milliampere").steered_by == "delta"  # which it has not: refused


def test_a_vessel_without_the_helm_is_refused() -> None:
    ship = nomoto_ship()
    with pytest.raises(ConfigurationError, match="got fin, expected an input of the vessel"):
        autopilot(ship, helm="fin").build(ship.nominal(), PERIOD_S)
    with pytest.raises(ConfigurationError, match="got delta, screw, expected an input"):
        autopilot(ship, shaft=("delta", "screw")).build(ship.nominal(), PERIOD_S)


def mission(*options: str) -> SimulatedMission:
    """The mission of a trial, with the controller built on the nominal vessel."""
    trial = composed("identifier=none", "evaluation=none", *options)
    check(trial)
    return sailed(trial)


def across(sigma: float) -> Array:
    """Distance from a leg to the north [L] in a current to the east of a tenth of the speed."""
    log = mission(
        "vessel=kvlcc2", "excitation=path_following", "controller=autopilot",
        "disturbance=current", "disturbance.current.variation=constant",
        "disturbance.current.direction_deg=90", "disturbance.current.speed_m_s=0.12",
        "excitation.waypoints=[[0,0],[120,0]]", f"excitation.sigma={sigma}",
    ).voyage.log  # fmt: skip
    return np.asarray(log.eta[:, 1] / 7.0)


def test_integral_line_of_sight_has_no_cross_track_error_in_a_current() -> None:
    """Line of sight alone settles aside, by Delta tan of the drift angle (Fossen, 12.5)."""
    assert abs(across(0.3)[-1]) < 0.02
    aside = across(0.0)[-1]
    assert aside == pytest.approx(4.0 * np.tan(np.arcsin(0.12 / 1.18)), rel=0.1)


def test_way_points_scale_with_the_ship() -> None:
    """The same path in ship lengths of a ship of 7 m and one of 161 m."""
    for name, length in (("kvlcc2", 7.0), ("mariner", 160.93)):
        path_following = ("excitation=path_following", "controller=autopilot", "disturbance=calm")
        log = mission(f"vessel={name}", *path_following).voyage.log
        path = log.eta_d[:, :2] / length
        error = np.hypot(*(log.eta[:, :2] / length - path).T)
        assert path[-1] == pytest.approx([60.0, 20.0], abs=12.0)
        assert np.max(error) < 2.5  # at the corners
        assert np.median(error) < 0.4


@pytest.mark.parametrize("gain", [GAIN, -GAIN])
def test_predictive_control_of_an_unstable_ship(gain: float) -> None:
    """It settles, keeps the limits of helm and rate, and leaves no error under a moment."""
    ship = nomoto_ship(gain, -TIME_S)
    controller = predictive(ship)
    (diagnostic,) = controller.diagnostics(ship.nominal(), PERIOD_S)
    assert diagnostic.value is not None
    assert diagnostic.value < 1.0
    log = steered(ship, controller, np.radians(30.0), 120.0, moment=0.004).log
    assert log.eta[-1, 2] == pytest.approx(np.radians(30.0), abs=np.radians(0.05))
    helm, every = log.tau[:, 0], controller.command_rows(PERIOD_S)
    assert np.max(np.abs(helm)) <= 0.6 + 1e-6
    assert np.max(np.abs(np.diff(helm))) <= 0.5 * every * PERIOD_S + 1e-6
    assert helm[-1] == pytest.approx(-0.004 / (gain / -TIME_S), rel=1e-2)


def overshoot(vessel: str, controller: str, bandwidth: float) -> float:
    """Of a change of the course by 20 degrees [deg], with a filter of a bandwidth [U / L]."""
    turned = mission(
        f"vessel={vessel}", "excitation=heading_changes", "excitation.headings_deg=[0,20]",
        "excitation.hold_lengths=40", f"excitation.bandwidth={bandwidth}",
        f"controller={controller}",
    )  # fmt: skip
    voyage = turned.voyage
    heading = np.degrees(voyage.log.eta[:, voyage.dofs.index("yaw")])
    assert turned.failures == 0
    assert heading[-1] == pytest.approx(20.0, abs=0.5)
    return float(np.max(heading)) - 20.0


@pytest.mark.nightly
@pytest.mark.parametrize("vessel", ["kvlcc2", "mariner", "tanker", "frigate"])
def test_predictive_control_overshoots_no_more_than_the_autopilot(vessel: str) -> None:
    """With the filter of the mission; with nearly a step it does not overshoot at all."""
    filtered = overshoot(vessel, "mpc_heading", 0.6)
    assert filtered <= max(overshoot(vessel, "autopilot", 0.6), 0.005)
    assert overshoot(vessel, "mpc_heading", 5.0) < 0.05


def test_a_lag_of_the_helm_is_in_the_prediction() -> None:
    """With the lag in its model the heading is damped as without one."""
    settled = []
    for lag in (None, 2.0):
        ship = nomoto_ship(GAIN, TIME_S)
        helm = replace(ship.inputs["delta"], time_constant_s=lag)
        ship = replace(ship, inputs={**ship.inputs, "delta": helm})
        log = steered(ship, predictive(ship), np.radians(20.0), 120.0).log
        assert log.eta[-1, 2] == pytest.approx(np.radians(20.0), abs=np.radians(0.05))
        settled.append(np.degrees(np.max(log.eta[:, 2])) - 20.0)
    assert max(settled) < 0.2
