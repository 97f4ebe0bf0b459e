"""A supply vessel's step test in another simulator (PythonVehicleSimulator, `supply`).

Its published model is vessel=supply_fossen, M nu_dot + D nu = tau without Coriolis forces. The file
does not say what was commanded. In the steady turn at its end D nu = tau, which gives a surge force
and a yaw moment (and no sway force, as of two main propellers); the propellers' speed follows its
command with the published time constant of 1 s, hence their thrust as (1 - exp(-t))^2. Two numbers
are taken from the last rows; the other 178 are compared.
"""

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.excitation.commands import Piece, command
from seatrial.models.excitation.guidance import ReferenceFilter
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.vessel.parameters import Plant
from seatrial.models.weather.weather import Weather
from tests.data import DATA

PERIOD_S = 0.1


def recorded() -> dict[str, np.ndarray]:
    path = DATA / "pvs" / "pvs_supply_step_test.csv"
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


@pytest.mark.data
def test_a_coefficient_table_sails_the_same_track() -> None:
    data = recorded()
    np.testing.assert_array_equal(data["t"], 10.0 * np.arange(31))
    vessel = parameters_of("supply_fossen").nominal()
    motion = np.array([data[name] for name in "uvr"]).T
    rate = (motion[-1] - motion[-2]) / 10.0  # surge is not quite steady yet
    middle = 0.5 * (motion[-1] + motion[-2])
    (steady,) = vessel.inverse(rate[None], middle[None])
    assert abs(steady[1]) < 1e-3 * steady[0]
    t = PERIOD_S * np.arange(3001)
    rise = (1.0 - np.exp(-t - 0.5 * PERIOD_S)) ** 2  # held over a period: the value in its middle
    force = np.outer(rise, [steady[0], 0.0, steady[2]])
    weather = Weather(*(np.zeros((len(t), 3)) for _ in range(4)))
    voyage = sail(
        Plant(vessel, None, (20.0, 20.0, 1.0)), weather,
        (Timetable(np.zeros((len(t), 3))), np.zeros(1)), ReferenceFilter(0.5, 0.7).table(PERIOD_S),
        command([Piece()], np.zeros(3), 0, 0), np.zeros(3), PERIOD_S, PERIOD_S, added=force,
    )  # fmt: skip
    rows = slice(None, None, 100)
    eta, nu = voyage.log.eta[rows], voyage.log.nu[rows]
    assert np.all(np.max(np.abs(nu - motion), axis=0) < [5e-3, 2e-5, 5e-6])
    np.testing.assert_allclose(eta[:, 2], data["psi"], atol=1e-3)
    track = np.array([data["N"], data["E"]]).T
    travelled = np.sum(np.hypot(*np.diff(track, axis=0).T))
    assert travelled == pytest.approx(2110.0, rel=0.01)
    assert np.max(np.hypot(*(eta[:, :2] - track).T)) < 1.0  # of two kilometres
