"""Lack of fit of the force over time, before and after identification, per degree of freedom."""

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    SHADE,
    Drawing,
    beside,
    footnote,
    headed,
    panels,
)
from seatrial.runner.compare.results import Results, Run
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.database.records import Series

FIGURE = Figure(
    "residual",
    "Force residual of one run over time, before and after identification.",
    "series residual",
    caption="Force residual of the newest run",
    place=12,
)

MODELS = (("nominal", "before (nominal)"), ("identified", "after (identified)"))


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one panel for each DOF."""
    return [_drawing(results, request, run) for run, _ in each_run(results, request, ["residual"])]


def _drawing(results: Results, request: PlotRequest, run: Run) -> Drawing:
    series = results.reader.series(run.id, "residual")
    dofs = request.shown(lambda dof: f"residual_nominal_{dof}" in series.columns)
    if not dofs:
        raise ConfigurationError(f"plot residual: run {run.id} has no residual of these DOFs")
    figure, axes = panels(len(dofs), 1, 8.0, 2.3, share_x=True)
    for panel, dof in zip(axes, dofs, strict=True):
        _panel(panel, series, dof)
    axes[-1].set_xlabel(with_unit("Time", series.units["t"]))
    headed(figure, axes, f"Force residual, {subtitle(run)}")
    shaded = bool(np.any(_training(series)))
    notes = ["shaded: training part"] if shaded else []
    samples = "the part that is not shaded" if shaded else "all samples"
    footnote(figure, [*notes, f"root mean square at the right: over {samples}"])
    return Drawing(f"residual-run-{run.id}", figure)


def _training(series: Series) -> Sample:
    return np.asarray(series.columns.get("train", np.zeros(0)), dtype=np.float64)


def _panel(axes: Axes, series: Series, dof: str) -> None:
    t, train = series.columns["t"], _training(series)
    texts = []
    for model, label in MODELS:
        values = series.columns.get(f"residual_{model}_{dof}")
        if values is None:
            continue
        axes.plot(t, values, color=MODEL_COLOURS[model], label=label, linewidth=0.9, alpha=0.9)
        held_out = values[train == 0] if np.any(train == 0) else values
        rms = number_text(float(np.sqrt(np.mean(np.square(held_out)))), 3)
        unit = unit_text(series.units[f"residual_{model}_{dof}"])
        texts.append((f"rms {rms} {unit}", MODEL_COLOURS[model]))
    beside(axes, texts)
    shade(axes, t, train)
    axes.set_ylabel(with_unit(dof.capitalize(), series.units[f"residual_nominal_{dof}"]))
    axes.margins(x=0)


def shade(axes: Axes, t: Sample, train: Sample) -> None:
    """Shade the training samples; `t` [s] and `train` (0 or 1) have shape (n,)."""
    if train.size and np.any(train > 0):
        axes.fill_between(
            t,
            0.0,
            1.0,
            where=train > 0,
            transform=axes.get_xaxis_transform(),
            color=SHADE,
            linewidth=0,
            zorder=0,
        )
