"""Statistics against numbers worked out by hand, and against scipy's own."""

import math

import numpy as np
import pandas as pd
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.statistics import checked, confidence_interval, paired_test, summary

SAMPLE = np.array([2.0, 4.0, 4.0, 6.0])


def test_summary_by_hand() -> None:
    values = pd.DataFrame({"cell": [0] * 4 + [1], "value": [*SAMPLE, 3.0]})
    found = summary(values, ["mean", "std", "n", "median", "min", "max", "q25", "ci"])
    (low, high), alone = confidence_interval(SAMPLE), found.loc[1]
    assert found.loc[0].to_dict() == {
        "ci_low": pytest.approx(low), "ci_high": pytest.approx(high),
        "mean": 4.0, "std": pytest.approx(math.sqrt(8.0 / 3.0)), "n": 4, "median": 4.0, "min": 2.0,
        "max": 6.0, "q25": 3.5,
    }  # fmt: skip
    assert alone[["std", "ci_low", "ci_high"]].isna().all()
    assert (alone["mean"], alone["n"]) == (3.0, 1)


def test_one_value_has_no_interval() -> None:
    assert confidence_interval(np.array([3.0])) == pytest.approx((math.nan, math.nan), nan_ok=True)


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
