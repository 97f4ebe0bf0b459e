"""Measured velocities over time, and those that the models predict in a free run.

With `--band` the poses too, and about the prediction of the identified model the band in which the
measured values lie at that level, by what the data leave open of its parameters and its model
error.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.benchmark.scores import half_width
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import PlotRequest, diagnostics_of, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    REFERENCE,
    Drawing,
    beside,
    drawing_of,
    panels,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, IDENTIFIED_STD, POSES

FIGURE = Figure(
    "prediction",
    "Velocities of one run, measured and predicted in a free run over the held-out part.",
    "series prediction",
    ("run", "dof", "facet", "band"),
    caption="Free run of the newest run's models over the held-out part",
    place=17,
)

MODELS = ("nominal", "identified")
ROOM = 3.0  # standard deviations of the measured velocity around its range that are shown
Line = tuple[str, Sample, str]  # label, values over time, colour


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one panel for each DOF."""
    return [
        _drawing(results, request, run, series_of["prediction"])
        for run, series_of in each_run(results, request, ("prediction",))
    ]


def _drawing(results: Queries, request: PlotRequest, run: StoredRun, series: Series) -> Drawing:
    dofs = request.shown(lambda dof: dof in series.columns)
    if not dofs:
        raise ConfigurationError(f"plot prediction: run {run.id} has no prediction of these DOFs")
    names = dofs if request.band is None else _banded(series, dofs, request.band, run)
    figure, axes = panels(len(names), 1, 8.0, 2.3, share_x=True)
    for panel, name in zip(axes, names, strict=True):
        lines = [
            (model, series.columns[f"{name}_{model}"], MODEL_COLOURS[model])
            for model in MODELS
            if f"{name}_{model}" in series.columns
        ]
        if request.band is not None:
            _band(panel, series, name, request.band)
        draw_motion(panel, series, name, lines)
    axes[-1].set_xlabel(with_unit("Time", series.units["t"]))
    begins = "the first measured state"
    if np.sum(series.columns["start"]) > 1:
        begins += " of each piece"
    notes = [f"predictions begin at {begins}; FIT at the right: 100 % is perfect"]
    if request.band is not None:
        notes.append(
            f"band: {request.band:g} % of what is measured, by what the data leave open of the"
            " parameters, the model error and the noise"
        )
    reasons = diagnostics_of(results, run, ("no_prediction",))
    notes += [f"no prediction: {row.label}" for row in reasons]
    title = f"Free run, {subtitle(run)}"
    return drawing_of(f"prediction-run-{run.id}", figure, axes, title, notes)


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


def _band(axes: Axes, series: Series, name: str, band: float) -> None:
    """Draw the band of the identified model at a level [%]."""
    half = half_width(series.columns[f"{name}_{IDENTIFIED_STD}"], 0.01 * band)
    t, shown, half = with_gaps(series, series.columns[f"{name}_identified"], half)
    axes.fill_between(
        t, shown - half, shown + half, color=MODEL_COLOURS["identified"], alpha=0.2, linewidth=0,
        label=f"{band:g} % band",
    )  # fmt: skip


def draw_motion(
    axes: Axes, series: Series, name: str, lines: Sequence[Line], every: int = 1
) -> None:
    """Draw a measured motion and predictions of it over time, with their FIT at the right.

    `series` has the time, the pieces and the measured motion in the column `name`. A prediction
    that runs away leaves the panel. Of long series only each sample of number `every` is drawn.
    """
    measured = series.columns[name]
    for label, values, colour in [("measured", measured, REFERENCE), *lines]:
        t, shown = with_gaps(series, values)
        chosen = (np.arange(len(t)) % every == 0) | np.isnan(shown)
        axes.plot(t[chosen], shown[chosen], color=colour, label=label, linewidth=0.9, alpha=0.9)
    margin = ROOM * float(np.std(measured)) or 1.0
    low, high = float(np.min(measured)) - margin, float(np.max(measured)) + margin
    axes.set_ylim(*np.clip(axes.get_ylim(), low, high).tolist())
    axes.set_ylabel(with_unit(name.capitalize(), series.units[name]))
    axes.margins(x=0)
    beside(axes, [(_end(v), f"FIT {fit_text(measured, v)}", colour) for _, v, colour in lines])


def with_gaps(series: Series, *signals: Sample) -> list[Sample]:
    """Return time and signals with NaN before each piece, so that no line joins two pieces."""
    gaps = np.flatnonzero(series.columns["start"] > 0.0)[1:]
    return [np.insert(values, gaps, np.nan) for values in (series.columns["t"], *signals)]


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
