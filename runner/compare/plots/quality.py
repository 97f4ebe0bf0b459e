"""Consistency of velocity and position of a measured recording over time.

Left: integral of the velocity minus the position. Right: derivative of the position minus the
velocity. The largest error is marked, and compared with a threshold.
"""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle, with_run
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    MUTED,
    SHOWN_LIMIT,
    Drawing,
    footnote,
    headed,
    panels,
)
from seatrial.runner.compare.results import Queries, StoredRun
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series

FIGURE = Figure(
    "quality",
    "Velocity against position of a measured recording.",
    "series quality, of excitation=recording",
    caption="Velocity against position of the newest measured recording",
    place=15,
)

SIDES = (
    (("x", "y", "z", "phi", "theta", "psi"), "Integrated velocity - position"),
    (("u", "v", "w", "p", "q", "r"), "Differentiated position - velocity"),
)
WORDS = {
    **{"x": "North", "y": "East", "z": "Down", "phi": "Roll", "theta": "Pitch", "psi": "Heading"},
    **{"u": "Surge", "v": "Sway", "w": "Heave", "p": "Roll rate", "q": "Pitch rate"},
    **{"r": "Yaw rate"},
}
DRIFT_SHARE = 0.1  # of the range of a position, the largest error that is no drift
SPIKES = 0.01  # share of samples beyond it that are spikes, not a drift
OUTLIER_DEVIATIONS = 6.0  # robust standard deviations, beyond which an error is an outlier
ROBUST = 1.482602218505602  # standard deviation over median absolute deviation of normal noise
AGREES, REFUSED = 0.5, 0.3  # correlations of seatrial.models.recording.consistency
DEGREES = {"rad": "deg", "rad/s": "deg/s"}
CORRELATION = "consistency_correlation"


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), two panels for each DOF."""
    return [_drawing(results, run) for run, _ in each_run(results, request, ["quality"])]


def _drawing(results: Queries, run: StoredRun) -> Drawing:
    series = results.reader.series(run.id, "quality")
    ranges = _ranges(results, run)
    rows = [i for i, name in enumerate(SIDES[0][0]) if f"{name}_error" in series.columns]
    figure, axes = panels(len(rows), len(SIDES), 4.2, 2.3, share_x=True)
    for row, i in enumerate(rows):
        position, velocity = (names[i] for names, _ in SIDES)
        limit = DRIFT_SHARE * ranges[position] if position in ranges else None
        _panel(axes[row * len(SIDES)], series, position, limit, _drift)
        limit = robust_limit(series.columns[f"{velocity}_error"])
        _panel(axes[row * len(SIDES) + 1], series, velocity, limit, _outliers)
    for side, (_, title) in enumerate(SIDES):
        axes[side].set_title(title, loc="left", fontsize=9)
        axes[side - len(SIDES)].set_xlabel(with_unit("Time", series.units["t"]))
    headed(figure, axes, f"Quality of the recording, {subtitle(run)}")
    footnote(figure, [
        f"circle: the largest error; dashed at the left: {DRIFT_SHARE:.0%} of the range of the "
        f"position, at the right: {OUTLIER_DEVIATIONS:g} robust standard deviations",
        *_agreement(results, run),
    ])  # fmt: skip
    return Drawing(f"quality-run-{run.id}", figure)


def robust_limit(error: Sample) -> float | None:
    """Return the error beyond which samples are outliers; None for an error that is constant."""
    finite = error[np.isfinite(error)]
    middle = float(np.median(finite)) if finite.size else 0.0
    deviation = ROBUST * float(np.median(np.abs(finite - middle))) if finite.size else 0.0
    return OUTLIER_DEVIATIONS * deviation or None


def _ranges(results: Queries, run: StoredRun) -> dict[str, float]:
    """Return the ranges of the measured positions and angles by name, if they are stored."""
    if "recording" not in {file.kind for file in results.reader.series_files(run.id)}:
        return {}
    columns = results.reader.series(run.id, "recording").columns
    return {name: float(np.ptp(columns[name])) for name in SIDES[0][0] if name in columns}


def _drift(error: Sample, limit: float) -> str:
    beyond = float(np.mean(np.abs(error) > limit))
    if beyond > SPIKES:
        return "drifts"
    return "spikes" if beyond else "agrees"


def _outliers(error: Sample, limit: float) -> str:
    count = int(np.sum(np.abs(error) > limit))
    return f"{count} outliers" if count else "no outliers"


def _agreement(results: Queries, run: StoredRun) -> list[str]:
    """Return the verdict on each axis that was compared, with the thresholds."""
    rows = results.diagnostics([run], (CORRELATION,), with_run(None, run.id))[run.id]
    texts = [
        f"{row.dof} {row.value:.2f} ({_verdict(row.value)})"
        for row in rows
        if row.value is not None and np.isfinite(row.value)
    ]
    if not texts:
        return []
    known = f"agrees from {AGREES:g} on, refused below {REFUSED:g}"
    return [f"correlation of velocity and derivative of the pose, {known}: {', '.join(texts)}"]


def _verdict(correlation: float) -> str:
    if correlation >= AGREES:
        return "agrees"
    return "doubtful" if correlation >= REFUSED else "refused"


def _panel(
    axes: Axes,
    series: Series,
    name: str,
    limit: float | None,
    verdict: Callable[[Sample, float], str],
) -> None:
    """Draw an error over time with its threshold, and write the verdict above it."""
    t, error, unit = (
        series.columns["t"],
        series.columns[f"{name}_error"],
        series.units[f"{name}_error"],
    )
    if unit in DEGREES:
        error, unit = np.degrees(error), DEGREES[unit]
        limit = None if limit is None else float(np.degrees(limit))
    axes.plot(t, error, color=MODEL_COLOURS["identified"], linewidth=0.9)
    worst = int(np.nanargmax(np.abs(error)))
    axes.plot(t[worst], error[worst], "o", markerfacecolor="none", color=MODEL_COLOURS["nominal"])
    text = f"max {number_text(abs(float(error[worst])), 3)} {unit_text(unit)}"
    if limit is not None:
        text += f": {verdict(error, limit)}"
        if limit <= SHOWN_LIMIT * abs(float(error[worst])):
            for side in (-limit, limit):
                axes.axhline(side, color=MUTED, linestyle="--", linewidth=0.8)
    axes.text(
        0.98, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=8.5,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.8},
    )  # fmt: skip
    axes.set_ylabel(with_unit(WORDS[name], unit))
    axes.margins(x=0, y=0.25)
