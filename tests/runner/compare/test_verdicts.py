"""Verdicts: what beats, what reproduces, and what says nothing."""

import math
from dataclasses import replace

import pytest

from seatrial.runner.compare.printed_figures import Printed
from seatrial.runner.compare.verdicts import verdict_of

ONE = Printed(
    experiment="mine", document="Somebody (2020)", table="Table 1", page="7", row="with model",
    quantity="MSE", printed=100.0, reference=None, unit="N^2", way="",
    where="identifier=ls", source="metric", stage="validation", model="identified", dof="surge",
    name="force_mse", label="", factor=1.0, compare="lower", statistic="", information="", note="",
)  # fmt: skip


@pytest.mark.parametrize(
    ("compare", "value", "interval", "truth", "verdict"),
    [
        ("lower", 90.0, (85.0, 94.0), None, "beaten"),
        ("lower", 90.0, (85.0, 96.0), None, "not reproduced"),  # the interval reaches into 5 %
        ("lower", 96.0, (96.0, 96.0), None, "reproduced"),
        ("lower", 150.0, (99.0, 199.0), None, "reproduced"),
        ("lower", 150.0, (99.0, 201.0), None, "not reproduced"),  # wider than the figure itself
        ("value", 400.0, (-50.0, 850.0), None, "not reproduced"),
        ("value", 101.0, (-50.0, 252.0), None, "not reproduced"),  # though the mean is close
        ("value", 101.0, (math.nan, math.nan), None, "reproduced"),  # a single run: no interval
        ("lower", 90.0, (math.nan, math.nan), None, "beaten"),
        ("lower", 150.0, (149.0, 151.0), None, "not reproduced"),
        ("higher", 150.0, (149.0, 151.0), None, "beaten"),
        ("higher", 50.0, (49.0, 51.0), None, "not reproduced"),
        ("value", 50.0, (49.0, 51.0), None, "not reproduced"),
        ("value", 104.0, (104.0, 104.0), None, "reproduced"),
        ("truth", 61.0, (60.0, 62.0), 60.0, "beaten"),
        ("truth", 61.0, (10.0, 109.0), 60.0, "reproduced"),  # too wide to beat, and holds 100
        ("truth", 0.0, (0.0, 0.0), 40.0, "not reproduced"),  # dropped: nearer, but wrong
        ("truth", 0.0, (0.0, 0.0), 0.0, "beaten"),
        ("truth", 10.0, (9.0, 11.0), 60.0, "not reproduced"),
        ("none", 10.0, (9.0, 11.0), None, "ours"),
    ],
)
def test_verdicts(
    compare: str,
    value: float,
    interval: tuple[float, float],
    truth: float | None,
    verdict: str,
) -> None:
    assert verdict_of(replace(ONE, compare=compare), value, interval, truth) == verdict


@pytest.mark.parametrize(
    ("value", "interval", "verdict"),
    [
        (1.00125, (1.0012, 1.0013), "reproduced"),
        (1.0023, (1.0023, 1.0023), "not reproduced"),  # 0.1 % of 1, but 77 % of the distance to 1
        (1.0013, (0.9990, 1.0036), "not reproduced"),  # stable or not: the interval does not say
    ],
)
def test_an_eigenvalue_is_judged_by_its_distance_to_one(
    value: float, interval: tuple[float, float], verdict: str
) -> None:
    eigenvalue = replace(ONE, compare="one", printed=1.0013, rounding=0.00005)
    assert verdict_of(eigenvalue, value, interval, None) == verdict


@pytest.mark.parametrize("value", [50.0, 100.0, 200.0])
def test_a_calibrated_figure_is_neither_success_nor_failure(value: float) -> None:
    calibrated = replace(ONE, information="calibrated; a known thruster lag")
    assert verdict_of(calibrated, value, (value, value), None) == "calibrated"


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(50.0, "by construction"), (100.0, "by construction"), (200.0, "not reproduced")],
)
def test_what_cannot_fail_is_no_success(value: float, verdict: str) -> None:
    certain = replace(ONE, information="by construction")
    assert verdict_of(certain, value, (value, value), None) == verdict
