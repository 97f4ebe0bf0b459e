"""A metric by identifier and disturbance: mean over seeds, its spread, and every seed."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.comparability import with_conditions
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, complete, observations
from seatrial.runner.compare.plots.request import Facet, PlotRequest, facets
from seatrial.runner.compare.plots.style import (
    MUTED,
    PALETTE,
    Drawing,
    footnote,
    headed,
    marker_of,
    metric_label,
    panels,
)
from seatrial.runner.compare.statistics import Cell, Pivot, pivot
from seatrial.runner.record.catalogue import definition_of

FIGURE = Figure(
    "bars",
    "A metric by rows and columns: mean over seeds, its spread, and every seed.",
    "a metric",
    each="metric and dof",
    caption="A metric",
    place=1,
)

LOGARITHMIC_FROM = 100.0  # largest over smallest mean
GROUP_WIDTH = 0.8  # of the distance between two groups
FRAME, WORD = 0.9, 0.7  # [in] beside the axes of a panel, and of a count above a bar


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, with one panel for each degree of freedom."""
    candidates = [
        _drawing(results, request, facet) for facet in facets(results, request, averages=True)
    ]
    complete = [drawing for drawing in candidates if drawing is not None]
    if not complete:
        raise ConfigurationError(
            f"plot bars: no finished run has {request.metric} of model {request.model}"
            f"; metrics are {', '.join(results.metric_names()) or 'none yet'}"
        )
    return complete


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    numbers = results.metrics([request.metric], facet.condition)
    frame = observations(numbers, facet.trials, results.marks(facet.condition))
    frame = frame[frame["model"] == request.model]
    dofs = request.shown(lambda d: bool((frame["dof"] == d).any()))
    if not dofs:
        return None
    frame, _ = with_conditions(results, facet.trials, frame.assign(is_baseline=False))
    factors = (request.rows, request.columns)
    tables = {
        dof: pivot(
            complete(frame[frame["dof"] == dof], facet.trials, factors), factors[:1], factors[1:]
        )
        for dof in dofs
    }
    first = tables[dofs[0]]
    width = max(3.4, FRAME + 0.32 * len(first.row_keys) * len(first.column_keys))
    width = max(min(width, 14 / len(dofs)), 5.0 / len(dofs))
    figure, axes = panels(1, len(dofs), width, 3.8)
    for panel, dof in zip(axes, dofs, strict=True):
        label = metric_label(request.metric, dof, frame.loc[frame["dof"] == dof, "unit"].iloc[0])
        _panel(panel, tables[dof], request, label, width)
    heading = definition_of(request.metric).heading
    headed(figure, axes, facet.title(f"{heading}, {request.model} model"))
    footnote(figure, _notes(tables, request.pool))
    return Drawing(facet.file(f"bars-{request.metric}"), figure)


def _panel(axes: Axes, table: Pivot, request: PlotRequest, label: str, panel_width: float) -> None:
    width = GROUP_WIDTH / len(table.row_keys)
    for i, row in enumerate(table.row_keys):
        shift = (i - (len(table.row_keys) - 1) / 2) * width
        centres = np.arange(len(table.column_keys), dtype=np.float64) + shift
        cells = [table.cell(row, column) for column in table.column_keys]
        _bars(axes, centres, cells, width, i, row[0])
        _whiskers(axes, centres, cells)
    axes.set_xticks(np.arange(len(table.column_keys)), [key[0] for key in table.column_keys])
    axes.set_xlabel(request.columns)
    axes.set_ylabel(label)
    axes.grid(axis="x", visible=False)
    axes.margins(y=0.35 if _turn_marks(axes, table, panel_width) else 0.12)
    if _logarithmic(table, request):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    if sum(len(key[0]) for key in table.column_keys) * 0.09 > panel_width:
        axes.tick_params(axis="x", rotation=20)


def _turn_marks(axes: Axes, table: Pivot, panel_width: float) -> bool:
    """Turn the counts above narrow bars, which would overlap; return whether there are any."""
    words = [text for text in axes.texts if text.get_text() != "†"]
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
    means = [float(np.mean(cell.sample)) for cell in table.cells.values() if cell.experiments]
    return len(means) > 0 and min(means) > 0.0 and max(means) > LOGARITHMIC_FROM * min(means)


def _bars(
    axes: Axes,
    centres: NDArray[np.float64],
    cells: Sequence[Cell],
    width: float,
    i: int,
    label: str,
) -> None:
    samples = [cell.sample for cell in cells]
    means = [float(np.mean(s)) if s.size else np.nan for s in samples]
    spreads = [float(np.std(s, ddof=1)) if s.size > 1 else 0.0 for s in samples]
    colour = PALETTE[i % len(PALETTE)]
    axes.bar(centres, means, 0.92 * width, color=colour, alpha=0.75, label=label)
    for centre, cell, sample, mean, spread in zip(
        centres, cells, samples, means, spreads, strict=True
    ):
        if sample.size > 1:
            golden = 0.6180339887498949  # spreads any number of points evenly
            places = centre + 0.5 * width * (np.arange(sample.size) * golden % 1.0 - 0.5)
            axes.plot(
                places,
                sample,
                marker_of(i),
                color="white",
                markeredgecolor="black",
                markeredgewidth=0.6,
                markersize=3.2,
                zorder=3,
            )
        _marks(axes, centre, cell, mean, max([mean + spread, *sample.tolist()], default=0.0))


def _whiskers(axes: Axes, centres: NDArray[np.float64], cells: Sequence[Cell]) -> None:
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


def _marks(axes: Axes, centre: float, cell: Cell, mean: float, top: float) -> None:
    """Write the counts of missing runs and the mark † above a bar."""
    lines = [f"{n} {status}" for status, n in sorted(cell.unfinished.items())]
    lines += [f"{cell.diverged} diverged"] if cell.diverged else []
    lines += [f"{cell.without} no value"] if cell.without else []
    lines += ["†"] if cell.flagged else []
    if lines:
        axes.annotate(
            "\n".join(lines),
            (centre, 0.0 if np.isnan(mean) else top),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=7.5,
            color=MUTED if lines != ["†"] else "black",
        )


def _notes(tables: Mapping[str, Pivot], pool: Sequence[str]) -> list[str]:
    cells = [cell for table in tables.values() for cell in table.cells.values()]
    largest = max(cell.experiments for cell in cells)
    legend = "bars: mean over seeds, whiskers: standard deviation, points: seeds"
    texts = [legend if largest > 1 else "one experiment a bar"]
    texts += [f"bars average over {', '.join(pool)}"] if pool else []
    if any(cell.flagged for cell in cells):
        texts.append("† below the true model: fits lag or feedback, not the vessel")
    return texts
