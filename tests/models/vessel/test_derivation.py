"""The tuning that is derived from a vessel: laws of similarity and of pole placement."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.control.linear_design import design_model
from seatrial.models.control.pid import PidFeedforward
from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.derivation import derived
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.tuning import PidTuning, Tuning

SHIP: dict[str, Any] = {
    "name": "ship",
    "dofs": ("surge", "sway", "yaw"),
    "inertia": ((3000.0, 0.0, 0.0), (0.0, 3500.0, 80.0), (0.0, 80.0, 6000.0)),
    "derivatives": {
        **{"X_u": -40.0, "X_|u|u": -120.0, "Y_v": -60.0, "Y_|v|v": -300.0},
        **{"N_r": -150.0, "N_|r|r": -900.0},
    },
    "force_limits": (1200.0, 800.0, 2000.0),
    "length_m": 5.0,
}
# Dimensions of the numbers, as powers of the length with the same water and gravity: a length 1, a
# time 1/2, a mass 3, a force 3; of yaw, an angle 0 and a moment 4.
FROUDE = {
    "pid.kp": (2.0, 2.0, 4.0),
    "pid.ki": (1.5, 1.5, 3.5),
    "pid.kd": (2.5, 2.5, 4.5),
    "reference.speed_m_s": 0.5,
    "reference.turn_rate_rad_s": -0.5,
    "reference.bandwidth_rad_s": -0.5,
    "excitation.time_scale": 0.5,
    "excitation.surge_force_n": 3.0,
    "excitation.yaw_moment_nm": 4.0,
    "constant_force.north_n": 3.0,
    "noise.position_m": 1.0,
    "noise.angle_deg": 0.0,
    "noise.velocity_m_s": 0.5,
    "noise.angular_rate_deg_s": -0.5,
    "noise.acceleration_m_s2": 0.0,
    "noise.angular_acceleration_deg_s2": -1.0,
    "wind.speed_m_s": 0.5,
    "current.speed_m_s": 0.5,
    "waves.position_m": 1.0,
    "waves.peak_period_s": 0.5,
    "process": (0.0, 0.0, -1.0),
    "control.error_weight": (-2.0, -2.0, 0.0),
    "control.input_weight": (0.0, 0.0, 0.0) ,
    "control.process": (0.0, 0.0, -1.0),
    "control.measurement": (1.0, 1.0, 0.0),
    "control.bias_walk": (3.0, 3.0, 4.0),
    "control.mission.side_m": 1.0,
    "control.mission.square_s": 0.5,
    "control.mission.speed": (0.5, 0.5, -0.5),
    "control.mission.acceleration": (0.0, 0.0, -1.0),
}  # fmt: skip


def completed(vessel: VesselParameters, sample_time_s: float) -> VesselParameters:
    numbers: dict[str, Any] = derived(vessel, sample_time_s)
    return replace(vessel, **numbers)


def ship(**changes: Any) -> VesselParameters:
    return VesselParameters(**(SHIP | changes))


def scaled(factor: float) -> VesselParameters:
    """The ship `factor` times as long, by Froude's law.

    A coefficient of u^a v^b r^c in a force of power p scales with p - (a + b - c) / 2.
    """
    arms = np.array([0.0, 0.0, 1.0])
    inertia = np.array(SHIP["inertia"]) * factor ** (3.0 + arms[:, None] + arms[None, :])
    powers = {"X_u": 2.5, "X_|u|u": 2.0, "Y_v": 2.5, "Y_|v|v": 2.0, "N_r": 4.5, "N_|r|r": 5.0}
    return ship(
        inertia=tuple(map(tuple, inertia.tolist())),
        derivatives={
            key: value * factor ** powers[key] for key, value in SHIP["derivatives"].items()
        },
        force_limits=tuple(np.array(SHIP["force_limits"]) * factor ** (3.0 + arms)),
        length_m=SHIP["length_m"] * factor,
    )


def number(vessel: VesselParameters, path: str) -> Any:
    value: Any = vessel.tuning
    for name in path.split("."):
        value = getattr(value, name)
    return np.array(value)


@pytest.mark.parametrize("factor", [0.1, 16.0])
def test_a_froude_scaled_vessel_has_froude_scaled_numbers(factor: float) -> None:
    one, other = (completed(vessel, 0.01) for vessel in (ship(), scaled(factor)))
    for path, power in FROUDE.items():
        expected = number(one, path) * factor ** np.array(power)
        np.testing.assert_allclose(number(other, path), expected, rtol=2e-3, err_msg=path)
    ratio = np.array(other.velocity_limits) / np.array(one.velocity_limits)
    np.testing.assert_allclose(ratio, factor ** np.array([0.5, 0.5, -0.5]), rtol=2e-3)


def test_gains_place_the_poles() -> None:
    """M s^2 + (D + Kd) s + Kp has the natural frequency and damping of the design, on each axis."""
    vessel = completed(ship(), 0.1)
    drag = np.array([40.0, 60.0, 150.0])
    inertia = np.diag(vessel.nominal().inertia)
    omega = np.sqrt(number(vessel, "pid.kp") / inertia)
    np.testing.assert_allclose(omega, 0.3 * np.sqrt(9.81 / 5.0), rtol=1e-3)
    damping = (drag + number(vessel, "pid.kd")) / (2.0 * omega * inertia)
    np.testing.assert_allclose(damping, 0.8, rtol=1e-3)


@pytest.mark.parametrize("name", ["milliampere", "modulus_ship", "supply_vessel"])
def test_the_integral_controllers_of_own_vessels_are_stable(name: str) -> None:
    vessel = completed(replace(parameters_of(name), tuning=Tuning()), 0.1)
    control, nominal = vessel.tuning.control, vessel.nominal()
    pid = PidFeedforward(*(tuple(number(vessel, f"pid.{gain}")) for gain in ("kp", "ki", "kd")))
    (radius,) = pid.diagnostics(nominal, 0.1)
    assert 0.9 < radius.value < 1.0
    design = design_model(nominal, vessel.force_limits or (), control.period_s or 0.0)
    assert design.model.controllable_order == 6


def test_given_numbers_are_kept_and_used() -> None:
    given = replace(Tuning(), pid=PidTuning(kp=(1.0, 2.0, 3.0)))
    vessel = completed(ship(tuning=given, velocity_limits=(1.0, 1.0, 1.0)), 0.1)
    assert vessel.tuning.pid.kp == (1.0, 2.0, 3.0)
    assert vessel.velocity_limits == (1.0, 1.0, 1.0)
    assert vessel.tuning.pid.ki == completed(ship(), 0.1).tuning.pid.ki
    own = parameters_of("milliampere").tuning
    tuning = completed(ship(tuning=own), 0.1).tuning
    assert replace(tuning, current=replace(tuning.current, max_m_s=None)) == own


def test_what_is_not_given_is_estimated() -> None:
    """Length by the inertia within a third, limits by the length within a factor of five."""
    for name, length in (("milliampere", 5.0), ("modulus_ship", 1.25), ("beluga_diagonal", 0.8)):
        estimated = replace(parameters_of(name), length_m=None).scales.length_m
        assert length / 1.34 < estimated < length * 1.34, name
    for name in ("milliampere", "modulus_ship"):
        vessel = parameters_of(name)
        ratio = replace(vessel, force_limits=None).scales.limits / np.array(vessel.force_limits)
        assert np.all((ratio > 0.2) & (ratio < 5.0)), name


def test_attainable_speed_balances_the_drag() -> None:
    scales = ship().scales
    speed = np.diag(scales.speeds)
    drag = np.diag(ship().nominal().inverse(np.zeros((3, 3)), speed))
    assert drag[1] == pytest.approx(scales.limits[1], rel=1e-9)
    assert drag[0] < scales.limits[0]  # ahead and in yaw the hull speed is below
    assert drag[2] < scales.limits[2]
    hull = 0.4 * np.sqrt(9.81 * 5.0)
    np.testing.assert_allclose(scales.speeds[[0, 2]], [hull, hull / 2.5])


def test_a_vessel_without_enough() -> None:
    with pytest.raises(ConfigurationError, match="ship: expected force_limits or length_m, got ne"):
        completed(ship(force_limits=None, length_m=None), 0.1)
    with pytest.raises(ConfigurationError, match=r"length_m must be at least 0\.1 or null, got 0"):
        ship(length_m=0.0)


def test_one_axis_and_six() -> None:
    surge = VesselParameters("buoy", ("surge",), ((60.0,),), {"X_u": -20.0}, force_limits=(180.0,))
    tuning = completed(surge, 0.1).tuning
    assert tuning.windage is None
    assert tuning.excitation.yaw_moment_nm == 0.0
    assert len(tuning.pid.kp or ()) == 1
    six = completed(replace(parameters_of("beluga_full"), tuning=Tuning()), 0.1).tuning
    assert len(six.pid.kp or ()) == 6
    assert six.windage is None
