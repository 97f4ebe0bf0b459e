"""Measured velocities over time, and those that the models predict in a free run.

With `--band` the poses too, and about the prediction of the identified model the band of that level
for what is measured, by what the data leave open of its parameters and its model error.
"""

from collections.abc import Mapping, Sequence

import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.benchmark import half_width
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import selection, style
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, IDENTIFIED_STD, POSES, SAILED

FIGURE = Figure(
    "prediction",
    "Velocities of one run, measured and predicted in a free run over the held-out part.",
    "series prediction", ("run", "dof", "facet", "band"), place=17,
)  # fmt: skip

ROOM = 3.0  # standard deviations of the measured velocity around its range that are shown
Line = tuple[str, Sample | None, str]  # label, values over time if there are any, colour


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, series_of: Mapping[str, Series]
) -> style.Drawing:
    """Draw one panel for each DOF."""
    series = series_of["prediction"]
    columns, band = series.columns, request.band
    names = request.shown(columns.__contains__, f"run {run.id} has no prediction")
    piece = " of each piece" if np.sum(columns["start"]) > 1 else ""
    notes = [f"predictions begin at the first measured state{piece}; FIT at the right: 100 % is"
             " perfect"]  # fmt: skip
    if band is not None:
        if not 0.0 < band < 100.0:
            raise ConfigurationError(f"plot prediction: --band: got {band:g}, expected 0 to 100")
        names = [*(POSES[DOFS.index(dof)] for dof in names), *names]
        names = [name for name in names if f"{name}_{IDENTIFIED_STD}" in columns]
        notes.append(
            f"band: {band:g} % of what is measured, by what the data leave open of the parameters,"
            " the model error and the noise"
        )
    if not names:
        raise ConfigurationError(
            f"plot prediction: run {run.id} has no bands: its identifier gives no distribution, or"
            " its draws diverge"
        )
    figure, axes = style.panels(len(names), 1, 8.0, 2.3, share_x=True)
    for panel, name in zip(axes, names, strict=True):
        if band is not None:
            half = half_width(columns[f"{name}_{IDENTIFIED_STD}"], 0.01 * band)
            t, middle, half = _with_gaps(series, columns[f"{name}_identified"], half)
            panel.fill_between(
                t, middle - half, middle + half, alpha=0.2, linewidth=0, label=f"{band:g} % band",
                color=style.MODEL_COLOURS["identified"],
            )  # fmt: skip
        lines = [(m, columns.get(f"{name}_{m}"), style.MODEL_COLOURS[m]) for m in SAILED]
        _draw_motion(panel, series, name, lines)
    reasons = results.diagnostics(("no_prediction",), Condition(runs=(run.id,)))["label"]
    notes += [f"no prediction: {reason}" for reason in reasons]
    title = f"Free run, {selection.subtitle(run)}"
    return style.drawing_of(f"prediction-run-{run.id}", figure, axes, title, notes)


def free_runs(
    title: str, runs: Mapping[str, Series], outputs: Sequence[str]
) -> matplotlib.figure.Figure:
    """Return the measured velocities of a test file and those of the free runs of several entrants.

    `runs` are the series `prediction` by entrant; each of the `outputs`, velocities, has a panel.
    """
    first = next(iter(runs.values()))
    figure, axes = style.panels(len(outputs), 1, 7.0, 1.9, share_x=True)
    others = iter(style.PALETTE[k] for k in (0, 2, 3, 4, 7))
    none = style.MODEL_COLOURS["nominal"]
    colours = {name: none if name == "none" else next(others) for name in runs}
    for panel, dof in zip(axes, outputs, strict=True):
        name = f"{dof}_identified"
        lines = [(each, run.columns.get(name), colours[each]) for each, run in runs.items()]
        _draw_motion(panel, first, dof, lines)
    return style.drawing_of("velocities", figure, axes, title).figure


def _draw_motion(axes: Axes, series: Series, name: str, lines: Sequence[Line]) -> None:
    """Draw a measured motion and predictions of it over time, with their FIT at the right.

    `series` has the time, the pieces and the measured motion in the column `name`. A prediction
    that runs away leaves the panel.
    """
    measured, curves = series.columns[name], []
    spread = float(np.std(measured))
    for label, values, colour in (("measured", measured, style.REFERENCE), *lines):
        if values is None:
            continue
        t, shown = _with_gaps(series, values)
        error = float(np.sqrt(np.mean(np.square(values - measured))))
        fit = f"{100.0 * (1.0 - error / spread):.0f} %" if spread else "-"
        text = "" if values is measured else "FIT diverges" if np.isnan(error) else f"FIT {fit}"
        curves.append(style.Curve(t, shown, colour, label, text))
    margin = ROOM * spread or 1.0
    room = float(np.min(measured)) - margin, float(np.max(measured)) + margin
    label = with_unit(name.capitalize(), series.units[name])
    style.over_time(axes, label, curves, room, linewidth=0.9, alpha=0.9)


def _with_gaps(series: Series, *signals: Sample) -> list[Sample]:
    """Return time and signals with NaN before each piece, so that no line joins two pieces."""
    gaps = np.flatnonzero(series.columns["start"] > 0.0)[1:]
    return [np.insert(values, gaps, np.nan) for values in (series.columns["t"], *signals)]


drawings = selection.per_run(_drawing, "prediction")
