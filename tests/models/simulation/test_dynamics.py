"""Motion in wind and current against laws."""

from typing import Any

import numpy as np

from seatrial.models.control.pid import PidFeedforward
from seatrial.models.excitation.guidance import ReferenceFilter
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Voyage, recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.kinematics import in_body
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather
from seatrial.models.weather.wind import Windage

PERIOD_S = 0.1
FILTER = ReferenceFilter(0.5, 0.7)
STREAM = np.array([0.4, -0.7])


def push(plant: Vessel, weather: Weather, seconds: float, force: Array, **options: Any) -> Voyage:
    """A vessel under a force that is constant in NED (along the axes where there is no heading)."""
    n, n_dof = round(seconds / PERIOD_S), len(plant.dofs)
    weather = weather._replace(force_ned=np.tile(force, (n, 1)))
    same = (0.0,) * n_dof
    pid = PidFeedforward(same, same, same, feedback=True, feedforward=False)
    return sail(
        Plant(plant, None, (50.0,) * n_dof), weather,
        (Timetable(np.zeros((n, n_dof))), np.zeros(1)), FILTER.table(PERIOD_S),
        pid.build(plant, PERIOD_S), np.zeros(n_dof), PERIOD_S, 0.05, **options,
    )  # fmt: skip


def still(seconds: float, n_dof: int = 3) -> Weather:
    n = round(seconds / PERIOD_S)
    return Weather(*(np.zeros((n, n_dof)) for _ in range(4)))


def stream(seconds: float, velocity: Array = STREAM) -> Weather:
    weather = still(seconds)
    return weather._replace(current_ned=np.tile(velocity, (len(weather.force_ned), 1)))


def test_in_a_uniform_current_a_vessel_moves_as_in_still_water_seen_from_the_water(
    milliampere: Vessel,
) -> None:
    """Galileo: a force, a turn and a stream, against no stream, from rest in the water."""
    force = np.array([150.0, 40.0, 90.0])
    calm = push(milliampere, still(120.0), 120.0, force)
    adrift = push(milliampere, stream(120.0), 120.0, force, start_nu=np.array([*STREAM, 0.0]))
    drift = adrift.t[:, None] * STREAM
    np.testing.assert_allclose(adrift.log.eta[:, :2] - drift, calm.log.eta[:, :2], atol=1e-6)
    np.testing.assert_allclose(adrift.log.eta[:, 2], calm.log.eta[:, 2], atol=1e-8)
    assert abs(calm.log.eta[-1, 2]) > 1.0  # it turns


def test_a_vessel_adrift_ends_up_at_the_speed_of_the_water(milliampere: Vessel) -> None:
    voyage = push(milliampere, stream(4000.0), 4000.0, np.zeros(3))
    nu, psi = voyage.log.nu[-1], voyage.log.eta[-1, 2]
    np.testing.assert_allclose(nu[:2], in_body(STREAM[None], np.array([psi]))[0], atol=1e-2)


def test_a_table_without_coriolis_forces_is_not_turned_with_the_stream() -> None:
    """Bargouth (2022), (2.24): the stream enters through the drag alone."""
    inertia = np.diag([10.0, 20.0, 30.0])
    plain = from_derivatives("plain", PLANAR, inertia, {}, with_coriolis=False)
    voyage = push(plain, stream(20.0), 20.0, np.array([0.0, 0.0, 5.0]))
    np.testing.assert_array_equal(voyage.log.nu[:, :2], 0.0)
    assert abs(voyage.log.nu[-1, 2]) > 1.0


def test_current_meets_a_surge_vessel_along_its_axis() -> None:
    vessel = from_derivatives("surge", ("surge",), np.array([[60.0]]), {"X_u": -20.0})
    n = 2000
    weather = Weather(*(np.zeros((n, 1)) for _ in range(4)), current_ned=np.tile(STREAM, (n, 1)))
    voyage = push(vessel, weather, 200.0, np.zeros(1))
    exact = STREAM[0] * (1.0 - np.exp(-voyage.t / 3.0))
    np.testing.assert_allclose(voyage.log.nu[:, 0], exact, atol=1e-8)


def test_an_anemometer_sees_the_wind_in_body_axes(milliampere: Vessel) -> None:
    windage = Windage(4.2, 7.5, 5.0, 0.6, 0.8, 0.1, 1.23)
    plant = 0.5 * milliampere + windage.table(PLANAR)
    weather = still(30.0)._replace(wind_ned=np.tile([6.0, -3.0], (300, 1)))
    voyage = push(plant, weather, 30.0, np.array([0.0, 0.0, 200.0]))
    recording = recording_of(voyage, weather)
    assert recording.wind is not None
    np.testing.assert_allclose(np.hypot(*recording.wind.T), np.hypot(6.0, 3.0))
    residual = plant.inverse(recording.nu_dot, recording.nu, recording.attitude, recording.wind)
    np.testing.assert_allclose(residual, np.tile([0.0, 0.0, 200.0], (300, 1)), atol=1e-8)
    assert recording_of(push(plant, still(3.0), 3.0, np.zeros(3)), still(3.0)).wind is None
