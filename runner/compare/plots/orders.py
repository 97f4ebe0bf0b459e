"""Force MSE over model order, per degree of freedom; the selected orders are marked.

Diagnostics: `order_mse` (dof, i = order, label = how the order is chosen), `selected_order` (dof).
"""

from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, ordered
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.request import Facet, PlotRequest, each_facet
from seatrial.runner.compare.plots.style import Drawing

FIGURE = Figure(
    "orders",
    "Force MSE over model order; the selected orders are marked.",
    "diagnostic order_mse, as of identifier=plsr",
    ("run", "rows", "columns", "dof", "facet", "pool"),
    caption="Error over model order",
    place=2,
)

LINE_STYLES = ("-", "--", ":", "-.")
MIN_ORDERS = 8  # orders that are shown at least, if there are as many
MSE, SELECTED = "order_mse", "selected_order"


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, one panel for each DOF, one line for each row and column."""
    missing = "no run that matches has the diagnostic order_mse (identifier=plsr does)"
    draw = partial(_drawing, results, request)
    return each_facet(results, request, draw, f"plot orders: {missing}", averages=True)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    frame = facet.diagnostics(results, (MSE, SELECTED))
    frame = frame[(frame["name"] == SELECTED) | frame["i"].notna()]
    frame["key"] = [*zip(frame[request.rows], frame[request.columns], strict=True)]
    points = frame[frame["name"] == MSE]
    frame = frame[frame["key"].isin({*points["key"]})]  # `auto` may have selected another method
    dofs = request.shown(lambda dof: bool((points["dof"] == dof).any()))
    if not dofs:
        return None
    figure, axes = style.panels(1, len(dofs), max(3.6, 5.0 / len(dofs)), 3.8)
    for panel, dof in zip(axes, dofs, strict=True):
        own = frame[frame["dof"] == dof]
        _panel(panel, own, *(ordered(points[name]) for name in (request.rows, request.columns)))
        unit = own.loc[own["name"] == MSE, "unit"].iloc[0]
        panel.set(xlabel="Model order", ylabel=with_unit(f"Force MSE, {dof}", unit))
    several = points.groupby(["key", "dof"], observed=True)["run"].nunique().max() > 1
    notes = ["line: median over seeds, band: smallest to largest"] if several else []
    if (frame["name"] == SELECTED).any():
        notes.append("markers: selected orders; not shown: orders above twice the largest of them")
    labels = ordered(points["label"].dropna())
    notes += [f"order chosen by: {', '.join(labels)}"] if labels else []
    title = facet.title(f"Force MSE over model order, {', '.join(ordered(points[request.rows]))}")
    return style.drawing_of(facet.file("orders"), figure, axes, title, notes)


def _panel(axes: Axes, frame: pd.DataFrame, rows: list[str], columns: list[str]) -> None:
    """Draw the errors of each row and column over the orders, the selected ones marked.

    The limits are those of the orders up to twice the largest that was selected: beyond it the
    error of an overfitted model grows by orders of magnitude.
    """
    points, selected = frame[frame["name"] == MSE], frame[frame["name"] == SELECTED]
    for (row, column), own in sorted(points.groupby("key")):
        mse, i = own.pivot(index="run", columns="i", values="value"), columns.index(column)
        colour, line = style.colour_of(i), LINE_STYLES[rows.index(row) % len(LINE_STYLES)]
        label = f"{row}, {column}" if len(rows) > 1 else column
        orders, middle = mse.columns.to_numpy(int), mse.median()
        axes.plot(orders, middle, line, color=colour, label=label)
        if len(mse) > 1:
            axes.fill_between(orders, mse.min(), mse.max(), color=colour, alpha=0.18, linewidth=0)
        chosen = {*selected.loc[selected["key"] == (row, column), "value"].dropna().astype(int)}
        for order in sorted(chosen & {*orders.tolist()}):
            axes.plot(
                [order], [middle[order]], style.marker_of(i), color=colour,
                markeredgecolor="black", markersize=7, zorder=3,
            )  # fmt: skip
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    points = points[points["value"] > 0.0]
    largest = 2.0 * selected["value"].max()  # NaN: no order was selected
    last = np.fmin(np.fmax(largest, MIN_ORDERS) if largest > 0.0 else np.inf, points["i"].max())
    axes.set_xlim(points["i"].min() - 0.5, last + 0.5)
    values = points.loc[points["i"] <= last, "value"]
    if len(values):
        axes.set_ylim(0.7 * values.min(), 1.4 * values.max())
