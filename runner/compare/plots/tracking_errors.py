"""Tracking errors over time with the nominal and the identified model."""

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.request import (
    DEPLOYMENTS,
    PlotRequest,
    Voyages,
    distinct,
    each_run,
    subtitle,
)
from seatrial.runner.compare.plots.style import Drawing

FIGURE = Figure(
    "errors",
    "Tracking errors of one run over time.",
    "series deployment_*",
    ("run", "facet"),
    caption="Tracking error of the newest deployed run",
    place=9,
)

# Label, unit, and its size in the stored one.
ERRORS = {
    "e_pos": ("Position error", "m", 1.0),
    "e_psi": ("Heading error", "deg", float(np.radians(1.0))),
}


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level): position and, if any, heading."""
    return [
        _drawing(run, *distinct(results, run, series_of))
        for run, series_of in each_run(results, request, DEPLOYMENTS)
    ]


def _drawing(run: StoredRun, voyages: Voyages, absent: list[str]) -> Drawing:
    errors = [name for name in ERRORS if any(name in v.columns for v in voyages.values())]
    if not errors:
        raise ConfigurationError(f"plot errors: run {run.id} tracks no position or heading")
    figure, axes = style.panels(len(errors), 1, 8.0, 2.5, share_x=True)
    for panel, name in zip(axes, errors, strict=True):
        (label, unit, size), curves = ERRORS[name], []
        panel.axhline(0.0, color="black", linewidth=0.8)
        for model, series in voyages.items():
            if name in series.columns:
                values = series.columns[name] / size
                mean, colour = float(np.mean(np.abs(values))), style.MODEL_COLOURS[model]
                panel.axhline(mean, color=colour, linewidth=0.8, linestyle="--")
                words = f"{model} model", f"MAE {number_text(mean, 3)} {unit}"
                curves.append(style.Curve(series.columns["t"], values, colour, *words, mean))
        style.over_time(panel, f"{label} [{unit}]", curves, linewidth=1.1)
    notes = ["dashed, and at the right: mean absolute error (MAE)", *absent]
    title = f"Tracking error, {subtitle(run)}"
    return style.drawing_of(f"errors-run-{run.id}", figure, axes, title, notes)
