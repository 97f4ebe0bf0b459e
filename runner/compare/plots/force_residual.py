"""Lack of fit of the force over time, before and after identification, per degree of freedom."""

from collections.abc import Mapping

import numpy as np

from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.plots import selection, style
from seatrial.runner.record.rows import Series

FIGURE = Figure(
    "residual", "Force residual of one run over time, before and after identification.",
    "series residual", ("run", "dof", "facet"), place=12,
)  # fmt: skip

MODELS = {"nominal": "before (nominal)", "identified": "after (identified)"}


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, series_of: Mapping[str, Series]
) -> style.Drawing:
    """Draw one panel for each DOF."""
    series = series_of["residual"]
    columns, none = series.columns, f"run {run.id} has no residual"
    dofs = request.shown(lambda dof: f"residual_nominal_{dof}" in columns, none)
    train = np.asarray(columns.get("train", np.zeros(series.n_rows)), dtype=np.float64)
    judged = train == 0.0 if np.any(train == 0.0) else train > 0.0
    figure, axes = style.panels(len(dofs), 1, 8.0, 2.3, share_x=True)
    for panel, dof in zip(axes, dofs, strict=True):
        names = {model: f"residual_{model}_{dof}" for model in MODELS}
        shown = {model: columns[name] for model, name in names.items() if name in columns}
        largest = style.largest_of([*shown.values()])
        unit, size = style.prefixed(series.units[names["nominal"]], largest)
        curves = []
        for model, values in shown.items():
            rms, colour = float(np.sqrt(np.mean(values[judged] ** 2))), style.MODEL_COLOURS[model]
            panel.axhline(rms / size, linestyle="--", color=colour, linewidth=0.9)
            words = MODELS[model], f"rms {number_text(rms / size, 3)} {unit}"
            curves.append(style.Curve(columns["t"], values / size, colour, *words))
        style.shaded(panel, columns)
        label = with_unit(dof.capitalize(), unit)
        style.over_time(panel, label, curves, linewidth=0.9, alpha=0.9)
    notes = ["shaded: training part"] if train.any() else []
    samples = "the part that is not shaded" if train.any() else "all samples"
    notes.append(f"dashed, and at the right: root mean square over {samples}")
    lacking = [dof for dof in dofs if f"residual_identified_{dof}" not in columns]
    notes += [f"no identified model in {', '.join(lacking)}"] if lacking else []
    title = f"Force residual, {selection.subtitle(run)}"
    return style.drawing_of(f"residual-run-{run.id}", figure, axes, title, notes)


drawings = selection.per_run(_drawing, "residual")
