"""Current, waves and process noise: their statistics and limits."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import welch

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.weather.current import Current
from seatrial.models.weather.disturbance import ConstantForce, Disturbance
from seatrial.models.weather.noise import MeasurementNoise, ProcessNoise, gauss_markov
from seatrial.models.weather.waves import Waves
from seatrial.models.weather.weather import Force


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_constant_current_sets_to_its_direction() -> None:
    velocity = Current(0.5, 90.0, "constant", 0.1, 600.0, 1.0).realise(3, 1.0, rng())
    np.testing.assert_allclose(velocity, [[0.0, 0.5]] * 3, atol=1e-12)


def test_a_slow_current_varies_about_its_mean() -> None:
    velocity = Current(0.3, 0.0, "slow", 0.05, 60.0, 5.0).realise(400_000, 1.0, rng())
    np.testing.assert_allclose(velocity.mean(axis=0), [0.3, 0.0], atol=0.005)
    np.testing.assert_allclose(velocity.std(axis=0), 0.05, rtol=0.05)
    assert np.max(np.abs(np.diff(velocity, axis=0))) < 0.06
    for column in velocity.T:
        assert np.corrcoef(column[:-60], column[60:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.03)


def test_the_yaw_moment_of_a_slow_current() -> None:
    """(2.9) with a time constant: zero mean, its deviation and memory, beside the same stream."""
    streams = [
        Disturbance(current=Current(0.3, 0.0, "slow", 0.05, 60.0, 5.0, deviation)).realise(
            400_000, PLANAR, rng(), rng(1), 1.0
        )
        for deviation in (0.0, 2e5)
    ]
    np.testing.assert_array_equal(streams[1].current_ned, streams[0].current_ned)
    assert not np.any(streams[0].force_ned)
    assert not np.any(streams[1].force_ned[:, :2])
    moment = streams[1].force_ned[:, 2]
    # the mean and the deviation of 400,000 / 120 independent values, to four standard errors
    assert abs(np.mean(moment)) < 4.0 * 2e5 * np.sqrt(120.0 / len(moment))
    assert np.std(moment) == pytest.approx(2e5, rel=4.0 * np.sqrt(0.5 * 60.0 / len(moment)))
    for lag in (30, 60, 120):
        correlation = np.corrcoef(moment[:-lag], moment[lag:])[0, 1]
        assert correlation == pytest.approx(np.exp(-lag / 60.0), abs=0.04)
    for velocity in streams[1].current_ned.T:
        assert abs(np.corrcoef(velocity, moment)[0, 1]) < 0.07


def test_a_yaw_moment_needs_a_vessel_that_turns() -> None:
    current = Current(0.3, 0.0, "slow", 0.05, 60.0, 5.0, 2e5)
    Disturbance(current=current).check(PLANAR)
    with pytest.raises(ConfigurationError, match="moment_deviation_nm: got 200000, expected 0"):
        Disturbance(current=current).check(("surge",))
    for variation in ("constant", "white"):
        with pytest.raises(ConfigurationError, match="moment_deviation_nm: got 200000 with"):
            replace(current, variation=variation)


@pytest.mark.parametrize("variation", ["slow", "constant"])
def test_a_current_stays_below_its_limit(variation: Any) -> None:
    velocity = Current(0.9, 0.0, variation, 0.5, 60.0, 1.0).realise(10_000, 1.0, rng())
    assert np.max(np.hypot(*velocity.T)) <= 1.0 + 1e-12


def test_the_white_current_of_the_source() -> None:
    velocity = Current(0.0, 0.0, "white", 0.0, 60.0, 10.0).realise(20_000, 1.0, rng())
    np.testing.assert_allclose(velocity.mean(axis=0), 5.0, atol=0.1)
    assert velocity.min() >= 0.0
    assert velocity.max() <= 10.0
    assert abs(np.corrcoef(velocity[:-1, 0], velocity[1:, 0])[0, 1]) < 0.03


def test_waves_have_their_deviation_and_fossens_spectrum() -> None:
    """S(w) = (K w)^2 / ((w0^2 - w^2)^2 + (2 lambda w0 w)^2), sigma^2 = K^2 / (4 lambda w0)."""
    period, w0, damping, size = 0.25, 2 * np.pi / 8.0, 0.1, [0.2, 0.2, np.radians(2.0)]
    motion = Waves(0.2, 2.0, 8.0, damping).realise(400_000, period, rng()) / size
    np.testing.assert_allclose(motion.std(axis=0), 1.0, rtol=0.05)
    np.testing.assert_allclose(motion.mean(axis=0), 0.0, atol=0.025)
    assert np.max(np.abs(np.corrcoef(motion.T) - np.eye(3))) < 0.05
    for column in motion.T:
        f, density = welch(column, 1.0 / period, nperseg=2048)
        w = 2 * np.pi * f
        resonance = (w0**2 - w**2) ** 2 + (2 * damping * w0 * w) ** 2
        two_sided = 4 * damping * w0 * w**2 / resonance
        band = (f > 0.08) & (f < 0.3)
        assert np.mean(density[band] / (2 * two_sided[band])) == pytest.approx(1.0, abs=0.05)
        assert f[np.argmax(density)] == pytest.approx(1.0 / 8.0, rel=0.1)


def test_sampling_does_not_change_a_process() -> None:
    system = np.array([[-1.0 / 5.0]])
    for period in (0.1, 1.0, 10.0):
        x = gauss_markov(200_000, period, system, np.array([[2.0]]), rng())[:, 0]
        assert np.std(x) == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(("distribution", "deviation"), [("normal", 1.0), ("uniform", 3**-0.5)])
def test_process_noise_has_no_mean(distribution: Any, deviation: float) -> None:
    size = np.array([1e-4, 2e-4, 5e-7])
    drawn = ProcessNoise(tuple(size), distribution).realise(50_000, rng())
    np.testing.assert_allclose(drawn.mean(axis=0) / size, 0.0, atol=0.02)
    np.testing.assert_allclose(drawn.std(axis=0) / size, deviation, rtol=0.02)
    if distribution == "uniform":
        assert np.all(np.abs(drawn) <= size)


def test_what_does_not_suit_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"disturbance\.waves needs"):
        Waves(0.1, 1.0, 6.0, 0.1).check(("surge",))
    with pytest.raises(ConfigurationError, match=r"process\.size: got 1 numbers, expected 3"):
        ProcessNoise((1.0,), "normal").check(PLANAR)


def test_numbers_that_no_sea_has_are_refused() -> None:
    current, waves = Current(0.3, 0.0, "slow", 0.05, 60.0, 1.0), Waves(0.2, 2.0, 8.0, 0.1)
    for part, name, value in (
        (current, "speed_m_s", 2.0), (current, "max_m_s", 0.0), (current, "time_constant_s", 0.0),
        (waves, "damping", 0.0), (waves, "peak_period_s", 0.0), (waves, "position_m", -1.0),
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=f"{name} must"):
            replace(part, **{name: value})


@dataclass(frozen=True)
class Gusts(Force):
    """White forces: a part from outside."""

    size: float

    def realise(self, n, dofs, period_s, rng) -> np.ndarray:
        return self.size * rng.standard_normal((n, len(dofs)))


def test_a_part_of_ones_own_leaves_the_others_as_they_are() -> None:
    named = {
        "noise": MeasurementNoise(0.1, 1.0, 0.1, 1.0, 0.1, 1.0),
        "force": ConstantForce(30.0, -20.0, 5.0),
        "current": Current(0.3, 0.0, "slow", 0.05, 60.0, 5.0),
        "waves": Waves(0.2, 2.0, 8.0, 0.1),
    }
    plain, more = (
        Disturbance(**named, others=others).realise(500, PLANAR, rng(1), rng(2), 0.5)
        for others in (
            None,
            {"gusts": Gusts(10.0), "flood": Current(1.0, 90.0, "constant", 0.0, 1.0, 2.0)},
        )
    )
    for name in ("pose_noise", "velocity_noise", "acceleration_noise", "wave_motion"):
        np.testing.assert_array_equal(getattr(more, name), getattr(plain, name))
    np.testing.assert_array_equal(plain.force_ned, np.tile([30.0, -20.0, 5.0], (500, 1)))
    assert np.std(more.force_ned - plain.force_ned, axis=0) == pytest.approx(10.0, rel=0.15)
    expected = np.tile([0.0, 1.0], (500, 1))
    np.testing.assert_allclose(more.current_ned - plain.current_ned, expected, atol=1e-12)
