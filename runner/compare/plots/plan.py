"""The planned path of a mix in its waters: north up, east right, manoeuvres by colour.

Series `plan` (poses, with the number of the manoeuvre, -1 on a passage) and `waters` (corners of
the area and the obstacles); the sailed track is that of the series `recording`.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MUTED,
    PALETTE,
    REFERENCE,
    SHADE,
    Drawing,
    footnote,
    headed,
    panels,
    trim,
)
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.rows import Series

FIGURE = Figure(
    "plan",
    "The planned path of an informative mix in its waters.",
    "series plan, of excitation=mix with a route",
    caption="Planned path of the newest mix",
    place=8,
)

Flags = NDArray[np.bool_]
TESTING = 2.0
WIDTH = 6.4
STYLES = ("-", (0, (5, 1)), (0, (1, 0.6)))  # for more manoeuvres than colours


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level)."""
    return [_drawing(results, request, run) for run, _ in each_run(results, request, ("plan",))]


def _drawing(results: Queries, request: PlotRequest, run: StoredRun) -> Drawing:
    plan = results.reader.series(run.id, "plan")
    waters = results.reader.series(run.id, "waters")
    margin = 0.03 * max(float(np.ptp(waters.columns[name])) for name in ("x", "y"))
    north, east = (
        np.array([np.min(waters.columns[name]) - margin, np.max(waters.columns[name]) + margin])
        for name in ("x", "y")
    )
    ratio = float(np.clip(np.ptp(north) / np.ptp(east), 0.4, 1.6))
    figure, axes = panels(1, 1, WIDTH, 1.2 + 0.9 * WIDTH * ratio)
    _waters(axes[0], waters)
    deviation = _track(axes[0], results, run)
    for i, part in enumerate(_intervals(plan.columns["manoeuvre"] < 0.0)):
        passage = plan.columns["y"][part], plan.columns["x"][part]
        label = None if i else "passage"
        axes[0].plot(*passage, ":", color=REFERENCE, linewidth=1.2, label=label, zorder=2.5)
    rows = results.diagnostics([run], ("mix_count",), Condition(run=run.id))[run.id]
    if not rows:
        raise ConfigurationError(f"plot plan: run {run.id} has no diagnostic mix_count")
    for number, name in {int(row.i): str(row.label) for row in rows}.items():
        _manoeuvre(axes[0], plan, number, name)
    _ends(axes[0], plan)
    axes[0].set_xlim(*east)
    axes[0].set_ylim(*north)
    axes[0].set_aspect("equal", adjustable="box")
    axes[0].set_xlabel("East [m]")
    axes[0].set_ylabel("North [m]")
    headed(figure, axes, f"Plan, {subtitle(run)}")
    clearance = float(waters.columns["clearance"][0])
    notes = [f"clearance of the plan: {clearance:g} m; thin: held out for testing", *deviation]
    footnote(figure, notes)
    trim(figure)
    return Drawing(f"plan-run-{run.id}", figure)


def _waters(axes: Axes, waters: Series) -> None:
    """Draw the area in white on grey and the obstacles hatched."""
    axes.set_facecolor(SHADE)
    axes.grid(visible=False)
    numbers = waters.columns["polygon"]
    corners = np.column_stack([waters.columns["y"], waters.columns["x"]])
    for number in np.unique(numbers):
        polygon = corners[numbers == number]
        if number == 0:
            axes.add_patch(Polygon(polygon, facecolor="white", edgecolor=MUTED, zorder=0.5))
        else:
            axes.add_patch(
                Polygon(polygon, facecolor="#D9D9D9", edgecolor=MUTED, hatch="///", zorder=0.6)
            )


def _intervals(chosen: Flags) -> list[slice]:
    """Return the intervals of consecutive chosen samples, each with the sample after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return [slice(int(a), int(b) + 1) for a, b in edges.reshape(-1, 2)]


def _manoeuvre(axes: Axes, plan: Series, number: int, name: str) -> None:
    """Draw each repetition of a manoeuvre from a dot on; thin if it is held out for testing."""
    columns = plan.columns
    kinds = sorted({int(n) for n in columns["manoeuvre"] if n >= 0.0})
    if number not in kinds:
        return
    place = kinds.index(number)
    colour, style = PALETTE[place % len(PALETTE)], STYLES[place // len(PALETTE) % len(STYLES)]
    parts = _intervals(columns["manoeuvre"] == number)
    # the first line, which is in the legend, is thick
    parts.sort(key=lambda part: columns["role"][part.start] == TESTING)
    for i, part in enumerate(parts):
        thin = columns["role"][part.start] == TESTING
        axes.plot(
            columns["y"][part], columns["x"][part], color=colour, linestyle=style,
            linewidth=1.4 if thin else 2.6, label=None if i else name, zorder=3,
        )  # fmt: skip
        axes.plot(
            columns["y"][part.start], columns["x"][part.start], "o", color=colour, markersize=4,
            zorder=3.2,
        )  # fmt: skip


def _ends(axes: Axes, plan: Series) -> None:
    """Draw start and goal with their headings."""
    columns = plan.columns
    reach = 0.03 * max(np.ptp(columns["x"]), np.ptp(columns["y"]), 1e-9)
    for index, label, marker, size in ((0, "start", "o", 7), (-1, "goal", "s", 12)):
        east, north, psi = (float(columns[name][index]) for name in ("y", "x", "psi"))
        axes.plot(
            east, north, marker, color=REFERENCE, markersize=size, label=label, zorder=4,
            markerfacecolor="none" if label == "goal" else REFERENCE, linestyle="none",
        )  # fmt: skip
        axes.annotate(
            "", (east + 2.2 * reach * np.sin(psi), north + 2.2 * reach * np.cos(psi)),
            (east, north), arrowprops={"arrowstyle": "->", "color": REFERENCE}, zorder=4,
        )  # fmt: skip


def _track(axes: Axes, results: Queries, run: StoredRun) -> list[str]:
    """Draw the recorded track; return a note on its deviation from the plan."""
    recording = results.reader.series(run.id, "recording")
    east, north = recording.columns["y"], recording.columns["x"]
    axes.plot(east, north, color=MUTED, linewidth=0.9, label="sailed", zorder=2.2)
    names = ("plan_deviation", "sailed_clearance")
    rows = results.diagnostics([run], names, Condition(run=run.id))[run.id]
    values = {row.name: row.value for row in rows}
    if not all(name in values for name in names):
        return []
    return [
        f"the vessel deviated from the plan by at most {values['plan_deviation']:.3g} m and came "
        f"within {values['sailed_clearance']:.3g} m of an obstacle or the boundary"
    ]
