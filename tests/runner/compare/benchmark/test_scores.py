"""Scores of predictions, from a stored series."""

import numpy as np
import pytest

from seatrial.runner.compare.benchmark import (
    AT_REST,
    MEAN_MOTION,
    NOTHING,
    PERSISTENCE,
    POSITION,
    chance,
    interval,
    pooled,
    score,
)
from seatrial.runner.record.rows import Series
from tests.runner.compare.stored import series as stored_series

N = 2000
PAIRS = ((0, 0.1), (1, 0.2), (2, 0.3))  # seed and noise of pooled series


def series(noise: float, seed: int = 0) -> Series:
    """Two pieces of a surge velocity, a free run with white errors, and predictions over 10 s."""
    rng = np.random.default_rng(seed)
    u = 2.0 + np.sin(0.01 * np.arange(N))
    after = np.where(np.arange(N) % 100 == 99, u + 0.1, np.nan)
    columns = {
        "t": 0.1 * np.arange(N),
        "start": 1.0 * (np.arange(N) % 1000 == 0),
        "surge": u,
        "surge_identified": u + noise * rng.standard_normal(N),
        "surge_nominal": np.where(np.arange(N) < 1500, u, np.nan),
        "surge_identified_10s": after,
    }
    return stored_series("prediction", columns)


def test_errors_are_relative_to_the_spread_of_what_was_measured() -> None:
    stored = series(0.2)
    spread = np.std(stored.columns["surge"])
    result, after = (score(stored, "identified", ("surge",), s) for s in (None, 10.0))
    assert result.loss == pytest.approx(0.2 / spread, rel=0.05)
    assert after.loss == pytest.approx(0.1 / spread)
    assert [len(piece) for piece in result.pieces()] == [1000, 1000]


def test_references() -> None:
    stored = series(0.2)
    u, ends = stored.columns["surge"], np.arange(N) % 100 == 99
    held = np.repeat([u[0], u[1000]], 1000)
    for model, free, over_10_s in (
        (MEAN_MOTION, u.mean(), u.mean()),
        (PERSISTENCE, held, u[np.flatnonzero(ends) - 100]),
    ):
        found, after = (score(stored, model, ("surge",), seconds) for seconds in (None, 10.0))
        assert found.loss == pytest.approx(np.sqrt(np.mean((free - u) ** 2)) / np.std(u))
        expected = np.sqrt(np.mean((over_10_s - u[ends]) ** 2)) / np.std(u)
        assert after.loss == pytest.approx(expected)
    assert score(stored, AT_REST, ("surge",)).loss == np.inf  # it has a position only


def test_pooled_scores_weigh_samples_alike_and_lie_in_their_interval() -> None:
    scores = [score(series(noise, seed), "identified", ("surge",)) for seed, noise in PAIRS]
    squares = [np.square(one.loss) for one in scores]
    assert pooled(scores)[0] == pytest.approx(np.sqrt(np.mean(squares)))
    low, high = interval(scores)
    assert low < pooled(scores)[0] < high


def test_what_diverges_or_is_not_stored_is_infinitely_bad() -> None:
    stored = series(0.2)
    assert score(stored, "nominal", ("surge",)).loss == np.inf
    assert score(stored, "plant", ("surge",), 10.0).loss == np.inf


def test_the_interval_holds_the_error_as_often_as_it_says() -> None:
    """Errors are white: on either side 1.645 standard errors, sigma / sqrt(2 N)."""
    error = 0.2 / np.std(series(0.0).columns["surge"])
    scores = [score(series(0.2, seed), "identified", ("surge",)) for seed in range(40)]
    low, high = np.transpose([interval([result]) for result in scores])
    assert 30 <= np.sum((low <= error) & (error <= high)) <= 40
    assert np.mean(high - low) == pytest.approx(2.0 * 1.645 * error / np.sqrt(2.0 * N), rel=0.12)


def test_equal_entrants_are_told_apart_seldom_and_a_better_one_always() -> None:
    wrong, right = 0, 0
    for seed in range(60):
        own, other, worse = (
            score(series(noise, seed + shift), "identified", ("surge",))
            for noise, shift in ((0.2, 0), (0.2, 1000), (0.24, 2000))
        )
        wrong += chance([own], [other]) < 0.05
        right += chance([own], [worse]) < 0.05
    assert wrong <= 0.05 * 60 + 3.0 * np.sqrt(60 * 0.05 * 0.95)
    assert right >= 55


def test_one_that_diverges_differs_from_one_that_does_not() -> None:
    own, lost = (score(series(0.2), model, ("surge",)) for model in ("identified", "nominal"))
    assert chance([own], [lost]) == 0.0
    assert chance([lost], [lost]) == 1.0
    assert chance([own, NOTHING], [lost, own]) == 0.0  # each lost another file
    assert chance([own], [own]) == 1.0


def test_position_after_a_time_is_a_distance() -> None:
    """A ship that drifts to starboard, predicted 0.3 m too far north and 0.4 m too far east."""
    t = np.arange(0.0, 20.0, 0.5)
    x, y = (2.0 * np.cos(0.7) - 0.5 * np.sin(0.7)) * t, (2.0 * np.sin(0.7) + 0.5 * np.cos(0.7)) * t
    known = {"t": t, "x": x, "y": y, "psi": 0.7 + 0.0 * t}
    known |= {"surge": 2.0 + 0.0 * t, "sway": 0.5 + 0.0 * t, "start": t % 10.0 == 0.0}
    reached = np.where(t >= 5.0, 0.0, np.nan)
    for model, north, east in (("nominal", 0.0, 1.0), ("identified", 0.3, 0.4)):
        known |= {f"x_{model}_5s": x + north + reached, f"y_{model}_5s": y + east + reached}
    series = stored_series("prediction", known)
    own = score(series, "identified", POSITION, 5.0)
    assert own.loss == pytest.approx(0.5)
    assert [len(piece) for piece in own.pieces()] == [10, 20]
    assert score(series, "nominal", POSITION, 5.0).loss == pytest.approx(1.0)
    assert score(series, PERSISTENCE, POSITION, 5.0).loss == pytest.approx(0.0, abs=1e-9)
    assert score(series, MEAN_MOTION, POSITION, 5.0).loss == pytest.approx(0.0, abs=1e-9)
    at_rest = score(series, AT_REST, POSITION, 5.0)
    assert at_rest.loss == pytest.approx(5.0 * np.hypot(2.0, 0.5))
    absent = score(series, "plant", POSITION, 5.0)
    assert absent.loss == np.inf
    assert chance([own], [score(series, "nominal", POSITION, 5.0)]) < 0.05
    assert chance([own], [absent]) == 0.0


def banded(noise: float, deviation: float) -> Series:
    """The same series with a band of a given deviation about the free run."""
    stored = series(noise)
    known = stored.columns | {"surge_identified_std": np.full(N, deviation)}
    return stored_series("prediction", known)


def test_a_band_of_the_right_size_holds_nine_tenths_and_has_the_best_crps() -> None:
    """A narrower or wider one has a larger CRPS, and so has none: the score is proper."""
    found = {}
    for size in (0.05, 0.2, 0.8):
        result = score(banded(0.2, size), "identified", ("surge",))
        assert len(result.covered) == N - 2  # the two starts are left out
        found[size] = (np.mean(result.covered), np.mean(result.crps))
    assert found[0.2][0] == pytest.approx(0.9, abs=0.02)
    assert found[0.05][0] < 0.5 < 0.99 < found[0.8][0]
    assert found[0.2][1] < min(found[0.05][1], found[0.8][1])
    without = score(series(0.2), "identified", ("surge",))
    assert without.covered is None
    assert np.mean(without.crps) > found[0.2][1]
    assert score(banded(0.2, 0.2), MEAN_MOTION, ("surge",)).covered is None
