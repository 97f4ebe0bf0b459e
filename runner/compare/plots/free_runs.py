"""Free runs of several models over one test file: velocities over time, and tracks with hulls."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.plots.prediction import ROOM, fit_text
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    PALETTE,
    REFERENCE,
    footnote,
    headed,
    panels,
)
from seatrial.runner.compare.plots.track import outline
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
    others = iter(COLOURS * len(names))
    return {name: MODEL_COLOURS["nominal"] if name == "none" else next(others) for name in names}


def velocities(
    title: str, runs: Runs, colours: Mapping[str, str], outputs: Sequence[str]
) -> Figure:
    """Return the measured velocities and those of the free runs, one panel for each output."""
    figure, axes = panels(len(outputs), 1, 7.0, 1.9, share_x=True)
    first = next(iter(runs.values()))
    for panel, dof in zip(axes, outputs, strict=True):
        measured = first.columns[dof]
        _line(panel, first, measured, REFERENCE, "measured")
        for name, series in runs.items():
            predicted = series.columns.get(f"{dof}_{MODEL}")
            if predicted is not None:
                _line(panel, series, predicted, colours[name], name)
        margin = ROOM * float(np.std(measured)) or 1.0  # one that runs away leaves the panel
        low, high = np.nanmin(measured) - margin, np.nanmax(measured) + margin
        panel.set_ylim(*np.clip(panel.get_ylim(), low, high).tolist())
        panel.set_ylabel(with_unit(dof.capitalize(), first.units[dof]))
        panel.margins(x=0)
        fits = [
            f"{name} {fit_text(measured, series.columns[f'{dof}_{MODEL}'])}"
            for name, series in runs.items()
            if f"{dof}_{MODEL}" in series.columns
        ]
        panel.set_title("FIT: " + ", ".join(fits), loc="left", fontsize=8.5, fontweight="normal")
    axes[-1].set_xlabel(with_unit("Time from the first state", first.units["t"]))
    headed(figure, axes, title)
    return figure


def _line(axes: Axes, series: Series, values: Sample, colour: str, label: str) -> None:
    """A line with gaps between the pieces, of a limited number of points."""
    t, starts = (
        series.columns["t"] - series.columns["t"][0],
        np.flatnonzero(series.columns["start"] > 0.0),
    )
    t, values = np.insert(t, starts[1:], np.nan), np.insert(values, starts[1:], np.nan)
    shown = np.unique([*range(0, len(t), max(len(t) // POINTS, 1)), *np.flatnonzero(np.isnan(t))])
    axes.plot(t[shown], values[shown], color=colour, label=label, linewidth=1.0, alpha=0.9)


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
    axes.set_xlim(*east)
    axes.set_ylim(*north)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(with_unit("East", first.units["y"]))
    axes.set_ylabel(with_unit("North", first.units["x"]))
    headed(figure, [axes], title)
    note = "dots: the same instants; the vessel states no length"
    if length_m is not None:
        note = f"hulls at the same instants, their length of {number_text(length_m, 3)} m to scale"
    footnote(figure, [note])
    return figure


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
            corners = outline(north[k], east[k], psi[k], length_m)
            axes.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=colour))
