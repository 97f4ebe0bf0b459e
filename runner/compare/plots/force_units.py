"""Units of forces on axes: kN and MNm for ships, N and Nm for models; and the thrusters' limits."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.plots.style import REFERENCE
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.vocabulary import Config

PREFIXES = (("M", 1e6, 1e6), ("k", 1e3, 1e4))  # letter, factor, smallest value that takes it
PREFIXED = ("N", "Nm", "W", "J")
NEAR = 2.5  # a limit above this multiple of the peak is not drawn


def prefixed(unit: str, largest: float) -> tuple[str, float]:
    """Return the unit that suits a largest value, and its size: `kN`, 1000.0 from 10 kN on."""
    if unit in PREFIXED:
        for letter, size, least in PREFIXES:
            if largest >= least:
                return letter + unit, size
    return unit, 1.0


def largest_of(signals: Sequence[Sample]) -> float:
    """Return the largest absolute value of signals, without NaN; 0 if there is none."""
    finite = [np.abs(signal[np.isfinite(signal)]) for signal in signals]
    return max((float(np.max(values)) for values in finite if values.size), default=0.0)


def limits_of(config: Config) -> dict[str, float]:
    """Return the thrusters' limits [N, Nm] by degree of freedom, if the vessel has them."""
    vessel = config.get("vessel", {})
    return dict(zip(vessel.get("dofs") or (), vessel.get("force_limits") or (), strict=False))


def draw_limit(axes: Axes, limit: float, peak: float, unit: str, size: float) -> None:
    """Draw a limit [N, Nm] at both sides, or write it at the top if it is far above the peak.

    `unit` and `size` are those of the axis.
    """
    if limit <= NEAR * peak:
        for side in (-limit, limit):
            axes.axhline(side / size, color=REFERENCE, linestyle="-.", linewidth=0.9, label="limit")
        return
    text = f"limit {number_text(limit / size, 3)} {unit}"
    axes.text(
        0.99, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=8,
        color=REFERENCE,
    )  # fmt: skip
