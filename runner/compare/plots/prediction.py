"""Measured velocities over time, and those that the models predict in a free run.

With `--band` the poses too, and about the prediction of the identified model the band in which the
measured values lie at that level, by what the data leave open of its parameters and its model
error.
"""

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.benchmark.scores import half_width
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    REFERENCE,
    Drawing,
    beside,
    footnote,
    headed,
    panels,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.vocabulary import DOFS, IDENTIFIED_STD, POSES

FIGURE = Figure(
    "prediction",
    "Velocities of one run, measured and predicted in a free run over the held-out part.",
    "series prediction",
    caption="Free run of the newest run's models over the held-out part",
    place=17,
)

MODELS = (("nominal", "nominal"), ("identified", "identified"))
ROOM = 3.0  # standard deviations of the measured velocity around its range that are shown


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one panel for each DOF."""
    return [
        _drawing(results, request, run) for run, _ in each_run(results, request, ["prediction"])
    ]


def _drawing(results: Queries, request: PlotRequest, run: StoredRun) -> Drawing:
    series = results.reader.series(run.id, "prediction")
    dofs = request.shown(lambda dof: dof in series.columns)
    if not dofs:
        raise ConfigurationError(f"plot prediction: run {run.id} has no prediction of these DOFs")
    names = dofs if request.band is None else _banded(series, dofs, request.band, run)
    figure, axes = panels(len(names), 1, 8.0, 2.3, share_x=True)
    for panel, name in zip(axes, names, strict=True):
        _panel(panel, series, name, request.band)
    axes[-1].set_xlabel(with_unit("Time", series.units["t"]))
    headed(figure, axes, f"Free run, {subtitle(run)}")
    begins = "the first measured state"
    if np.sum(series.columns["start"]) > 1:
        begins += " of each piece"
    notes = [f"predictions begin at {begins}; FIT at the right: 100 % is perfect"]
    if request.band is not None:
        notes.append(
            f"band: {request.band:g} % of what is measured, by what the data leave open of the"
            " parameters, the model error and the noise"
        )
    footnote(figure, notes)
    return Drawing(f"prediction-run-{run.id}", figure)


def _banded(series: Series, dofs: list[str], band: float, run: StoredRun) -> list[str]:
    """Return the poses and velocities that have a band; raises ConfigurationError if none does."""
    if not 0.0 < band < 100.0:
        raise ConfigurationError(f"plot prediction: --band: got {band:g}, expected 0 to 100 [%]")
    poses = [POSES[DOFS.index(dof)] for dof in dofs]
    names = [name for name in (*poses, *dofs) if f"{name}_{IDENTIFIED_STD}" in series.columns]
    if not names:
        raise ConfigurationError(
            f"plot prediction: run {run.id} has no bands: its identifier gives no distribution, or"
            " its draws diverge"
        )
    return names


def _panel(axes: Axes, series: Series, dof: str, band: float | None) -> None:
    measured, starts = series.columns[dof], series.columns["start"] > 0.0
    lines = [("measured", measured, REFERENCE)]
    for model, label in MODELS:
        values = series.columns.get(f"{dof}_{model}")
        if values is not None:
            lines.append((label, values, MODEL_COLOURS[model]))
    for label, values, colour in lines:
        # With a gap before each piece, so that no line joins two pieces.
        gaps = np.flatnonzero(starts)[1:]
        t, shown = (np.insert(each, gaps, np.nan) for each in (series.columns["t"], values))
        axes.plot(t, shown, color=colour, label=label, linewidth=0.9, alpha=0.9)
        if band is not None and label == "identified":
            half = half_width(series.columns[f"{dof}_{IDENTIFIED_STD}"], 0.01 * band)
            half = np.insert(half, gaps, np.nan)
            label = f"{band:g} % band"
            axes.fill_between(
                t, shown - half, shown + half, color=colour, alpha=0.2, linewidth=0, label=label
            )
    margin = ROOM * float(np.std(measured)) or 1.0  # a free run that runs away leaves the panel
    axes.set_ylim(
        *np.clip(axes.get_ylim(), np.min(measured) - margin, np.max(measured) + margin).tolist()
    )
    axes.set_ylabel(with_unit(dof.capitalize(), series.units[dof]))
    axes.margins(x=0)
    beside(axes, [(_end(v), f"FIT {fit_text(measured, v)}", colour) for _, v, colour in lines[1:]])


def _end(values: Sample) -> float:
    """Return the last finite value of a line, beside which its FIT is written."""
    finite = values[np.isfinite(values)]
    return float(finite[-1]) if len(finite) else float("nan")


def fit_text(measured: Sample, predicted: Sample) -> str:
    """Return the FIT of a prediction, or that it diverges."""
    if np.any(np.isnan(predicted)):
        return "diverges"
    spread = float(np.std(measured))
    if not spread:
        return "-"
    nrmse = float(np.sqrt(np.mean(np.square(predicted - measured)))) / spread
    return f"{100.0 * (1.0 - nrmse):.0f} %"
