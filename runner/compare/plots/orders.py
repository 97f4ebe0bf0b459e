"""Force MSE over model order, per degree of freedom; the selected orders are marked.

Diagnostics: `order_mse` (dof, i = order, label = how the order is chosen), `selected_order` (dof).
"""

import numpy as np
from matplotlib.ticker import MaxNLocator

from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries, ordered
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.selection import Facet, per_facet

FIGURE = Figure(
    "orders", "Force MSE over model order; the selected orders are marked.",
    "the diagnostic order_mse, as of identifier=plsr",
    ("run", "rows", "columns", "dof", "facet", "pool"), place=2,
)  # fmt: skip

LINE_STYLES = ("-", "--", ":", "-.")
MIN_ORDERS = 8  # orders that are shown at least, if there are as many
MSE, SELECTED = "order_mse", "selected_order"


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> style.Drawing | None:
    frame = facet.diagnostics(results, (MSE, SELECTED))
    frame = frame[(frame["name"] == SELECTED) | frame["i"].notna()]
    frame["key"] = [*zip(frame[request.rows], frame[request.columns], strict=True)]
    points = frame[frame["name"] == MSE]
    frame = frame[frame["key"].isin({*points["key"]})]  # `auto` may have selected another method
    dofs = request.shown(lambda dof: bool((points["dof"] == dof).any()))
    if not dofs:
        return None
    figure, axes = style.panels(1, len(dofs), max(3.6, 5.0 / len(dofs)), 3.8)
    rows, columns = ordered(points[request.rows]), ordered(points[request.columns])
    for panel, dof in zip(axes, dofs, strict=True):
        of_dof = frame[frame["dof"] == dof]
        mine, selected = (of_dof[of_dof["name"] == name] for name in (MSE, SELECTED))
        for (row, column), own in sorted(mine.groupby("key")):
            mse, i = own.pivot(index="run", columns="i", values="value"), columns.index(column)
            colour, line = style.colour_of(i), LINE_STYLES[rows.index(row) % len(LINE_STYLES)]
            label = f"{row}, {column}" if len(rows) > 1 else column
            orders, middle, band = mse.columns.to_numpy(int), mse.median(), (mse.min(), mse.max())
            panel.plot(orders, middle, line, color=colour, label=label)
            if len(mse) > 1:
                panel.fill_between(orders, *band, color=colour, alpha=0.18, linewidth=0)
            chosen = {*selected.loc[selected["key"] == (row, column), "value"].dropna().astype(int)}
            for order in sorted(chosen & {*orders.tolist()}):
                marker = style.marker_of(i)
                panel.plot(order, middle[order], marker, color=colour, mec="black", ms=7, zorder=3)
        label = with_unit(f"Force MSE, {dof}", mine["unit"].iloc[0])
        panel.set(yscale="log", xlabel="Model order", ylabel=label)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        mine = mine[mine["value"] > 0.0]
        # beyond twice the largest selected order the error of an overfitted model explodes
        largest = 2.0 * selected["value"].max()  # NaN: no order was selected
        last = np.fmin(np.fmax(largest, MIN_ORDERS) if largest > 0.0 else np.inf, mine["i"].max())
        panel.set_xlim(mine["i"].min() - 0.5, last + 0.5)
        values = mine.loc[mine["i"] <= last, "value"]
        if len(values):
            panel.set_ylim(0.7 * values.min(), 1.4 * values.max())
    several = points.groupby(["key", "dof"], observed=True)["run"].nunique().max() > 1
    notes = ["line: median over seeds, band: smallest to largest"] if several else []
    if (frame["name"] == SELECTED).any():
        notes.append("markers: selected orders; not shown: orders above twice the largest of them")
    labels = ordered(points["label"].dropna())
    notes += [f"order chosen by: {', '.join(labels)}"] if labels else []
    title = facet.title(f"Force MSE over model order, {', '.join(ordered(points[request.rows]))}")
    return style.drawing_of(facet.file("orders"), figure, axes, title, notes)


drawings = per_facet(_drawing, averages=True)
