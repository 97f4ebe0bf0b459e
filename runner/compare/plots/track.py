"""The sailed track in NED: north up, east right, equal axes, with reference and headings."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from runner.database.records import Series

from ..grid import with_unit
from ..results import Results
from ..statistics import Sample
from .deployment import voyages
from .request import PlotRequest, subtitle
from .style import MODEL_COLOURS, REFERENCE, Drawing, footnote, headed, panels

MARKS = 24  # hulls along a track
# A hull of length 1 seen from above, bow to +x: body x and y of its corners, shape (5, 2).
HULL = np.array([[0.5, 0.0], [0.2, 0.18], [-0.5, 0.18], [-0.5, -0.18], [0.2, -0.18]])
HULL_SHARE = 0.045  # its length, of the larger side of the picture


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """One figure of one run, nominal and identified model side by side on the same scale."""
    run, found = voyages(results, request, "track")
    north, east = _limits(list(found.values()))
    side = 4.6
    height = side * float(np.clip(np.ptp(north) / np.ptp(east), 0.45, 1.6))
    made, axes = panels(1, len(found), side, height + 0.9)
    for one, (model, series) in zip(axes, found.items(), strict=True):
        _panel(one, model, series, max(np.ptp(north), np.ptp(east)))
        one.set_xlim(*east)
        one.set_ylim(*north)
    headed(made, axes, f"Track, {subtitle(run)}")
    footnote(made, ["hull outlines, not to scale: position and heading at equal distances sailed"])
    return [Drawing(f"track-run-{run.id}", made)]


def _limits(voyages: list[Series]) -> tuple[Sample, Sample]:
    """Shared limits of north and east [m], each shape (2,), with a margin."""
    found = []
    for plain, desired in (("x", "x_d"), ("y", "y_d")):
        names = (plain, desired)
        values = np.concatenate(
            [v.columns[name] for v in voyages for name in names if name in v.columns]
        )
        found.append(np.array([np.nanmin(values), np.nanmax(values)]))
    margin = 0.06 * max(float(np.ptp(limits)) for limits in found) + 1e-9
    north, east = (limits + np.array([-margin, margin]) for limits in found)
    return north, east


def _panel(axes: Axes, model: str, series: Series, extent: float) -> None:
    columns, colour = series.columns, MODEL_COLOURS[model]
    if "x_d" in columns:
        axes.plot(columns["y_d"], columns["x_d"], "--", color=REFERENCE, label="reference")
    axes.plot(columns["y"][0], columns["x"][0], "o", color=REFERENCE, markersize=6, label="start")
    axes.plot(columns["y"], columns["x"], color=colour, label=f"{model} model")
    if "psi" in columns:
        for at in _evenly(columns["x"], columns["y"]):
            north, east, psi = (float(columns[name][at]) for name in ("x", "y", "psi"))
            axes.add_patch(_hull(north, east, psi, HULL_SHARE * extent, colour))
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(with_unit("East", series.units["y"]))
    axes.set_ylabel(with_unit("North", series.units["x"]))


def _evenly(north: Sample, east: Sample) -> list[int]:
    """Samples at equal distances along the track: a vessel that waits gets no pile of hulls."""
    sailed = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(north), np.diff(east)))])
    marks = np.linspace(0.0, sailed[-1], MARKS + 1)[1:]
    return sorted({int(at) for at in np.searchsorted(sailed, marks).clip(0, len(sailed) - 1)})


def _hull(north: float, east: float, psi: float, length: float, colour: str) -> Polygon:
    """The hull at a pose; body to NED by the rotation about the down axis, psi [rad]."""
    forward, right = length * HULL[:, 0], length * HULL[:, 1]
    norths = north + np.cos(psi) * forward - np.sin(psi) * right
    easts = east + np.sin(psi) * forward + np.cos(psi) * right
    corners = np.column_stack([easts, norths])
    return Polygon(corners, closed=True, fill=False, edgecolor=colour, linewidth=1.0)
