"""Consistency of velocity and position of a measured recording over time.

Left: integral of the velocity minus the position. Right: derivative of the position minus the
velocity. The largest error is marked.
"""

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle
from seatrial.runner.compare.plots.style import MODEL_COLOURS, Drawing, footnote, headed, panels
from seatrial.runner.compare.results import Results, Run
from seatrial.runner.database.records import Series

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


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), two panels for each DOF."""
    return [_drawing(results, run) for run, _ in each_run(results, request, ["quality"])]


def _drawing(results: Results, run: Run) -> Drawing:
    series = results.reader.series(run.id, "quality")
    rows = [i for i, name in enumerate(SIDES[0][0]) if f"{name}_error" in series.columns]
    figure, axes = panels(len(rows), len(SIDES), 4.2, 2.3, share_x=True)
    for row, i in enumerate(rows):
        for side, (names, _) in enumerate(SIDES):
            _panel(axes[row * len(SIDES) + side], series, names[i])
    for side, (_, title) in enumerate(SIDES):
        axes[side].set_title(title, loc="left", fontsize=9)
        axes[side - len(SIDES)].set_xlabel(with_unit("Time", series.units["t"]))
    headed(figure, axes, f"Quality of the recording, {subtitle(run)}")
    footnote(figure, ["circle: the largest error"])
    return Drawing(f"quality-run-{run.id}", figure)


def _panel(axes: Axes, series: Series, name: str) -> None:
    t, error = series.columns["t"], series.columns[f"{name}_error"]
    unit = series.units[f"{name}_error"]
    axes.plot(t, error, color=MODEL_COLOURS["identified"], linewidth=0.9)
    worst = int(np.nanargmax(np.abs(error)))
    axes.plot(t[worst], error[worst], "o", markerfacecolor="none", color=MODEL_COLOURS["nominal"])
    largest = f"max {number_text(abs(float(error[worst])), 3)} {unit_text(unit)}"
    axes.text(0.98, 0.96, largest, transform=axes.transAxes, ha="right", va="top", fontsize=8.5)
    axes.set_ylabel(with_unit(name, unit))
    axes.margins(x=0, y=0.18)
