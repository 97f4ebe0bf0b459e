"""Statistics against numbers worked out by hand, and against scipy's own."""

import math

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.statistics import checked, confidence_interval, paired_test, summary

SAMPLE = np.array([2.0, 4.0, 4.0, 6.0])


def test_summary_by_hand() -> None:
    found = summary(SAMPLE, ["mean", "std", "n", "median", "min", "max", "q25"])
    assert found == {
        "mean": 4.0, "std": pytest.approx(math.sqrt(8.0 / 3.0)), "n": 4, "median": 4.0, "min": 2.0,
        "max": 6.0, "q25": 3.5,
    }  # fmt: skip


def test_one_value_has_no_spread_and_none_has_nothing() -> None:
    assert math.isnan(summary(np.array([3.0]), ["std"])["std"])
    assert confidence_interval(np.array([3.0])) == pytest.approx((math.nan, math.nan), nan_ok=True)
    assert math.isnan(summary(np.array([]), ["mean"])["mean"])


def test_paired_test_by_hand() -> None:
    # differences 1, 2, 3, 4, 5, 6 all of one sign: p = 2 / 2^6
    baseline = np.arange(1.0, 7.0) * 3.0
    sample = baseline - np.arange(1.0, 7.0)
    found = paired_test(sample, baseline)
    assert (found.pairs, found.wins) == (6, 6)
    assert found.ratio == pytest.approx(2.0 / 3.0)
    assert found.p_value == pytest.approx(2.0 / 64.0)
    assert paired_test(sample, baseline, better="higher").wins == 0
    assert paired_test(sample[:5], baseline[:5]).p_value == pytest.approx(2.0 / 32.0)
    assert math.isnan(paired_test(sample[:4], baseline[:4]).p_value)  # too few for any level
    assert paired_test(SAMPLE[:0], SAMPLE[:0]).pairs == 0
    assert math.isnan(paired_test(SAMPLE, 0.0 * SAMPLE).ratio)


def test_unknown_statistics_are_refused() -> None:
    assert checked(["q05", "ci", "mean", "mean"]) == ("q05", "ci", "mean")
    for name in ("mode", "q5x", "q100", ""):
        with pytest.raises(ConfigurationError, match="--statistic"):
            checked([name])
