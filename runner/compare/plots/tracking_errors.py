"""Tracking errors over time with the nominal and the identified model."""

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.plots import selection, style

FIGURE = Figure(
    "errors", "Tracking errors of one run over time.", "series deployment_*", ("run", "facet"),
    place=9,
)  # fmt: skip

ERRORS = {  # label, unit, and its size in the stored one
    "e_pos": ("Position error", "m", 1.0),
    "e_psi": ("Heading error", "deg", float(np.radians(1.0))),
}


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, series_of: selection.Voyages
) -> style.Drawing:
    """Draw the error of position and, if any, of heading."""
    voyages, absent = selection.distinct(results, run, series_of)
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
                curves.append(style.Curve(series.columns["t"], values, colour, *words))
        style.over_time(panel, f"{label} [{unit}]", curves, linewidth=1.1)
    notes = ["dashed, and at the right: mean absolute error (MAE)", *absent]
    title = f"Tracking error, {selection.subtitle(run)}"
    return style.drawing_of(f"errors-run-{run.id}", figure, axes, title, notes)


drawings = selection.per_run(_drawing, *selection.DEPLOYMENTS)
