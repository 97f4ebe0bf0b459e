"""Free runs of several models over one test file: velocities over time, and tracks with hulls."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.plots.prediction import draw_motion
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    PALETTE,
    REFERENCE,
    drawing_of,
    panels,
)
from seatrial.runner.compare.plots.track import draw_hull, draw_plane
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series

Runs = Mapping[str, Series]  # series `prediction` by entrant, all of the same test file
MODEL = "identified"
POINTS = 400  # of a line
HULLS = 8  # along a track
SIDE = 5.6  # of a track [inch]
COLOURS = (PALETTE[0], PALETTE[2], PALETTE[3])
PLANE = ("x", "y", "psi")


def part_of(series: Series, rows: slice) -> Series:
    """Return some rows of a series."""
    columns = {name: values[rows] for name, values in series.columns.items()}
    return Series(series.kind, columns, series.units)


def colours_of(names: Sequence[str]) -> dict[str, str]:
    """Return a colour of each entrant; the nominal model has the same on every figure."""
    others = cycle(COLOURS)
    return {name: MODEL_COLOURS["nominal"] if name == "none" else next(others) for name in names}


def velocities(
    title: str, runs: Runs, colours: Mapping[str, str], outputs: Sequence[str]
) -> Figure:
    """Return the measured velocities and those of the free runs, one panel for each output."""
    figure, axes = panels(len(outputs), 1, 7.0, 1.9, share_x=True)
    first = next(iter(runs.values()))
    since = {**first.columns, "t": first.columns["t"] - first.columns["t"][0]}
    measured = Series(first.kind, since, first.units)
    for panel, dof in zip(axes, outputs, strict=True):
        predicted = [
            (name, series.columns[f"{dof}_{MODEL}"], colours[name])
            for name, series in runs.items()
            if f"{dof}_{MODEL}" in series.columns
        ]
        draw_motion(panel, measured, dof, predicted, max(len(since["t"]) // POINTS, 1))
    axes[-1].set_xlabel(with_unit("Time from the first state", first.units["t"]))
    return drawing_of("velocities", figure, axes, title).figure


def tracks(
    title: str, runs: Runs, colours: Mapping[str, str], length_m: float | None
) -> Figure | None:
    """Return the measured track and those of the free runs, north up; None without a plane.

    The hulls, of the vessel's length [m], are those of the same instants.
    """
    first = next(iter(runs.values()))
    if any(name not in first.columns for name in PLANE):
        return None
    north, east = _limits(runs, length_m or 0.0)
    height = SIDE * float(np.clip(np.ptp(north) / np.ptp(east), 0.5, 1.3))
    figure, (axes,) = panels(1, 1, SIDE, height + 1.2)
    instants = np.linspace(0, len(first.columns["t"]) - 1, HULLS).astype(int)
    _track(axes, first, "", REFERENCE, "measured", length_m, instants)
    for name, series in runs.items():
        if f"x_{MODEL}" in series.columns:
            _track(axes, series, f"_{MODEL}", colours[name], name, length_m, instants)
    draw_plane(axes, first, north, east)
    note = "dots: the same instants; the vessel states no length"
    if length_m is not None:
        note = f"hulls at the same instants, their length of {number_text(length_m, 3)} m to scale"
    return drawing_of("tracks", figure, [axes], title, [note]).figure


def _limits(runs: Runs, length_m: float) -> tuple[Sample, Sample]:
    """Limits (2,) of north and east [m]; a free run that runs away leaves the panel."""
    own = next(iter(runs.values())).columns
    room = 0.3 * max(float(np.ptp(own["x"])), float(np.ptp(own["y"])), length_m, 1e-9)
    limits = []
    for name in PLANE[:2]:
        motions = [
            own[name],
            *(run.columns.get(f"{name}_{MODEL}", own[name]) for run in runs.values()),
        ]
        ends = np.array([np.nanmin(motions), np.nanmax(motions)])
        ends = np.clip(ends, own[name].min() - room, own[name].max() + room)
        limits.append(ends + 0.6 * max(length_m, 0.1 * room) * np.array([-1.0, 1.0]))
    return limits[0], limits[1]


def _track(
    axes: Axes, series: Series, suffix: str, colour: str, label: str, length_m: float | None,
    instants: Sample,
) -> None:  # fmt: skip
    north, east, psi = (series.columns[f"{name}{suffix}"] for name in PLANE)
    shown = np.arange(0, len(north), max(len(north) // POINTS, 1))
    axes.plot(east[shown], north[shown], color=colour, label=label, linewidth=1.0, alpha=0.9)
    for k in instants[np.isfinite(north[instants])]:
        if length_m is None:
            axes.plot(east[k], north[k], "o", color=colour, markersize=4)
        else:
            draw_hull(axes, north[k], east[k], psi[k], length_m, colour)
