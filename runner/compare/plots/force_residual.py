"""Lack of fit of the force over time, before and after identification, per degree of freedom."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    SHADE,
    Drawing,
    beside,
    footnote,
    headed,
    largest_of,
    panels,
    prefixed,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.rows import Series

FIGURE = Figure(
    "residual",
    "Force residual of one run over time, before and after identification.",
    "series residual",
    caption="Force residual of a typical run",
    place=12,
)

MODELS = (("nominal", "before (nominal)"), ("identified", "after (identified)"))


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one panel for each DOF.

    Without --run it is a typical run: the one with the median ratio of its force residuals.
    """
    runs = each_run(results, request, ["residual"], typical=typical)
    return [_drawing(results, request, run) for run, _ in runs]


def typical(results: Queries, runs: Sequence[StoredRun], condition: Condition) -> StoredRun:
    """Return the run with the median improvement of the force, of the runs that identify a model.

    The improvement is the mean logarithm over degrees of freedom of the force MSE after over that
    before. Of equal runs, and without these metrics, it is the newest.
    """
    identified = [run for run in runs if run.levels["identifier"] != "none"] or runs
    numbers = results.metrics(("force_mse",), condition)
    numbers = numbers[(numbers["value"] > 0.0) & numbers["run"].isin([r.id for r in identified])]
    mse = numbers.set_index(["run", "dof", "model"])["value"].to_dict()
    ratios: dict[int, list[float]] = {}
    for (run, dof, model), value in mse.items():
        if model == "identified" and (run, dof, "nominal") in mse:
            ratios.setdefault(run, []).append(np.log(value / mse[run, dof, "nominal"]))
    judged = [run for run in identified if run.id in ratios]
    if not judged:
        return identified[-1]
    scores = sorted(float(np.mean(ratios[run.id])) for run in judged)
    median = scores[(len(scores) - 1) // 2]
    return [run for run in judged if float(np.mean(ratios[run.id])) == median][-1]


def _drawing(results: Queries, request: PlotRequest, run: StoredRun) -> Drawing:
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
    notes.append(f"dashed, and at the right: root mean square over {samples}")
    if request.run is None:
        notes.append("a run of median improvement; --run shows another")
    footnote(figure, notes)
    return Drawing(f"residual-run-{run.id}", figure)


def _training(series: Series) -> Sample:
    return np.asarray(series.columns.get("train", np.zeros(0)), dtype=np.float64)


def _panel(axes: Axes, series: Series, dof: str) -> None:
    t, train = series.columns["t"], _training(series)
    shown = [v for m, _ in MODELS if (v := series.columns.get(f"residual_{m}_{dof}")) is not None]
    unit, size = prefixed(series.units[f"residual_nominal_{dof}"], largest_of(shown))
    texts = []
    for model, label in MODELS:
        values = series.columns.get(f"residual_{model}_{dof}")
        if values is None:
            continue
        axes.plot(
            t, values / size, color=MODEL_COLOURS[model], label=label, linewidth=0.9, alpha=0.9
        )
        held_out = values[train == 0] if np.any(train == 0) else values
        level = float(np.sqrt(np.mean(np.square(held_out))))
        texts.append((level, f"rms {number_text(level / size, 3)} {unit}", MODEL_COLOURS[model]))
        axes.axhline(level / size, color=MODEL_COLOURS[model], linewidth=0.9, linestyle="--")
    shade(axes, t, train)
    axes.set_ylabel(with_unit(dof.capitalize(), unit))
    axes.margins(x=0)
    beside(axes, [(value / size, text, colour) for value, text, colour in texts])


def shade(axes: Axes, t: Sample, train: Sample) -> None:
    """Shade the training samples; `t` [s] and `train` (0 or 1) have shape (n,)."""
    chosen = np.concatenate([[False], train > 0, [False]])
    for first, end in np.flatnonzero(np.diff(chosen)).reshape(-1, 2):
        axes.axvspan(t[first], t[end - 1], color=SHADE, linewidth=0, zorder=0)
