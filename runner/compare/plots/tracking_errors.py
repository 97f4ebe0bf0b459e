"""Tracking errors over time with the nominal and the identified model."""

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.plots.request import PlotRequest, Voyages, degrees, subtitle, voyages
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    Drawing,
    beside,
    footnote,
    headed,
    panels,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series

FIGURE = Figure(
    "errors",
    "Tracking errors of one run over time.",
    "series deployment_*",
    caption="Tracking error of the newest deployed run",
    place=9,
)

ERRORS = (("e_pos", "Position error", "m"), ("e_psi", "Heading error", "deg"))


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level): position and, if any, heading."""
    return [_drawing(run, missions) for run, missions in voyages(results, request, "plot errors")]


def _drawing(run: StoredRun, missions: Voyages) -> Drawing:
    errors = [error for error in ERRORS if any(error[0] in v.columns for v in missions.values())]
    figure, axes = panels(len(errors), 1, 8.0, 2.5, share_x=True)
    for panel, (name, label, unit) in zip(axes, errors, strict=True):
        panel.axhline(0.0, color="black", linewidth=0.8)
        texts = [
            _line(panel, series, name, model, unit)
            for model, series in missions.items()
            if name in series.columns
        ]
        panel.margins(x=0)
        beside(panel, texts)
        panel.set_ylabel(f"{label} [{unit}]")
    axes[-1].set_xlabel("Time [s]")
    headed(figure, axes, f"Tracking error, {subtitle(run)}")
    footnote(figure, ["dashed, and at the right: mean absolute error (MAE)"])
    return Drawing(f"errors-run-{run.id}", figure)


def _line(axes: Axes, series: Series, name: str, model: str, unit: str) -> tuple[float, str, str]:
    """Draw an error and its mean; return the text on it for the side of the panel."""
    values: Sample = series.columns[name]
    if series.units[name] == "rad":
        values = degrees(values)
    colour = MODEL_COLOURS[model]
    axes.plot(series.columns["t"], values, color=colour, label=f"{model} model", linewidth=1.1)
    mean = float(np.mean(np.abs(values)))
    axes.axhline(mean, color=colour, linewidth=0.8, linestyle="--")
    return mean, f"MAE {number_text(mean, 3)} {unit}", colour
