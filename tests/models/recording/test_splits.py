"""Splits: disjoint, in time, and covering what they say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.splits import (
    Split,
    blocked_k_fold,
    by_trips,
    half,
    rolling_origin,
    trips,
)


def test_half() -> None:
    split = half(7)
    np.testing.assert_array_equal(np.flatnonzero(split.train), [0, 1, 2, 3])
    np.testing.assert_array_equal(np.flatnonzero(split.test), [4, 5, 6])
    assert np.sum(half(10, 0.3).train) == 3  # 0.3 * 10 is a little more than 3


def test_trips_of_jervan_5_3() -> None:
    """Four trips of 1000 s: 1 and 3 for training, 2 and 4 for testing."""
    t = np.arange(-50.0, 4000.0, 10.0)
    trip = trips(t, [0.0, 1000.0, 2000.0, 3000.0])
    split = by_trips(trip, (1, 3))
    np.testing.assert_array_equal(split.train, (t >= 0.0) & (t // 1000.0 % 2 == 0))
    np.testing.assert_array_equal(split.test, (t >= 0.0) & (t // 1000.0 % 2 == 1))


def disjoint(split: Split, gap: int) -> bool:
    train, test = np.flatnonzero(split.train), np.flatnonzero(split.test)
    return bool(np.min(np.abs(train[:, None] - test)) > gap)


@given(st.integers(15, 80), st.integers(2, 4), st.integers(0, 2))
def test_rolling_origin_never_trains_on_the_future(n: int, count: int, gap: int) -> None:
    splits = rolling_origin(n, count, gap)
    assert len(splits) == count
    for split in splits:
        train, test = np.flatnonzero(split.train), np.flatnonzero(split.test)
        assert train[0] == 0
        assert test[0] - train[-1] == gap + 1
    covered = np.sum([split.test for split in splits], axis=0)
    assert np.max(covered) == 1
    assert np.all(covered[np.argmax(covered) :] == 1)


@given(st.integers(12, 80), st.integers(2, 4), st.integers(0, 2))
def test_blocked_k_fold_tests_every_sample_once(n: int, count: int, gap: int) -> None:
    splits = blocked_k_fold(n, count, gap)
    np.testing.assert_array_equal(np.sum([split.test for split in splits], axis=0), 1)
    for split in splits:
        assert disjoint(split, gap)
        test = np.flatnonzero(split.test)
        assert np.all(np.diff(test) == 1)
        left_out = n - np.sum(split.train) - len(test)
        assert left_out == gap * (int(test[0] > 0) + int(test[-1] < n - 1))


def test_equal_to_scikit_learns() -> None:
    from sklearn.model_selection import KFold, TimeSeriesSplit

    for mine, (train, test) in zip(
        blocked_k_fold(40, 4), KFold(4).split(np.zeros(40)), strict=True
    ):
        np.testing.assert_array_equal(np.flatnonzero(mine.train), train)
        np.testing.assert_array_equal(np.flatnonzero(mine.test), test)
    theirs = TimeSeriesSplit(4, gap=3).split(np.zeros(40))
    for mine, (train, test) in zip(rolling_origin(40, 4, 3), theirs, strict=True):
        np.testing.assert_array_equal(np.flatnonzero(mine.train), train)
        np.testing.assert_array_equal(np.flatnonzero(mine.test), test)


def test_what_cannot_be_split() -> None:
    with pytest.raises(ConfigurationError, match="train_fraction must lie between 0 and 1"):
        half(10, 0.0)
    with pytest.raises(ConfigurationError, match="trip_starts_s must increase"):
        trips(np.arange(3.0), [1.0, 1.0])
    with pytest.raises(ConfigurationError, match=r"got \[1, 2\] of trips \[1, 2\]"):
        by_trips(np.array([0, 1, 2]), (1, 2))
    with pytest.raises(ConfigurationError, match="cannot cut 5 samples into 3 blocks"):
        blocked_k_fold(5, 3, 1)
    with pytest.raises(ConfigurationError, match="at least 2 blocks"):
        blocked_k_fold(5, 1)
