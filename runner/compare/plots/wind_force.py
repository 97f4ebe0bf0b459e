"""The wind of a run: its speed, its direction and its force on the vessel."""

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    WIND,
    Drawing,
    footnote,
    headed,
    panels,
)
from seatrial.runner.compare.results import Results, Run
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.database.records import Series

FIGURE = Figure(
    "wind",
    "Speed, direction and force of the wind in one run.",
    "a series with the column wind_north",
    caption="Wind of the newest run with wind",
    place=14,
)

KINDS = ("recording", "deployment_nominal", "deployment_identified")
NORTH, EAST = "wind_north", "wind_east"
CALM_M_S = 1e-6  # below it wind has no direction


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level)."""
    figures = []
    for run, kinds in each_run(results, request, KINDS, NORTH):
        series_of = {kind: results.reader.series(run.id, kind) for kind in kinds}
        figures.append(_drawing(run, series_of, request))
    return figures


def _drawing(run: Run, series_of: dict[str, Series], request: PlotRequest) -> Drawing:
    """Draw the wind of the recording, else of a deployment, and the wind forces of both."""
    first = next(iter(series_of.values()))
    dofs = request.shown(lambda dof: any(f"wind_{dof}" in s.columns for s in series_of.values()))
    figure, axes = panels(2 + len(dofs), 1, 8.0, 2.1, share_x=True)
    north, east = first.columns[NORTH], first.columns[EAST]
    speed = np.hypot(north, east)
    _line(axes[0], first.columns["t"], speed, WIND, "m/s", None, 0.9)
    axes[0].set_ylim(bottom=0.0)
    axes[0].set_ylabel("Wind speed [m/s]")
    _line(axes[1], first.columns["t"], blown_to(north, east), WIND, "deg", None, 0.9)
    axes[1].set_ylabel("Blows to [deg]")
    for panel, dof in zip(axes[2:], dofs, strict=True):
        _forces(panel, series_of, dof)
    for panel in axes:
        panel.margins(x=0)
    axes[-1].set_xlabel(with_unit("Time", first.units["t"]))
    headed(figure, axes, f"Wind, {subtitle(run)}")
    footnote(figure, ["direction from north over east; means and deviations at the right"])
    return Drawing(f"wind-run-{run.id}", figure)


def blown_to(north: Sample, east: Sample) -> Sample:
    """Return the direction that the wind blows to [deg], shape (n,), its mean in [0, 360).

    `north` and `east` are the wind velocities [m/s], shape (n,). The direction is unwrapped, and
    NaN for calm air.
    """
    angle = np.degrees(np.unwrap(np.arctan2(east, north)))
    angle -= 360.0 * np.floor(np.mean(angle) / 360.0)
    return np.where(np.hypot(north, east) > CALM_M_S, angle, np.nan)


def _forces(axes: Axes, series_of: dict[str, Series], dof: str) -> None:
    axes.axhline(0.0, color="black", linewidth=0.8)
    heights = iter((0.94, 0.5, 0.06))
    for kind, series in series_of.items():
        column = f"wind_{dof}"
        if column in series.columns:
            model = kind.removeprefix("deployment_")
            colour = WIND if model == kind else MODEL_COLOURS[model]
            label = f"force, {model}" if model == kind else f"force, sailed with {model} model"
            unit = unit_text(series.units[column])
            values = series.columns[column], colour, unit, label, next(heights)
            _line(axes, series.columns["t"], *values)
            axes.set_ylabel(with_unit(dof.capitalize(), series.units[column]))


def _line(
    axes: Axes, t: Sample, values: Sample, colour: str, unit: str, label: str | None, height: float
) -> None:
    axes.plot(t, values, color=colour, linewidth=1.0, label=label)
    finite = values[np.isfinite(values)]
    if len(finite):
        mean, deviation = (
            number_text(float(statistic), 3) for statistic in (np.mean(finite), np.std(finite))
        )
        axes.text(
            1.005, height, f"{mean} ± {deviation} {unit}", transform=axes.transAxes, color=colour,
            fontsize=8.5, va="center",
        )  # fmt: skip
