"""A metric by identifier and disturbance: mean over seeds, its spread, and every seed."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from seatrial.runner.compare import frame as frames
from seatrial.runner.compare import statistics as stats
from seatrial.runner.compare.comparability import with_conditions
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.selection import Facet, per_facet
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.vocabulary import COMBINED

FIGURE = Figure(
    "bars",
    "A metric by rows and columns: mean over seeds, its spread, every seed, and what is missing.",
    "a metric", ("run", "metric", "rows", "columns", "dof", "model", "facet", "log", "pool"),
    place=1,
)  # fmt: skip

SHORT = {frames.DIVERGED: "diverged", frames.WITHOUT: "no value", frames.NOT_APPLICABLE: "n/a"}
NOTES = {  # of marks and reasons
    stats.MARK: f"{stats.MARK} below the true model: fits lag or feedback, not the vessel",
    stats.UNSETTLED: f"{stats.UNSETTLED} the controller is not stable on its own model",
    stats.INFEASIBLE: f"{stats.INFEASIBLE} the weather needs more force than the limits allow",
    frames.NOT_APPLICABLE: "n/a: the run finished, its method has no such number",
}
LOGARITHMIC_FROM = 100.0  # largest over smallest mean
GROUP_WIDTH = 0.8  # of the distance between two groups
GOLDEN = 0.6180339887498949  # spreads any number of points evenly


def drawings(results: frames.Queries, request: PlotRequest) -> list[style.Drawing]:
    """Draw one figure for each facet, with one panel for each degree of freedom."""
    names = results.metric_names()
    hint = "" if request.metric in names else meant(request.metric, names)
    missing = f"plot bars: no finished run has {request.metric} of model {request.model}; {hint}"
    missing += f"metrics are {', '.join(names) or 'none yet'}"
    return per_facet(_drawing, missing, averages=True)(results, request)


def _drawing(results: frames.Queries, request: PlotRequest, facet: Facet) -> style.Drawing | None:
    numbers = results.metrics([request.metric], facet.condition)
    frame = frames.observations(numbers, facet.trials, results.marks(facet.condition))
    frame = frame[frame["model"] == request.model]
    dofs = request.shown(lambda d: bool((frame["dof"] == d).any()))
    if not dofs:
        return None
    frame, _ = with_conditions(results, facet.trials, frame.assign(is_baseline=False))
    tables, factors = {}, (request.rows, request.columns)
    for dof in dofs:
        own = frames.complete(frame[frame["dof"] == dof], facet.trials, factors)
        tables[dof] = stats.pivot(own, factors[:1], factors[1:])
    definition, first = definition_of(request.metric), tables[dofs[0]]
    bars = first.cells["row"].nunique() * len(first.column_keys)
    width = float(np.clip(0.9 + 0.32 * bars, max(3.4, 5.0 / len(dofs)), 14.0 / len(dofs)))
    figure, axes = style.panels(1, len(dofs), width, 3.8)
    for panel, dof in zip(axes, dofs, strict=True):
        label = definition.label if dof in COMBINED else f"{definition.label}, {dof}"
        panel.set_ylabel(with_unit(label, frame.loc[frame["dof"] == dof, "unit"].iloc[0]))
        _panel(panel, tables[dof], request, width)
    title = facet.title(f"{definition.heading}, {request.model} model")
    cells = pd.concat([table.cells for table in tables.values()])
    means = "bars: mean over seeds, whiskers: standard deviation, points: seeds"
    notes = [means if cells["experiments"].max() > 1 else "one experiment a bar"]
    told = stats.MARKS | {frames.NOT_APPLICABLE: stats.COUNTS[frames.NOT_APPLICABLE]}
    notes += [NOTES[name] for name, column in told.items() if cells[column].any()]
    notes += [f"bars average over {', '.join(request.pool)}"] if request.pool else []
    return style.drawing_of(facet.file(f"bars-{request.metric}"), figure, axes, title, notes)


def _panel(axes: Axes, table: stats.Pivot, request: PlotRequest, panel_width: float) -> None:
    """Draw a bar for each cell: those of a column beside each other, rows by colour."""
    columns, rows = table.column_keys, table.cells["row"].nunique()
    width, samples = GROUP_WIDTH / rows, table.samples()
    means = {cell: float(np.mean(own)) if own.size else np.nan for cell, own in samples.items()}
    for i, ((row,), cells) in enumerate(table.cells.groupby("row", sort=False)):
        shift, colour = (i - 0.5 * (rows - 1)) * width, style.colour_of(i)
        centres = np.array([columns.index(key) for key in cells["column"]]) + shift
        heights = [means[cell] for cell in cells.index]
        axes.bar(centres, heights, 0.92 * width, color=colour, alpha=0.75, label=row)
        for centre, cell in zip(centres, cells.itertuples(), strict=True):
            top = _seeds(axes, centre, width, samples[cell.Index], style.marker_of(i))
            counts = {why: getattr(cell, column) for why, column in sorted(stats.COUNTS.items())}
            missing = [f"{n} {SHORT.get(why, why)}" for why, n in counts.items() if n]
            lines = [*missing, *filter(None, [" ".join(stats.marks_of(cell))])]
            if not lines:
                continue
            axes.annotate(  # what was lost, and the marks: at the foot of a missing bar
                "\n".join(lines), (centre, top), xytext=(0, 4), textcoords="offset points",
                va="bottom", ha="center", fontsize=7.5, rotation=90 if missing else 0,
                color=style.MUTED if missing else "black",
                xycoords="data" if cell.n else axes.get_xaxis_transform(),
            )  # fmt: skip
    names = [key[0] for key in columns]
    axes.set_xticks(range(len(names)), names)
    axes.set(xlim=(-0.5, len(names) - 0.5), xlabel=request.columns)
    axes.grid(axis="x", visible=False)
    axes.margins(y=0.35 if table.cells[[*stats.COUNTS.values()]].any(axis=None) else 0.12)
    low, high = np.nanmin([*means.values(), np.inf]), np.nanmax([*means.values(), -np.inf])
    if 0.0 < LOGARITHMIC_FROM * low < high if request.log is None else request.log:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    if sum(map(len, names)) * 0.09 > panel_width:
        axes.tick_params(axis="x", rotation=20)


def _seeds(axes: Axes, centre: float, width: float, sample: stats.Sample, marker: str) -> float:
    """Draw the seeds of a bar and their standard deviation; return the height of all.

    A bar of one seed has none. Where the lower end of positive values would be zero or less, which
    a logarithmic axis draws down to its floor, there is only the upper half.
    """
    if sample.size < 2:
        return float(np.max(sample, initial=0.0))
    mean, spread = float(np.mean(sample)), float(np.std(sample, ddof=1))
    places = centre + 0.5 * width * (np.arange(sample.size) * GOLDEN % 1.0 - 0.5)
    axes.plot(places, sample, marker, color="white", mec="black", mew=0.6, ms=3.2, zorder=3)
    below = 0.0 if np.min(sample) > 0.0 and spread >= mean else spread
    look: dict[str, Any] = {"fmt": "none", "ecolor": "black", "capsize": 3, "elinewidth": 1.2}
    axes.errorbar([centre], [mean], [[below], [spread]], **look)
    return max(mean + spread, float(np.max(sample)), 0.0)
