"""The verdict on one of our figures, compared with the printed one."""

import math
from typing import Literal

from seatrial.runner.compare.printed_figures import BY_CONSTRUCTION, CALIBRATED, Printed
from seatrial.runner.compare.statistics import SAME

TOLERANCE = 0.05  # relative: a figure within it counts as reproduced
Verdict = Literal[
    "beaten", "reproduced", "not reproduced", "below the true model",
    "calibrated", "by construction", "not reproducible", "no runs", "ours",
]  # fmt: skip
COUNTED: tuple[Verdict, ...] = ("beaten", "reproduced", "not reproduced", "below the true model")
APART: tuple[Verdict, ...] = (
    *("calibrated", "by construction", "not reproducible", "no runs", "ours"),
)  # these compare nothing with a printed figure, or cannot fail


def verdict_of(
    figure: Printed,
    value: float,
    interval: tuple[float, float],
    truth: float | None,
    below_true_model: bool = False,
) -> Verdict:
    """Return the verdict on our value, compared with the printed one.

    Beaten: the complete 95 % interval is better by more than the tolerance; for an estimate, its
    worst end is nearer to the truth than the printed one, and the term was not dropped.
    Reproduced: the printed figure is within the interval, or within 5 % of our value, or equals
    our value rounded to its decimals, and the interval is not wider than the printed figure.
    Without an interval (NaN, a single run) the value alone is compared.
    """
    if figure.printed is None or figure.compare == "none":
        return "ours"
    if CALIBRATED in figure.known:
        return "calibrated"
    if beaten(figure, value, interval, truth):
        verdict: Verdict = "below the true model" if below_true_model else "beaten"
    else:
        verdict = "reproduced" if reproduced(figure, value, interval) else "not reproduced"
    certain = BY_CONSTRUCTION in figure.known and verdict in ("beaten", "reproduced")
    return "by construction" if certain else verdict


def beaten(
    figure: Printed, value: float, interval: tuple[float, float], truth: float | None
) -> bool:
    """Return whether our value is better than the printed one beyond doubt."""
    printed, (low, high) = figure.printed or 0.0, _ends(value, interval)
    if figure.compare == "lower":
        return high < printed - _margin(figure)
    if figure.compare == "higher":
        return low > printed + _margin(figure)
    if figure.compare == "truth" and truth is not None:
        if value == 0.0 and truth != 0.0:  # the model lacks a term that the vessel has
            return False
        worst = max(abs(low - truth), abs(high - truth))
        return worst < abs(printed - truth) * (1.0 - TOLERANCE)
    return False


def reproduced(figure: Printed, value: float, interval: tuple[float, float]) -> bool:
    """Return whether our value agrees with the printed one, and is certain enough to say so."""
    printed, (low, high) = figure.printed or 0.0, _ends(value, interval)
    slack = SAME * abs(printed)
    inside = low - slack <= printed <= high + slack
    return not too_wide(figure, interval) and (inside or abs(value - printed) <= _margin(figure))


def too_wide(figure: Printed, interval: tuple[float, float]) -> bool:
    """Return whether the interval is wider than the printed figure (than its distance to 1)."""
    low, high = interval
    return high - low > max(abs(_size(figure)), 2.0 * _margin(figure))


def _size(figure: Printed) -> float:
    """Return what the printed figure states: its value, or for eigenvalues its distance to 1."""
    return (figure.printed or 0.0) - (1.0 if figure.compare == "one" else 0.0)


def _margin(figure: Printed) -> float:
    return max(TOLERANCE * abs(_size(figure)), figure.rounding * (1.0 + SAME))


def _ends(value: float, interval: tuple[float, float]) -> tuple[float, float]:
    return (value, value) if math.isnan(interval[0]) else interval
