"""Scores of predictions, from a stored series."""

import numpy as np
import pytest

from seatrial.runner.compare.benchmark.scores import MEAN_MOTION, PERSISTENCE, interval, score
from seatrial.runner.database.records import Series

N = 2000


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
    return Series("prediction", columns, dict.fromkeys(columns, ""))


def test_errors_are_relative_to_the_spread_of_what_was_measured() -> None:
    stored = series(0.2)
    spread = np.std(stored.columns["surge"])
    result = score(stored, "identified", ("surge",), (10.0,))
    assert result.loss == pytest.approx(0.2 / spread, rel=0.05)
    assert result.after[10.0][0] == pytest.approx(0.1 / spread)
    assert [len(piece) for piece in result.pieces()] == [1000, 1000]


def test_references() -> None:
    stored = series(0.2)
    u = stored.columns["surge"]
    assert score(stored, MEAN_MOTION, ("surge",)).loss == pytest.approx(1.0)
    held = np.repeat([u[0], u[1000]], 1000)
    expected = np.sqrt(np.mean((held - u) ** 2)) / np.std(u)
    assert score(stored, PERSISTENCE, ("surge",)).loss == pytest.approx(expected)


def test_what_diverges_or_is_not_stored_is_infinitely_bad() -> None:
    stored = series(0.2)
    assert score(stored, "nominal", ("surge",)).loss == np.inf
    assert score(stored, "plant", ("surge",), (10.0,)).after[10.0][0] == np.inf
    assert interval([score(stored, "nominal", ("surge",))]) == (np.inf, np.inf)


def test_the_interval_holds_the_error_as_often_as_it_says() -> None:
    held = 0
    for seed in range(40):
        result = score(series(0.2, seed), "identified", ("surge",))
        low, high = interval([result])
        held += low <= 0.2 / np.std(series(0.0).columns["surge"]) <= high
    assert 30 <= held <= 40
