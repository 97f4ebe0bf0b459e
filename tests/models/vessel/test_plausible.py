"""Numbers of vessels and devices: what is out of range, and motions that nothing resists."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ROLLING
from seatrial.models.vessel.derivation import derived
from seatrial.models.vessel.derivatives import Prime
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.thruster import Input
from seatrial.models.weather.wind import Windage
from tests.models.conftest import configured, ferry


def tanker() -> VesselParameters:
    vessel: VesselParameters = configured("vessel", "kvlcc2")
    return vessel


def tuning(vessel: VesselParameters) -> Any:
    return derived(vessel, 0.1)["tuning"]


DEVICES = {  # device of kvlcc2, a number in another unit or of another meaning, what is expected
    "rudder": [("x_R", -3.5, "-0.6 to 0"), ("neutral_rad", 2.0, "-0.2 to 0.2 rad")],
    "propeller": [("t_P", 22.0, "0 to 0.5"), ("rho_kg_m3", 1.025, "900 to 1100 kg/m^3")],
}


@pytest.mark.parametrize("device", DEVICES)
def test_a_number_of_a_device_lies_in_its_range(device: str) -> None:
    for name, value, expected in DEVICES[device]:
        for wrong in (value, np.nan, np.inf):
            with pytest.raises(ConfigurationError, match=re.escape(f"expected {expected}")):
                replace(tanker().devices[device], **{name: wrong})


def test_an_input_in_degrees_is_no_angle_in_radians() -> None:
    ship = tanker()
    with pytest.raises(ConfigurationError, match=r"inputs.delta.high: got 35.* in degrees\?$"):
        replace(ship, inputs=ship.inputs | {"delta": Input(-0.6, 35.0)})
    with pytest.raises(ConfigurationError, match=r"rho_kg_m3 must be at least 900.0, got 1.025"):
        Prime(7.0, rho_kg_m3=1.025)


def test_a_motion_that_nothing_resists_is_named() -> None:
    assert ferry().undamped == () == tanker().undamped
    given = ferry().derivatives
    free = {name: given[name] for name in given if name[0] != "Y" or "dot" in name}
    assert replace(ferry(), derivatives=free).undamped == ("sway",)


def test_the_largest_current_grows_with_the_ship() -> None:
    """What is derived never meets a constant that does not grow with it."""
    vessels = ferry(), configured("vessel", "kvlcc2_full")
    speeds: list[Any] = [tuning(vessel).current for vessel in vessels]
    assert speeds[0].max_m_s == 1.0 < speeds[1].max_m_s
    assert speeds[1].max_m_s == pytest.approx(2.0 * speeds[1].speed_m_s, rel=1e-3)


def test_wind_heels_a_ship_by_the_arm_of_its_lateral_area() -> None:
    """A beam wind gives K = Y A / (2 L), and no heel where the lateral area is none."""
    windage = Windage(10.0, 40.0, 20.0, 0.6, 0.8, 0.1, 1.23)
    beam = np.array([[0.0, 7.0]])
    still = np.zeros((1, 4))
    force = -windage.table(ROLLING).inverse(still, still, wind=beam)[0]
    assert force[2] == pytest.approx(force[1] * 40.0 / 20.0 / 2.0)
    assert force[1] == pytest.approx(0.5 * 1.23 * 0.8 * 40.0 * 7.0**2)
