"""The track in NED: north up, east right, equal axes, with reference, headings, wind and waters.

A mix of manoeuvres with a route has a panel of its own: series `plan` (poses, with the number of
the manoeuvre, -1 on a passage) and `waters` (corners of the area and the obstacles), with the
recorded track. A docking has its harbour (series `harbour`), and the forces below the track.
`outline` and `draw_harbour` are for films of hulls in the plane too.
"""

from collections.abc import Sequence
from itertools import count
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.plots import selection, style
from seatrial.runner.compare.plots.excitation import EAST, NORTH
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.export.manoeuvre_tracks import length_of
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import Config

FIGURE = Figure(
    "track",
    "The sailed track of one run in the plane, with headings and wind; a mix with its plan.",
    "series deployment_* or recording, in the plane", ("run", "facet"), place=7,
)  # fmt: skip

# A hull of length 1 seen from above, bow to +x: body x and y of its corners, shape (5, 2).
HULL = np.array([[0.5, 0.0], [0.2, 0.18], [-0.5, 0.18], [-0.5, -0.18], [0.2, -0.18]])
HULL_SHARE = 0.045  # of the extent of the track, the length of a hull whose vessel's is not known
LEAST_SHARE = 0.02  # of the extent, the shortest hull that shows its heading
MARKS = 24  # hulls along a track, at most
SLENDEREST = 0.35  # smaller over larger side of the picture, at least
ARROWS = 16  # arrows of the wind along a track, at most
ARROW_SHARE = 0.09  # the longest arrow, of the larger side of the picture
SIDE, PLAN_SIDE, FORCES = 4.6, 6.4, 1.9  # of a panel; the last is the height of forces [inch]
TESTING = 2.0  # the role of a manoeuvre that is held out
HARBOUR = "harbour"  # series: polygon 0 is the hull in body axes, the others are land
SPACING, DOCKING_SPACING = 1.2, 0.5  # of the hulls along a track, in their lengths
START: dict[str, Any] = {"label": "start", "color": style.REFERENCE, "markersize": 7, "zorder": 5,
                         "markeredgecolor": "white", "markeredgewidth": 1.2}  # fmt: skip


def drawings(results: Queries, request: PlotRequest) -> list[style.Drawing]:
    """Draw one figure of one run (with --facet, for each level): one panel for each model.

    Models that sail alike share a panel. A run without a deployment shows the track of the
    recording, on its plan if it has one.
    """
    drawn = []
    for run, series_of in selection.each_run(
        results, request, (*selection.DEPLOYMENTS, "recording", "plan", HARBOUR)
    ):
        if "plan" in series_of:
            drawn.append(_plan(results, run, series_of["plan"], series_of["recording"]))
        if "plan" not in series_of or {*selection.DEPLOYMENTS} & {*series_of}:
            own, notes = selection.distinct(results, run, series_of)
            selection.in_plane(run, "plot track", own)
            drawn.append(_drawing(results, run, own, notes, series_of.get(HARBOUR)))
    return drawn


def drawn_length(config: Config, extent_m: float) -> tuple[float, str]:
    """Return the length of the hulls [m] on a track of this extent [m], and a note on it.

    It is that of the vessel; of a vessel too short to be seen it is the smallest of 2, 5, 10, 20,
    ... lengths that can.
    """
    length = length_of(config)
    if length is None:
        return HULL_SHARE * max(extent_m, 1e-6), "hulls not to scale, as the length is not stored"
    times = next(m * 10**k for k in count() for m in (1, 2, 5)
                 if m * 10**k * length >= LEAST_SHARE * extent_m)  # fmt: skip
    size = "hulls to scale" if times == 1 else f"hulls {times} times as long as the vessel"
    return times * length, f"{size}: {number_text(length, 3)} m"


def outline(
    north: float, east: float, psi: float, length_m: float, hull: Sample | None = None
) -> Sample:
    """Return east and north of the corners of a hull [m], shape (n, 2).

    It is rotated from body to NED by psi [rad] about the down axis. `hull` are the corners in
    body axes [m], by default those of a ship of the length.
    """
    return in_ned(length_m * HULL if hull is None else hull, north, east, psi)


def in_ned(points: Sample, north: float, east: float, psi: float) -> Sample:
    """Return east and north [m] of points of the body, both of shape (n, 2); psi [rad]."""
    forward, right = points.T
    norths = north + np.cos(psi) * forward - np.sin(psi) * right
    easts = east + np.sin(psi) * forward + np.cos(psi) * right
    return np.column_stack([easts, norths])


def draw_track(axes: Axes, model: str, series: Series) -> Line2D:
    """Draw a track with its reference; return the line of the track."""
    columns, colour = series.columns, style.MODEL_COLOURS[model]
    if "x_d" in columns:
        axes.plot(columns["y_d"], columns["x_d"], "--", color=style.REFERENCE, label="reference")
    label = "sailed" if model == "recording" else f"{model} model"
    return axes.plot(columns["y"], columns["x"], color=colour, label=label)[0]


def _places(series: Series, rows: Any = slice(None)) -> tuple[Sample, Sample]:
    """Return east and north [m] of the positions in some rows of a series."""
    return series.columns["y"][rows], series.columns["x"][rows]


def _plane(axes: Axes, north: Sample, east: Sample) -> None:
    """Give axes the limits of north and east [m], shape (2,) each, equal scales and labels."""
    axes.set(xlim=tuple(east), ylim=tuple(north), xlabel="East [m]", ylabel="North [m]")
    axes.set_aspect("equal", adjustable="box")


def _polygons(axes: Axes, series: Series, **look: Any) -> None:
    """Draw the polygons of a series, those of waters and land, but for number 0."""
    numbers = series.columns["polygon"]
    for number in np.unique(numbers[numbers > 0.0]):
        corners = np.column_stack(_places(series, numbers == number))
        axes.add_patch(Polygon(corners, facecolor=style.LAND, zorder=0.5, **look))


def hull_of(harbour: Series) -> Sample:
    """Return the corners of the hull of a docking, body axes, (n, 2) [m]."""
    east, north = _places(harbour, harbour.columns["polygon"] == 0.0)
    return np.column_stack([north, east])


def draw_harbour(axes: Axes, harbour: Series, voyage: Series) -> None:
    """Draw the land, and the outline of the hull in its berth, the last set-point of a voyage."""
    _polygons(axes, harbour)
    north, east, psi = (float(voyage.columns[f"{name}_setpoint"][-1]) for name in ("x", "y", "psi"))
    berth = Polygon(outline(north, east, psi, 1.0, hull_of(harbour)), fill=False, linestyle="--",
                    edgecolor=style.REFERENCE, label="berth", zorder=4)  # fmt: skip
    axes.add_patch(berth)


def _drawing(
    results: Queries, run: StoredRun, voyages: selection.Voyages, absent: list[str],
    harbour: Series | None,
) -> style.Drawing:  # fmt: skip
    series_of = list(voyages.values())
    windy = any(NORTH in series.columns for series in series_of)
    ranges = []  # smallest and largest north and east [m], each of shape (2,)
    for names in (("x", "x_d"), ("y", "y_d")):
        values = [s.columns[name] for s in series_of for name in names if name in s.columns]
        ranges.append(np.array([min(map(np.nanmin, values)), max(map(np.nanmax, values))]))
    extent = max(float(np.ptp(limits)) for limits in ranges)
    length, note = drawn_length(results.reader.run(run.id).config, extent)
    room, spacing = (0.55, SPACING) if harbour is None else (1.4, DOCKING_SPACING)  # of hulls
    margin = max((0.06 + ARROW_SHARE * windy) * extent + 1e-9, room * length)
    least = 0.5 * SLENDEREST * (extent + 2.0 * margin)
    halves = [max(0.5 * float(np.ptp(limits)) + margin, least) for limits in ranges]
    each = zip(ranges, halves, strict=True)
    north, east = (np.mean(limits) + half * np.array([-1.0, 1.0]) for limits, half in each)
    height, rows = 0.9 + SIDE * min(float(np.ptp(north) / np.ptp(east)), 1.6), 1
    if harbour is not None:
        height, rows = 0.5 * (height + FORCES), 2
    figure, axes = style.panels(rows, len(voyages), SIDE, height)
    for panel, (model, series) in zip(axes, voyages.items(), strict=False):
        colour = draw_track(panel, model, series).get_color()
        columns, hull = series.columns, None if harbour is None else hull_of(harbour)
        if "psi" in columns:
            steps = np.hypot(np.diff(columns["x"]), np.diff(columns["y"]))
            sailed = np.concatenate([[0.0], np.cumsum(steps)])
            number = int(np.clip(sailed[-1] / (length * spacing), 1, MARKS))
            marks = np.linspace(0.0, sailed[-1], number + 1)[1:]  # the last sample is one of them
            for index in np.unique(np.searchsorted(sailed, marks).clip(0, len(sailed) - 1)):
                x, y, psi = (float(columns[name][index]) for name in ("x", "y", "psi"))
                corners = outline(x, y, psi, length, hull)
                panel.add_patch(Polygon(corners, closed=True, fill=False, edgecolor=colour))
        if harbour is not None:
            draw_harbour(panel, harbour, series)
        if NORTH in columns:
            _arrows(panel, series, max(np.ptp(north), np.ptp(east)))
        panel.plot(*_places(series, 0), "o", **START)
        _plane(panel, north, east)
    if harbour is not None:
        _forces(axes, series_of, (2.0 * height - FORCES) / FORCES)
    notes = [f"{note}, at equal distances sailed"]
    notes += ["arrows: direction and speed of the wind at the position of the tip"] * windy
    name, title = f"track-run-{run.id}", f"Track, {selection.subtitle(run)}"
    return style.drawing_of(name, figure, axes, title, [*notes, *absent])


def _forces(axes: Sequence[Axes], series_of: Sequence[Series], ratio: float) -> None:
    """Draw force over time in the lower half of the axes, each DOF relative to its largest.

    `ratio` is the height of the upper panels over that of these.
    """
    grid = axes[0].get_gridspec()
    assert grid is not None
    grid.set_height_ratios([ratio, 1.0] * (grid.nrows // 2))
    labels, peaks = {}, {}
    for dof in ("surge", "sway", "yaw"):
        peaks[dof] = style.largest_of([series.columns[f"tau_{dof}"] for series in series_of]) or 1.0
        unit, size = style.prefixed(series_of[0].units[f"tau_{dof}"], peaks[dof])
        labels[dof] = f"{dof}, up to {number_text(peaks[dof] / size, 3)} {unit}"
    for panel, series in zip(axes[len(series_of) :], series_of, strict=True):
        curves = list[style.Curve]()
        for (dof, peak), colour in zip(peaks.items(), style.PALETTE[1:], strict=False):
            force = series.columns[f"tau_{dof}"] / peak
            curves.append(style.Curve(series.columns["t"], force, colour, labels[dof]))
        style.over_time(panel, "Force / largest", curves, linewidth=0.9)


def _arrows(axes: Axes, series: Series, extent: float) -> None:
    """Draw the mean wind of equal parts of the time; each tip is the vessel at mid-time."""
    columns = series.columns
    parts = [part for part in np.array_split(np.arange(len(columns["t"])), ARROWS) if len(part)]
    wind = np.array([[np.mean(columns[w][part]) for w in (EAST, NORTH)] for part in parts])
    middle = [part[len(part) // 2] for part in parts]
    strongest = float(np.max(np.hypot(*wind.T)))
    if strongest > 0.0:
        axes.quiver(
            *_places(series, middle), *wind.T, color=style.WIND, pivot="tip", angles="xy",
            units="inches", scale_units="xy", width=0.025, zorder=3,
            scale=strongest / (ARROW_SHARE * extent + 1e-9),
        )  # fmt: skip
        label = f"wind, up to {number_text(strongest, 3)} m/s"
        axes.plot([], [], color=style.WIND, marker=">", linewidth=2.0, label=label)


def _plan(results: Queries, run: StoredRun, plan: Series, recording: Series) -> style.Drawing:
    """Draw the planned path in its waters, manoeuvres by colour, and the recorded track.

    Each repetition of a manoeuvre begins with a dot and is thin if it is held out for testing.
    """
    waters, columns = results.reader.series(run.id, "waters"), plan.columns
    margin = 0.03 * max(float(np.ptp(waters.columns[name])) for name in ("x", "y"))
    north, east = (
        np.array([np.min(waters.columns[name]) - margin, np.max(waters.columns[name]) + margin])
        for name in ("x", "y")
    )
    height = 1.2 + 0.9 * PLAN_SIDE * float(np.clip(np.ptp(north) / np.ptp(east), 0.4, 1.6))
    figure, (axes,) = style.panels(1, 1, PLAN_SIDE, height)
    area = _places(waters, waters.columns["polygon"] == 0.0)
    axes.set_facecolor(style.SHADE)
    axes.grid(visible=False)
    axes.fill(*area, facecolor="white", edgecolor=style.MUTED, zorder=0.5)
    _polygons(axes, waters, edgecolor=style.MUTED, hatch="///")
    axes.plot(*_places(recording), color=style.MUTED, linewidth=0.9, label="sailed", zorder=2.2)
    look: dict[str, Any] = {"color": style.REFERENCE, "linewidth": 1.2, "zorder": 2.5}
    for i, (a, b) in enumerate(style.intervals(columns["manoeuvre"] < 0.0)):
        axes.plot(*_places(plan, slice(a, b + 1)), ":", label=None if i else "passage", **look)
    names = ("mix_count", "plan_deviation", "sailed_clearance")
    rows = results.diagnostics(names, Condition(runs=(run.id,)))
    counts, values = rows[rows["name"] == "mix_count"], rows.set_index("name")["value"]
    held_out = columns["role"] == TESTING
    for k, (number, name) in enumerate(sorted(zip(counts["i"], counts["label"], strict=True))):
        parts, colour = style.intervals(columns["manoeuvre"] == number), style.colour_of(k)
        # the first line, which is in the legend, is thick
        for i, (a, b) in enumerate(sorted(parts.tolist(), key=lambda part: held_out[part[0]])):
            look = {"linewidth": 1.4 if held_out[a] else 2.6, "label": None if i else name}
            look |= {"marker": "o", "markersize": 4, "markevery": [0], "zorder": 3}
            axes.plot(*_places(plan, slice(a, b + 1)), color=colour, **look)
    look = {"color": style.REFERENCE, "markersize": 9, "zorder": 4}
    axes.plot(*_places(plan, 0), "o", label="start", **look)
    axes.plot(*_places(plan, -1), "s", label="goal", fillstyle="none", **look)
    _plane(axes, north, east)
    clearance = float(waters.columns["clearance"][0])
    notes = [f"clearance of the plan: {clearance:g} m; thin: held out for testing"]
    if {"plan_deviation", "sailed_clearance"} <= {*values.index}:
        notes.append(
            f"the vessel deviated from the plan by at most {values['plan_deviation']:.3g} m and"
            f" came within {values['sailed_clearance']:.3g} m of an obstacle or the boundary"
        )
    name, title = f"track-plan-run-{run.id}", f"Track and plan, {selection.subtitle(run)}"
    return style.drawing_of(name, figure, [axes], title, notes)
