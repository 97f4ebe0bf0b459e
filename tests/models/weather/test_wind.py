"""The wind's convention, its force against the printed equations, and how it varies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import welch

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import PLANAR
from seatrial.models.vessel.kinematics import in_body
from seatrial.models.weather.noise import smoothed_levels
from seatrial.models.weather.wind import (
    BEAUFORT,
    NORSOK_BAND_HZ,
    Wind,
    Windage,
    gust_spectrum,
    gusts,
)

# Bargouth (2022), Table 2.3 and appendix C
SUPPLY = Windage(500.0, 1100.0, 73.2, 0.6, 0.8, 0.1, 1.23)


def wind(**changes: Any) -> Wind:
    options: dict[str, Any] = {
        "windage": SUPPLY, "speed_m_s": 10.0, "beaufort": None, "direction_deg": 0.0,
        "direction": "to", "variation": "constant", "direction_spread_deg": 60.0,
        "intensity": 0.15, "time_constant_s": 20.0, "height_m": 10.0, "file": None,
    }  # fmt: skip
    return Wind(**(options | changes))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def force_of(blowing: Wind, psi: float, nu: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """The force on a vessel of some heading [rad] and velocity; minus the share that it needs."""
    ned = blowing.realise(1, 1.0, rng())
    table = blowing.table(PLANAR)
    motion = np.array([[*nu, 0.0]])
    body = in_body(ned, np.array([psi]))
    return -table.inverse(np.zeros((1, 3)), motion, np.array([[0.0, 0.0, psi]]), body)[0]


def printed(speed: float, gamma: float) -> np.ndarray:
    """Bargouth (2022), eq. (2.2), written out."""
    factors = [0.6 * np.cos(gamma) * 500.0, 0.8 * np.sin(gamma) * 1100.0]
    factors.append(0.1 * np.sin(2.0 * gamma) * 1100.0 * 73.2)
    return 0.5 * 1.23 * speed**2 * np.array(factors)


def test_a_wind_comes_from_where_another_goes_to() -> None:
    coming = wind(direction="from", direction_deg=35.0)
    np.testing.assert_allclose(force_of(coming, 0.7), force_of(wind(direction_deg=215.0), 0.7))


@pytest.mark.parametrize("psi", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("beta", [0.0, 35.0, 120.0, 260.0])
def test_at_rest_the_force_is_the_printed_one(psi: float, beta: float) -> None:
    expected = printed(10.0, np.radians(beta) - psi)
    found = force_of(wind(direction_deg=beta), psi)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-8)


def test_a_vessel_that_keeps_up_with_the_wind_feels_none() -> None:
    np.testing.assert_allclose(force_of(wind(), 0.0, (10.0, 0.0)), 0.0, atol=1e-9)
    np.testing.assert_allclose(force_of(wind(), 0.0, (20.0, 0.0)), -printed(10.0, 0.0), atol=1e-9)


def test_the_wind_scale_is_the_printed_one() -> None:
    """Bargouth (2022), Table 2.1; the middle of its class blows. The last has no upper bound."""
    printed = "0.5 1.8 1.9 3.3 3.4 5.4 5.5 7.9 8.0 11.0 11.1 14.1 14.2 17.2 17.3 20.8 20.9 24.4 "
    printed += "24.5 28.5 28.6 32.6 32.6 32.6"
    assert np.ravel(BEAUFORT).tolist() == [float(one) for one in printed.split()]
    for beaufort, bounds in enumerate(BEAUFORT, start=1):
        blowing = wind(beaufort=beaufort).realise(3, 1.0, rng())
        np.testing.assert_allclose(blowing, [[np.mean(bounds), 0.0]] * 3)


def test_gusts_have_their_deviation_and_time_constant() -> None:
    blowing = wind(variation="gusting", intensity=0.1).realise(200_000, 1.0, rng())
    speed = blowing[:, 0]
    assert np.mean(speed) == pytest.approx(10.0, abs=0.1)
    assert np.std(speed) == pytest.approx(1.0, rel=0.05)
    ahead = np.corrcoef(speed[:-20], speed[20:])[0, 1]
    assert ahead == pytest.approx(np.exp(-1.0), abs=0.03)


def test_slow_wind_is_the_smoothed_steps_of_the_source() -> None:
    levels = smoothed_levels(1200, rng(3))
    drawn = rng(3).random(4)
    assert levels[0] == pytest.approx(drawn[0])  # the window shrinks to nothing at the ends
    assert levels[-1] == pytest.approx(drawn[3])
    span = slice(600 - 299, 600 + 300)
    assert levels[600] == pytest.approx(np.mean(np.repeat(drawn, 300)[span]))
    speeds = [np.hypot(*wind(variation="slow").realise(400, 1.0, rng(s)).T) for s in range(400)]
    assert np.mean(speeds) == pytest.approx(10.0, rel=0.05)
    assert np.max(speeds) < 20.0


def test_the_gust_spectrum_is_realised() -> None:
    f = np.linspace(*NORSOK_BAND_HZ, 200_001)
    expected = np.trapezoid(gust_spectrum(f, 15.0, 10.0), f)
    realised = [gusts(8192, 1.0, 15.0, 10.0, rng(seed)) for seed in range(40)]
    assert np.mean([np.var(one) for one in realised]) == pytest.approx(expected, rel=0.05)
    densities = [welch(one, 1.0, nperseg=2048) for one in realised]
    band = (densities[0][0] > 0.02) & (densities[0][0] < 0.4)
    mean = np.mean([density for _, density in densities], axis=0)[band]
    asked = gust_spectrum(densities[0][0][band], 15.0, 10.0)
    assert np.mean(mean / asked) == pytest.approx(1.0, abs=0.05)


def test_the_spectrum_is_the_published_one() -> None:
    # by hand at z = 10 m, U = 10 m/s: x = 172 f, S(0) = 320
    assert gust_spectrum(np.array([0.0]), 10.0, 10.0)[0] == pytest.approx(320.0)
    x = 1.72**0.468
    by_hand = 320.0 / (1.0 + x) ** (5.0 / 1.404)
    assert gust_spectrum(np.array([0.01]), 10.0, 10.0)[0] == pytest.approx(by_hand)


def test_a_recorded_wind_is_interpolated_without_turning_round(tmp_path: Path) -> None:
    path = tmp_path / "wind.csv"
    path.write_text("t,speed,direction\n0,10,350\n10,10,10\n")
    blowing = wind(variation="file", file=str(path)).realise(11, 1.0, rng())
    np.testing.assert_allclose(blowing[5], [10.0 * np.cos(np.radians(10.0)), 0.0], atol=1e-9)
    first = 10.0 * np.array([np.cos(6.10865), np.sin(6.10865)])
    np.testing.assert_allclose(blowing[0], first, rtol=1e-4)
    with pytest.raises(ConfigurationError, match="cover 0 to 20 s"):
        wind(variation="file", file=str(path)).realise(21, 1.0, rng())
    path.write_text("t,speed\n0,10\n")
    with pytest.raises(RecordingError, match="no column 'direction'"):
        wind(variation="file", file=str(path)).realise(2, 1.0, rng())


@pytest.mark.parametrize(
    "changes",
    [
        {"beaufort": 0}, {"beaufort": 13}, {"speed_m_s": -1.0}, {"intensity": -0.1},
        {"time_constant_s": 0.0}, {"height_m": 0.0}, {"variation": "file"}, {"file": "x.csv"},
    ],
)  # fmt: skip
def test_wrong_options_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=f"{next(iter(changes))}|file"):
        wind(**changes)


def test_wind_needs_a_vessel_in_the_plane() -> None:
    with pytest.raises(ConfigurationError, match=r"disturbance\.wind needs"):
        wind().check(("surge",))
    with pytest.raises(ConfigurationError, match=r"disturbance\.wind\.windage: got null"):
        wind(windage=None).check(PLANAR)
