"""The force that standing still takes, against the source's formula."""

import numpy as np
import pytest

from seatrial.models.control.linear_design import largest_disturbance
from seatrial.models.notation import PLANAR
from seatrial.models.vessel.derivatives import from_derivatives
from tests.models.control.sailing import LIMITS, WINDAGE, ship, steady, weather

BEAM = 0.5 * 1.23 * 0.8 * 1100.0 * 20.0**2  # d2 V^2, Bargouth (2022), (2.6)


def plant() -> object:
    return ship() + WINDAGE.table(PLANAR)


def test_the_beam_wind_at_20_m_s_is_above_the_sources_limit() -> None:
    met = weather(50, wind_ned=steady(50, 20.0, np.pi / 2))
    needed = largest_disturbance(plant(), met, np.zeros(50))
    assert needed[1] == pytest.approx(BEAM)
    assert needed[1] == pytest.approx(2.16e5, rel=0.01)
    assert 1e5 < needed[1] < LIMITS[1]
    assert needed[0] == pytest.approx(0.0, abs=1e-6)


def test_an_unknown_heading_is_taken_as_the_worst() -> None:
    met = weather(5, wind_ned=steady(5, 20.0, 0.3))
    worst = largest_disturbance(plant(), met, np.zeros(0))
    assert worst[1] == pytest.approx(BEAM, rel=1e-2)
    for psi in (0.0, 1.0, 3.0):
        here = largest_disturbance(plant(), met, np.full(5, psi))
        assert np.all(here <= worst * (1 + 1e-2))


def test_current_and_given_forces_count() -> None:
    current, force = np.tile([0.0, -0.8], (4, 1)), np.tile([0.0, 5e4, 0.0], (4, 1))
    met = weather(4, current_ned=current, force_ned=force)
    needed = largest_disturbance(plant(), met, np.zeros(4))
    assert needed[1] == pytest.approx(22e4 * 0.64 - 5e4)
    assert needed[2] == pytest.approx(6.6e5 * 0.64)


def test_a_vessel_of_one_axis_meets_what_is_along_it() -> None:
    surge = from_derivatives("surge", ("surge",), np.array([[60.0]]), {"X_u": -20.0})
    met = weather(4, 1, current_ned=np.tile([0.5, 3.0], (4, 1)), force_ned=np.full((4, 1), -7.0))
    assert largest_disturbance(surge, met, np.zeros(0)) == pytest.approx([3.0])
