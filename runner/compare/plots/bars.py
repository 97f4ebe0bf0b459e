"""A metric by identifier and disturbance: mean over seeds, its spread, and every seed."""

from collections.abc import Collection, Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from seatrial.runner.compare.comparison_table import INFEASIBLE, MARK, UNSETTLED
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.pivot import Pivot, PivotCell, pivot
from seatrial.runner.compare.plots.request import Facet, PlotRequest, each_facet
from seatrial.runner.compare.plots.style import (
    MUTED,
    PALETTE,
    Drawing,
    drawing_of,
    marker_of,
    metric_label,
    panels,
)
from seatrial.runner.compare.results import BELOW_TRUE_MODEL, DESIGN_FLAWS, FINISHED, Queries
from seatrial.runner.compare.selection import DIVERGENCE, diverged_predictions
from seatrial.runner.record.catalogue import definition_of

FIGURE = Figure(
    "bars",
    "A metric by rows and columns: mean over seeds, its spread, every seed, and what is missing.",
    "a metric",
    ("run", "metric", "rows", "columns", "dof", "model", "facet", "log", "pool"),
    each="metric and dof",
    caption="A metric",
    place=1,
)

NO_SUCH = "n/a"
NOTES = {
    MARK: "below the true model: fits lag or feedback, not the vessel",
    UNSETTLED: "the controller is not stable on its own model",
    INFEASIBLE: "the weather needs more force than the limits allow",
}
LOGARITHMIC_FROM = 100.0  # largest over smallest mean
GROUP_WIDTH = 0.8  # of the distance between two groups
FRAME, WORD = 0.9, 0.7  # [in] beside the axes of a panel, and of a count above a bar
GOLDEN = 0.6180339887498949  # spreads any number of points evenly
Flaws = Mapping[str, Collection[int]]  # runs by the mark of the flaw of their controller


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, with one panel for each degree of freedom."""
    missing = (
        f"plot bars: no finished run has {request.metric} of model {request.model}"
        f"; metrics are {', '.join(results.metric_names()) or 'none yet'}"
    )
    return each_facet(results, request, partial(_drawing, results, request), missing, averages=True)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    names = (request.metric, BELOW_TRUE_MODEL, *DIVERGENCE, *DESIGN_FLAWS)
    numbers = results.metrics(facet.runs, names, facet.condition)
    flagged = frozenset((o.run.id, o.dof) for o in numbers if o.name == names[1] and o.value)
    flaws = {
        mark: {o.run.id for o in numbers
               if (o.name, o.model) == (name, request.model) and (o.value or 0.0) >= 1.0}
        for mark, name in zip((UNSETTLED, INFEASIBLE), DESIGN_FLAWS, strict=True)
    }  # fmt: skip
    diverged = diverged_predictions(numbers)
    observations = [o for o in numbers if o.name == request.metric and o.run.status == FINISHED]
    observations = [o for o in observations if o.model == request.model]
    dofs = request.shown(lambda d: any(o.dof == d for o in observations))
    if not dofs:
        return None
    tables = {
        dof: pivot(
            [o for o in observations if o.dof == dof], [*facet.runs, *facet.planned],
            (request.rows,), (request.columns,), flagged, facet.likeness, diverged,
        )
        for dof in dofs
    }  # fmt: skip
    first = tables[dofs[0]]
    width = max(3.4, FRAME + 0.32 * len(first.row_keys) * len(first.column_keys))
    width = max(min(width, 14 / len(dofs)), 5.0 / len(dofs))
    figure, axes = panels(1, len(dofs), width, 3.8)
    for panel, dof in zip(axes, dofs, strict=True):
        unit = next(o.unit for o in observations if o.dof == dof)
        _panel(panel, tables[dof], request, metric_label(request.metric, dof, unit), width, flaws)
    title = facet.title(f"{definition_of(request.metric).heading}, {request.model} model")
    marks = {mark for table in tables.values() for cell in table.cells.values()
             for mark in _marks_of(cell, flaws)}  # fmt: skip
    notes = [_legend(tables), *(f"{mark} {NOTES[mark]}" for mark in NOTES if mark in marks)]
    if any(cell.not_applicable for table in tables.values() for cell in table.cells.values()):
        notes.append(f"{NO_SUCH}: the run finished, and its method has no such number")
    notes += [f"bars average over {', '.join(request.pool)}"] if request.pool else []
    return drawing_of(facet.file(f"bars-{request.metric}"), figure, axes, title, notes)


def _panel(
    axes: Axes, table: Pivot, request: PlotRequest, label: str, panel_width: float, flaws: Flaws
) -> None:
    width = GROUP_WIDTH / len(table.row_keys)
    for i, row in enumerate(table.row_keys):
        shift = (i - (len(table.row_keys) - 1) / 2) * width
        centres = np.arange(len(table.column_keys), dtype=np.float64) + shift
        cells = [table.cell(row, column) for column in table.column_keys]
        _bars(axes, centres, cells, width, i, row[0])
        _whiskers(axes, centres, cells)
        for centre, cell in zip(centres, cells, strict=True):
            _write_counts(axes, centre, cell, _marks_of(cell, flaws))
    axes.set_xticks(np.arange(len(table.column_keys)), [key[0] for key in table.column_keys])
    axes.set_xlabel(request.columns)
    axes.set_ylabel(label)
    axes.grid(axis="x", visible=False)
    axes.margins(y=0.35 if _turn_counts(axes, table, panel_width) else 0.12)
    if _logarithmic(table, request):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    if sum(len(key[0]) for key in table.column_keys) * 0.09 > panel_width:
        axes.tick_params(axis="x", rotation=20)


def _turn_counts(axes: Axes, table: Pivot, panel_width: float) -> bool:
    """Turn the counts above narrow bars, which would overlap; return whether there are any."""
    words = [text for text in axes.texts if any(map(str.isdigit, text.get_text()))]
    bars = len(table.column_keys) * len(table.row_keys)
    if not words or (panel_width - FRAME) * GROUP_WIDTH / bars > WORD:
        return False
    for text in words:
        text.set_rotation(90)
    return True


def _logarithmic(table: Pivot, request: PlotRequest) -> bool:
    """Return whether the axis is logarithmic: as requested, else by the range of the means."""
    if request.log is not None:
        return request.log
    means = [float(np.mean(cell.sample)) for cell in table.cells.values() if cell.observed]
    return len(means) > 0 and min(means) > 0.0 and max(means) > LOGARITHMIC_FROM * min(means)


def _bars(
    axes: Axes,
    centres: NDArray[np.float64],
    cells: Sequence[PivotCell],
    width: float,
    i: int,
    label: str,
) -> None:
    means = [float(np.mean(cell.sample)) if cell.by_seed else np.nan for cell in cells]
    colour = PALETTE[i % len(PALETTE)]
    axes.bar(centres, means, 0.92 * width, color=colour, alpha=0.75, label=label)
    ends = np.add.outer((-0.46 * width, 0.46 * width), centres).ravel()
    axes.update_datalim(np.column_stack([ends, ends]), updatey=False)  # room for missing bars
    for centre, sample in zip(centres, (cell.sample for cell in cells), strict=True):
        if sample.size > 1:
            places = centre + 0.5 * width * (np.arange(sample.size) * GOLDEN % 1.0 - 0.5)
            axes.plot(
                places, sample, marker_of(i), color="white", markeredgecolor="black",
                markeredgewidth=0.6, markersize=3.2, zorder=3,
            )  # fmt: skip


def _whiskers(axes: Axes, centres: NDArray[np.float64], cells: Sequence[PivotCell]) -> None:
    """Draw the standard deviation of bars of several seeds.

    A bar of one seed has none. Where the lower end of positive values would be zero or less, which
    a logarithmic axis draws down to its floor, there is only the upper half.
    """
    for centre, sample in zip(centres, (cell.sample for cell in cells), strict=True):
        if sample.size > 1:
            mean, spread = float(np.mean(sample)), float(np.std(sample, ddof=1))
            below = 0.0 if np.min(sample) > 0.0 and spread >= mean else spread
            axes.errorbar(
                [centre], [mean], [[below], [spread]], fmt="none", ecolor="black", capsize=3,
                elinewidth=1.2,
            )  # fmt: skip


def _marks_of(cell: PivotCell, flaws: Flaws) -> list[str]:
    """Return the marks of a cell, which are those of the tables."""
    deployed = {o.run.id for o in cell.observed if o.stage == "deployment"}
    marks = [MARK] if cell.flagged else []
    return marks + [mark for mark, runs in flaws.items() if deployed.intersection(runs)]


def _write_counts(axes: Axes, centre: float, cell: PivotCell, marks: Sequence[str]) -> None:
    """Write the counts of lost runs and the marks above a bar, or at the foot of a missing one."""
    lines = [f"{n} {status}" for status, n in sorted(cell.unfinished.items())]
    lines += [f"{cell.diverged} diverged"] if cell.diverged else []
    lines += [f"{cell.without} no value"] if cell.without else []
    lines += [f"{cell.not_applicable} {NO_SUCH}"] if cell.not_applicable else []
    only_marks = not lines
    lines += [" ".join(marks)] if marks else []
    if not lines:
        return
    sample, top = cell.sample, 0.0
    if sample.size:
        spread = float(np.std(sample, ddof=1)) if sample.size > 1 else 0.0
        top = max(float(np.mean(sample)) + spread, *sample.tolist(), 0.0)
    axes.annotate(
        "\n".join(lines), (centre, top), xytext=(0, 4), textcoords="offset points", ha="center",
        va="bottom", fontsize=7.5, color="black" if only_marks else MUTED,
        xycoords="data" if sample.size else axes.get_xaxis_transform(),
    )  # fmt: skip


def _legend(tables: Mapping[str, Pivot]) -> str:
    """Return what bars, whiskers and points are."""
    largest = max(len(cell.observed) for table in tables.values() for cell in table.cells.values())
    several = "bars: mean over seeds, whiskers: standard deviation, points: seeds"
    return several if largest > 1 else "one experiment a bar"
