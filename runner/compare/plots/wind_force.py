"""The wind of a run: its speed, its direction and its force on the vessel."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.request import PREFIX, PlotRequest, distinct, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    WIND,
    Drawing,
    beside,
    footnote,
    headed,
    largest_of,
    panels,
    prefixed,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series

FIGURE = Figure(
    "wind",
    "Speed, direction and force of the wind in one run.",
    "a series with the column wind_north",
    caption="Wind of the newest run with wind",
    place=14,
)

VOYAGES = ("deployment_nominal", "deployment_identified")
KINDS = (*VOYAGES, "recording")
NORTH, EAST = "wind_north", "wind_east"
CALM_M_S = 1e-6  # below it wind has no direction
ROUNDING = 1e-9  # of the mean, a deviation that is none
NARROWEST_DEG = 10.0  # smallest half-range of the direction


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level).

    It is the wind of the mission, or without a deployment that of the recording.
    """
    figures = []
    for run, kinds in each_run(results, request, KINDS, NORTH):
        sailed = [kind for kind in kinds if kind in VOYAGES] or kinds
        series_of = {
            kind.removeprefix(PREFIX): results.reader.series(run.id, kind) for kind in sailed
        }
        figures.append(_drawing(run, distinct(series_of), request))
    return figures


def _drawing(run: StoredRun, series_of: Mapping[str, Series], request: PlotRequest) -> Drawing:
    """Draw the wind, which is that of every model, and its force on each."""
    first = next(iter(series_of.values()))
    dofs = request.shown(lambda dof: any(f"wind_{dof}" in s.columns for s in series_of.values()))
    figure, axes = panels(2 + len(dofs), 1, 8.0, 2.1, share_x=True)
    north, east = first.columns[NORTH], first.columns[EAST]
    t, speed = first.columns["t"], np.hypot(north, east)
    axes[0].plot(t, speed, color=WIND)
    axes[0].set_ylim(0.0, 1.1 * max(float(np.nanmax(speed)), CALM_M_S))
    axes[0].set_ylabel("Wind speed [m/s]")
    beside(axes[0], [_statistics(speed, "m/s", WIND)])
    direction = blown_to(north, east)
    axes[1].plot(t, direction, color=WIND)
    middle = float(np.nanmean(direction)) if np.any(np.isfinite(direction)) else 0.0
    low, high = axes[1].get_ylim()
    axes[1].set_ylim(min(low, middle - NARROWEST_DEG), max(high, middle + NARROWEST_DEG))
    axes[1].set_ylabel("Blows to [deg]")
    beside(axes[1], [_statistics(direction, "deg", WIND)])
    for panel, dof in zip(axes[2:], dofs, strict=True):
        _forces(panel, series_of, dof)
    for panel in axes:
        panel.margins(x=0)
    axes[-1].set_xlabel(with_unit("Time", first.units["t"]))
    headed(figure, axes, f"Wind, {subtitle(run)}")
    what = "the recording" if list(series_of) == ["recording"] else "the mission"
    footnote(figure, [f"time of {what}; direction from north over east; means and deviations at "
                      "the right"])  # fmt: skip
    return Drawing(f"wind-run-{run.id}", figure)


def blown_to(north: Sample, east: Sample) -> Sample:
    """Return the direction that the wind blows to [deg], shape (n,), its mean in [0, 360).

    `north` and `east` are the wind velocities [m/s], shape (n,). The direction is unwrapped, and
    NaN for calm air.
    """
    angle = np.degrees(np.unwrap(np.arctan2(east, north)))
    angle -= 360.0 * np.floor(np.mean(angle) / 360.0)
    return np.where(np.hypot(north, east) > CALM_M_S, angle, np.nan)


def _forces(axes: Axes, series_of: Mapping[str, Series], dof: str) -> None:
    """Draw the force of the wind in every series that has it, from zero on."""
    axes.axhline(0.0, color="black", linewidth=0.8)
    column, texts = f"wind_{dof}", []
    shown = {m: s for m, s in series_of.items() if column in s.columns}
    stored = next(iter(shown.values())).units[column]
    unit, size = prefixed(stored, largest_of([s.columns[column] for s in shown.values()]))
    for model, series in shown.items():
        colour = WIND if model == "recording" else MODEL_COLOURS[model]
        label = "force" if model == "recording" else f"force, sailed with {model} model"
        values = series.columns[column] / size
        axes.plot(series.columns["t"], values, color=colour, linewidth=1.0, label=label)
        texts.append(_statistics(values, unit, colour))
    axes.set_ylabel(with_unit(dof.capitalize(), unit))
    beside(axes, texts)


def _statistics(values: Sample, unit: str, colour: str) -> tuple[float, str, str]:
    """Return the mean of a signal, and the text on it for the side of its panel."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, "", colour
    mean, deviation = float(np.mean(finite)), float(np.std(finite))
    deviation = 0.0 if deviation < ROUNDING * abs(mean) else deviation
    text = f"{number_text(mean, 3)} ± {number_text(deviation, 3)} {unit_text(unit)}"
    return mean, text, colour
