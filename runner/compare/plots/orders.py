"""Force MSE over model order, per degree of freedom; the selected orders are marked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, ordered
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import Facet, PlotRequest, each_facet
from seatrial.runner.compare.plots.style import (
    PALETTE,
    Drawing,
    footnote,
    headed,
    marker_of,
    panels,
)
from seatrial.runner.compare.statistics import Sample

FIGURE = Figure(
    "orders",
    "Force MSE over model order; the selected orders are marked.",
    "diagnostic order_mse, as of identifier=plsr",
    caption="Error over model order",
    each="dof",
    place=2,
)

LINE_STYLES = ("-", "--", ":", "-.")
MIN_ORDERS = 8  # orders that are shown at least, if there are as many
MAX_SHOWN_ERROR = 100.0  # largest error shown, in medians of the errors shown
NAMES = ("order_mse", "selected_order")


@dataclass(frozen=True)
class Curves:
    """Errors over order of one line; `mse` has shape (runs, orders), NaN if missing.

    `selected` are the orders that the runs selected.
    """

    orders: Sequence[int]
    mse: Sample
    selected: Sequence[int]
    unit: str
    label: str  # method of selection of the order


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, one panel for each DOF, one line for each row and column."""
    missing = "no run that matches has the diagnostic order_mse (identifier=plsr does)"
    draw = partial(_drawing, results, request)
    return each_facet(results, request, draw, f"plot orders: {missing}", averages=True)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    curves = _curves(results, request, facet)
    dofs = request.shown(lambda dof: any(dof in by_dof for by_dof in curves.values()))
    if not dofs:
        return None
    figure, axes = panels(1, len(dofs), max(3.6, 5.0 / len(dofs)), 3.8)
    rows, columns = ordered(row for row, _ in curves), ordered(column for _, column in curves)
    for panel, dof in zip(axes, dofs, strict=True):
        for (row, column), by_dof in sorted(curves.items()):
            if dof in by_dof:
                style = LINE_STYLES[rows.index(row) % len(LINE_STYLES)]
                label = f"{row}, {column}" if len(rows) > 1 else column
                _line(panel, by_dof[dof], columns.index(column), style, label)
        unit = next(by_dof[dof].unit for by_dof in curves.values() if dof in by_dof)
        panel.set_xlabel("Model order")
        panel.set_ylabel(with_unit(f"Force MSE, {dof}", unit))
        panel.set_yscale("log")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        _limit(panel, [by_dof[dof] for by_dof in curves.values() if dof in by_dof])
    identifiers = ", ".join(rows)
    headed(figure, axes, facet.title(f"Force MSE over model order, {identifiers}"))
    footnote(figure, _notes(curves))
    return Drawing(facet.file("orders"), figure)


def _curves(
    results: Queries, request: PlotRequest, facet: Facet
) -> Mapping[tuple[str, str], Mapping[str, Curves]]:
    """Curves by (row, column) and degree of freedom."""
    diagnostics = results.diagnostics(facet.runs, NAMES, facet.condition)
    groups: dict[tuple[str, str], dict[str, list[list[tuple[int, float, str, str]]]]] = {}
    chosen: dict[tuple[str, str, str], list[int]] = {}
    for run in facet.runs:
        key = (run.levels[request.rows], run.levels[request.columns])
        rows = diagnostics[run.id]
        for dof in {row.dof for row in rows if row.name == NAMES[0] and row.i is not None}:
            points = [
                (int(row.i), np.nan if row.value is None else row.value, row.unit, row.label or "")
                for row in rows
                if row.name == NAMES[0] and row.dof == dof and row.i is not None
            ]
            groups.setdefault(key, {}).setdefault(dof, []).append(points)
        for row in rows:
            if row.name == NAMES[1] and row.value is not None:
                chosen.setdefault((*key, row.dof), []).append(int(row.value))
    return {
        key: {dof: _joined(lines, chosen.get((*key, dof), [])) for dof, lines in by_dof.items()}
        for key, by_dof in groups.items()
    }


def _joined(
    lines: Sequence[Sequence[tuple[int, float, str, str]]], selected: Sequence[int]
) -> Curves:
    orders = sorted({point[0] for line in lines for point in line})
    mse = np.full((len(lines), len(orders)), np.nan)
    for row, line in enumerate(lines):
        for order, value, _, _ in line:
            mse[row, orders.index(order)] = value
    _, _, unit, label = lines[0][0]
    return Curves(orders, mse, selected, unit, label)


def _line(axes: Axes, curves: Curves, colour_index: int, style: str, label: str) -> None:
    colour = PALETTE[colour_index % len(PALETTE)]
    middle = np.nanmedian(curves.mse, axis=0)
    axes.plot(curves.orders, middle, style, color=colour, label=label)
    if len(curves.mse) > 1:
        low, high = np.nanmin(curves.mse, axis=0), np.nanmax(curves.mse, axis=0)
        axes.fill_between(curves.orders, low, high, color=colour, alpha=0.18, linewidth=0)
    for order in sorted(set(curves.selected)):
        if order in curves.orders:
            axes.plot(
                [order],
                [middle[curves.orders.index(order)]],
                marker_of(colour_index),
                color=colour,
                markeredgecolor="black",
                markersize=7,
                zorder=3,
            )


def _limit(axes: Axes, curves: Sequence[Curves]) -> None:
    """Set the limits to what matters: the orders up to twice the largest that was selected.

    Beyond it the error of an overfitted model grows by orders of magnitude.
    """
    orders = sorted({order for line in curves for order in line.orders})
    last = max((order for line in curves for order in line.selected), default=orders[-1])
    last = min(max(2 * last, MIN_ORDERS), orders[-1])
    shown = [line.mse[:, np.asarray(line.orders) <= last] for line in curves]
    values = np.concatenate([part[np.isfinite(part) & (part > 0.0)] for part in shown])
    axes.set_xlim(orders[0] - 0.5, last + 0.5)
    if values.size:
        chosen = [
            float(np.nanmax(line.mse[:, line.orders.index(order)]))
            for line in curves
            for order in line.selected
            if order in line.orders
        ]
        highest = min(float(np.max(values)), MAX_SHOWN_ERROR * float(np.median(values)))
        highest = max([highest, *(value for value in chosen if np.isfinite(value))])
        axes.set_ylim(0.7 * float(np.min(values)), 1.4 * highest)


def _notes(curves: Mapping[tuple[str, str], Mapping[str, Curves]]) -> list[str]:
    lines = [line for by_dof in curves.values() for line in by_dof.values()]
    several = any(len(line.mse) > 1 for line in lines)
    notes = ["line: median over seeds, band: smallest to largest"] if several else []
    if any(line.selected for line in lines):
        notes.append("markers: selected orders; not shown: orders above twice the largest of them")
    labels = ordered(line.label for line in lines if line.label)
    return ["; ".join(notes), *([f"order chosen by: {', '.join(labels)}"] if labels else [])]
