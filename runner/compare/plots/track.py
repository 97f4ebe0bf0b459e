"""The sailed track in NED: north up, east right, equal axes, with reference, headings and wind.

The outline of a vessel seen from above, to scale, for tracks and their animation.
"""

from collections.abc import Mapping
from itertools import count

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.plots.request import (
    PlotRequest,
    Voyages,
    of_identified,
    subtitle,
    voyages,
)
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    REFERENCE,
    WIND,
    Drawing,
    footnote,
    headed,
    panels,
    trim,
)
from seatrial.runner.compare.plots.wind_force import EAST, NORTH
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.export.manoeuvre_tracks import length_of
from seatrial.runner.record.rows import Series
from seatrial.runner.vocabulary import Config

# A hull of length 1 seen from above, bow to +x: body x and y of its corners, shape (5, 2).
HULL = np.array([[0.5, 0.0], [0.2, 0.18], [-0.5, 0.18], [-0.5, -0.18], [0.2, -0.18]])
HULL_SHARE = 0.045  # of the extent of the track, the length of a hull whose vessel's is not known
LEAST_SHARE = 0.02  # of the extent, the shortest hull that shows its heading


def drawn_length(config: Config, extent_m: float) -> tuple[float, str]:
    """Return the length of the hulls [m] on a track of this extent [m], and a note on it.

    It is that of the vessel; of a vessel too short to be seen it is the smallest of 2, 5, 10, 20,
    ... lengths that can.
    """
    length = length_of(config) if isinstance(config.get("vessel"), Mapping) else None
    if length is None:
        return HULL_SHARE * max(extent_m, 1e-6), "hulls not to scale, as the length is not stored"
    times = next(m * 10**k for k in count() for m in (1, 2, 5)
                 if m * 10**k * length >= LEAST_SHARE * extent_m)  # fmt: skip
    size = "hulls to scale" if times == 1 else f"hulls {times} times as long as the vessel"
    return times * length, f"{size}: {number_text(length, 3)} m"


def outline(north: float, east: float, psi: float, length_m: float) -> Sample:
    """Return east and north of the corners of a hull [m], shape (5, 2).

    It is rotated from body to NED by psi [rad] about the down axis.
    """
    forward, right = length_m * HULL[:, 0], length_m * HULL[:, 1]
    norths = north + np.cos(psi) * forward - np.sin(psi) * right
    easts = east + np.sin(psi) * forward + np.cos(psi) * right
    return np.column_stack([easts, norths])


FIGURE = Figure(
    "track",
    "The sailed track of one run in the plane, with headings and wind.",
    "series deployment_* or recording, in the plane",
    caption="Track of the newest deployed run",
    place=7,
)

MARKS = 24  # hulls along a track, at most
SLENDEREST = 0.35  # smaller over larger side of the picture, at least
ARROWS = 16  # arrows of the wind along a track, at most
ARROW_SHARE = 0.09  # the longest arrow, of the larger side of the picture


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level): one panel for each model.

    Models that sail alike share a panel. A run without a deployment shows the track of the
    recording.
    """
    runs = voyages(results, request, "plot track", instead="recording")
    return [_drawing(results, run, missions) for run, missions in runs]


def _drawing(results: Queries, run: StoredRun, missions: Voyages) -> Drawing:
    series_of = list(missions.values())
    extent = max(float(np.ptp(limits)) for limits in _ranges(series_of))
    length, note = drawn_length(results.reader.run(run.id).config, extent)
    north, east = _limits(series_of, length)
    side = 4.6
    height = side * float(np.clip(np.ptp(north) / np.ptp(east), 0.45, 1.6))
    figure, axes = panels(1, len(missions), side, height + 0.9)
    for panel, (model, series) in zip(axes, missions.items(), strict=True):
        _panel(panel, model, series, length, max(np.ptp(north), np.ptp(east)))
        panel.set_xlim(*east)
        panel.set_ylim(*north)
    headed(figure, axes, f"Track, {subtitle(run)}")
    notes = [f"{note}, at equal distances sailed"]
    if any(NORTH in series.columns for series in missions.values()):
        notes.append("arrows: direction and speed of the wind at the position of the tip")
    notes += of_identified(results, run, missions)
    footnote(figure, notes)
    trim(figure)
    return Drawing(f"track-run-{run.id}", figure)


def _ranges(series_of: list[Series]) -> list[Sample]:
    """Return smallest and largest north and east [m], each of shape (2,)."""
    ranges = []
    for actual, desired in (("x", "x_d"), ("y", "y_d")):
        names = (actual, desired)
        values = np.concatenate(
            [v.columns[name] for v in series_of for name in names if name in v.columns]
        )
        ranges.append(np.array([np.nanmin(values), np.nanmax(values)]))
    return ranges


def _limits(series_of: list[Series], length: float) -> tuple[Sample, Sample]:
    """Return common limits of north and east [m], each of shape (2,), with room for the hulls."""
    ranges = _ranges(series_of)
    share = 0.06 if all(NORTH not in v.columns for v in series_of) else 0.06 + ARROW_SHARE
    margin = share * max(float(np.ptp(limits)) for limits in ranges) + 1e-9
    margin = max(margin, 0.55 * length)
    least = SLENDEREST * max(float(np.ptp(limits)) + 2.0 * margin for limits in ranges)
    halves = (max(0.5 * float(np.ptp(limits)) + margin, 0.5 * least) for limits in ranges)
    north, east = (
        np.mean(limits) + np.array([-half, half])
        for limits, half in zip(ranges, halves, strict=True)
    )
    return north, east


def _panel(axes: Axes, model: str, series: Series, length: float, extent: float) -> None:
    columns, colour = series.columns, MODEL_COLOURS[model]
    if "x_d" in columns:
        axes.plot(columns["y_d"], columns["x_d"], "--", color=REFERENCE, label="reference")
    label = "sailed" if model == "recording" else f"{model} model"
    axes.plot(columns["y"], columns["x"], color=colour, label=label)
    if "psi" in columns:
        for index in _equidistant(columns["x"], columns["y"], length):
            x, y, psi = (float(columns[name][index]) for name in ("x", "y", "psi"))
            corners = outline(x, y, psi, length)
            axes.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=colour))
    if NORTH in columns:
        _arrows(axes, series, extent)
    axes.plot(
        columns["y"][0], columns["x"][0], "o", color=REFERENCE, markersize=7, label="start",
        markeredgecolor="white", markeredgewidth=1.2, zorder=5,
    )  # fmt: skip
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(with_unit("East", series.units["y"]))
    axes.set_ylabel(with_unit("North", series.units["x"]))


def _arrows(axes: Axes, series: Series, extent: float) -> None:
    """Draw the mean wind of equal parts of the time; each tip is the vessel at mid-time."""
    columns = series.columns
    parts = np.array_split(np.arange(len(columns["t"])), ARROWS)
    middle = np.array([part[len(part) // 2] for part in parts if len(part)])
    wind = np.array([[np.mean(columns[w][p]) for w in (EAST, NORTH)] for p in parts if len(p)])
    places = np.column_stack([columns["y"][middle], columns["x"][middle]])
    rows = _separated(places, 0.5 * ARROW_SHARE * extent)
    strongest = float(np.max(np.hypot(*wind.T)))
    if strongest <= 0.0:
        return
    axes.quiver(
        *places[rows].T, *wind[rows].T, color=WIND, pivot="tip", angles="xy", units="inches",
        scale_units="xy", scale=strongest / (ARROW_SHARE * extent + 1e-9), width=0.025, zorder=3,
    )  # fmt: skip
    label = f"wind, up to {number_text(strongest, 3)} m/s"
    axes.plot([], [], color=WIND, marker=">", linewidth=2.0, label=label)


def _separated(places: Sample, distance: float) -> list[int]:
    """Return rows of places (n, 2) [m] that are at least `distance` [m] from each other."""
    chosen: list[int] = []
    for i, place in enumerate(places):
        if all(np.hypot(*(place - places[j])) >= distance for j in chosen):
            chosen.append(i)
    return chosen


def _equidistant(north: Sample, east: Sample, length: float) -> list[int]:
    """Return samples at equal distances along the track, so that hulls do not overlap.

    `length` is that of the hulls [m]; the last sample is always one of them.
    """
    sailed = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(north), np.diff(east)))])
    count = int(np.clip(sailed[-1] / (1.2 * length), 1, MARKS))
    marks = np.linspace(0.0, sailed[-1], count + 1)[1:]
    return sorted({int(index) for index in np.searchsorted(sailed, marks).clip(0, len(sailed) - 1)})
