"""MSE over model order and number of variables, as Jervan (2020), Fig. 4.21.

Diagnostics: `surface_mse` (dof, i = order, j = number of variables), `selected_order` and
`selected_variables` (dof).
"""

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator

from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.selection import Facet, per_facet, subtitle

FIGURE = Figure(
    "surface", "MSE over model order and number of variables.",
    "the diagnostic surface_mse, as of identifier=surface_plsr", ("run", "dof", "facet"), place=3,
)  # fmt: skip

SURFACE = "surface_mse"
ORDER, VARIABLES = "selected_order", "selected_variables"
WORST = 100.0  # largest error with a colour of its own, in the smallest ones
COLOURS = "cividis"  # perceptually uniform and suited to colour-blind readers


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> style.Drawing | None:
    frame = facet.diagnostics(results, (SURFACE, ORDER, VARIABLES))
    having = frame.loc[frame["name"] == SURFACE, "run"]
    if having.empty:
        return None
    run = next(run for run in facet.runs if run.id == having.max())
    rows = frame[frame["run"] == run.id].dropna(subset="value")
    having = rows.loc[rows["name"] == SURFACE, "dof"]
    dofs = request.shown({*having}.__contains__, f"run {run.id} has no surface")
    figure, axes = style.panels(1, len(dofs), max(4.3, 5.0 / len(dofs)), 4.0)
    for panel, dof in zip(axes, dofs, strict=True):
        own = rows[rows["dof"] == dof]
        points = own[own["name"] == SURFACE]
        mse = points.pivot(index="i", columns="j", values="value")
        low, high = float(mse.min(axis=None)), float(mse.max(axis=None))
        low = max(low, 1e-12 * high, np.finfo(float).tiny)
        norm = LogNorm(low, max(min(high, WORST * low), 1.0000001 * low))
        grid = mse.columns.to_numpy(float), mse.index.to_numpy(float), np.ma.masked_invalid(mse)
        mesh = panel.pcolormesh(*grid, norm=norm, cmap=COLOURS, shading="nearest")
        powers = np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
        if min(mse.shape) > 1 and powers.size:
            panel.contour(*grid, levels=10.0**powers, colors="white", linewidths=0.8)
        panel.set(xlabel="Number of variables", ylabel="Model order")
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(MaxNLocator(integer=True))
        panel.grid(visible=False)
        label = with_unit("MSE", points["unit"].iloc[0])
        figure.colorbar(mesh, ax=panel, label=label, pad=0.02, extend="max")
        panel.set_title(dof, loc="left")
        chosen = own.set_index("name")["value"]
        if {ORDER, VARIABLES} <= {*chosen.index}:
            place = [chosen[VARIABLES]], [chosen[ORDER]]
            panel.plot(*place, "D", color="#D55E00", mec="black", ms=9, label="selected")
    notes = [
        f"contours: powers of ten; brightest: {WORST:g} times the smallest error and more; "
        "blank: no model of that order"
    ]
    title = f"Force MSE over order and variables, {subtitle(run)}"
    return style.drawing_of(f"surface-run-{run.id}", figure, axes, title, notes)


drawings = per_facet(_drawing)
