"""Motion in wind and current against laws."""

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.kinematics import frame_of_angles
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather
from seatrial.models.weather.wind import Windage
from tests.models.control.sailing import drift, weather

STREAM = np.array([0.4, -0.7])


def constant(seconds: float, n_dof: int, **parts: Array) -> Weather:
    """Parts of the weather that do not change, at 10 Hz."""
    n = round(10.0 * seconds)
    return weather(n, n_dof, **{name: np.tile(part, (n, 1)) for name, part in parts.items()})


@pytest.mark.parametrize(
    ("name", "force"), [("milliampere", (150.0, 40.0, 90.0)), ("beluga_full", (0.0,) * 6)]
)
def test_in_a_uniform_current_a_vessel_moves_as_in_still_water_seen_from_the_water(
    name: str, force: tuple[float, ...]
) -> None:
    """Galileo: a force and a turn in a stream, against no stream, from one motion in the water."""
    vessel = parameters_of(name).nominal()
    axes = [DOFS.index(dof) for dof in vessel.dofs]
    pose = np.isin(range(6), axes) * np.array([0.0, 0.0, 0.0, 0.5, -0.4, 2.0])
    nu, frame = np.array([0.5, 0.1, -0.2, 0.3, 0.4, -0.5]), np.empty((3, 3))
    frame_of_angles(pose[3:], frame)
    logs = []
    for water in (np.zeros(2), STREAM):
        carried = nu.copy()
        carried[:3] += frame.T @ [*water, 0.0]
        met = constant(30.0, len(axes), force_ned=np.array(force), current_ned=water)
        voyage = drift(vessel, met, start=pose[axes], start_nu=carried[axes])
        logs.append(voyage.log.eta)
    calm, adrift = logs
    moved = adrift[:, :2] - voyage.t[:, None] * STREAM
    np.testing.assert_allclose(moved, calm[:, :2], atol=1e-5)
    np.testing.assert_allclose(adrift[:, 2:], calm[:, 2:], atol=1e-5)
    assert np.ptp(calm[:, -1]) > 0.3  # it turns


def test_a_table_without_coriolis_forces_is_not_turned_with_the_stream() -> None:
    """Bargouth (2022), (2.24): the stream enters through the drag alone."""
    inertia = np.diag([10.0, 20.0, 30.0])
    plain = from_derivatives("plain", PLANAR, inertia, {}, with_coriolis=False)
    moment = np.array([0.0, 0.0, 5.0])
    log = drift(plain, constant(20.0, 3, force_ned=moment, current_ned=STREAM)).log
    np.testing.assert_array_equal(log.nu[:, :2], 0.0)
    assert abs(log.nu[-1, 2]) > 1.0


def test_current_meets_a_surge_vessel_along_its_axis() -> None:
    vessel = from_derivatives("surge", ("surge",), np.array([[60.0]]), {"X_u": -20.0})
    voyage = drift(vessel, constant(200.0, 1, current_ned=STREAM))
    exact = STREAM[0] * (1.0 - np.exp(-voyage.t / 3.0))
    np.testing.assert_allclose(voyage.log.nu[:, 0], exact, atol=1e-8)


def test_an_anemometer_sees_the_wind_in_body_axes(milliampere: Vessel) -> None:
    windage = Windage(4.2, 7.5, 5.0, 0.6, 0.8, 0.1, 1.23)
    plant, moment = 0.5 * milliampere + windage.table(PLANAR), np.array([0.0, 0.0, 200.0])
    windy = constant(30.0, 3, force_ned=moment, wind_ned=np.array([6.0, -3.0]))
    recording = recording_of(drift(plant, windy), windy)
    assert recording.wind is not None
    np.testing.assert_allclose(np.hypot(*recording.wind.T), np.hypot(6.0, 3.0))
    residual = plant.inverse(recording.nu_dot, recording.nu, recording.attitude, recording.wind)
    np.testing.assert_allclose(residual, np.tile(moment, (300, 1)), atol=1e-8)
    assert recording_of(drift(plant, weather(30)), weather(30)).wind is None
