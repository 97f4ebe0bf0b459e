"""MSE over model order and number of variables, as Jervan (2020), Fig. 4.21.

Diagnostics: `surface_mse` (dof, i = order, j = number of variables), `selected_order` and
`selected_variables` (dof).
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredDiagnostic
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import (
    Facet,
    PlotRequest,
    each_facet,
    newest_with,
    subtitle,
)
from seatrial.runner.compare.plots.style import Drawing, footnote, headed, panels
from seatrial.runner.compare.statistics import Sample

FIGURE = Figure(
    "surface",
    "MSE over model order and number of variables.",
    "diagnostic surface_mse, as of identifier=surface_plsr",
    caption="Error over order and variables",
    place=3,
)

SURFACE = "surface_mse"
ORDER, VARIABLES = "selected_order", "selected_variables"
WORST = 100.0  # largest error with a colour of its own, in the smallest ones
COLOURS = "cividis"  # perceptually uniform and suited to colour-blind readers


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, of its newest run with a surface; one panel for each DOF."""
    missing = f"plot surface: no run that matches has the diagnostic {SURFACE}"
    return each_facet(results, request, partial(_drawing, results, request), missing)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    newest = newest_with(results, facet, (SURFACE, ORDER, VARIABLES))
    if newest is None:
        return None
    run, rows = newest
    dofs = request.shown(lambda d: any(o.name == SURFACE and o.dof == d for o in rows))
    if not dofs:
        raise ConfigurationError(f"plot surface: run {run.id} has no surface of these DOFs")
    figure, axes = panels(1, len(dofs), max(4.3, 5.0 / len(dofs)), 4.0)
    for panel, dof in zip(axes, dofs, strict=True):
        of_dof = [row for row in rows if row.dof == dof]
        points = [row for row in of_dof if row.name == SURFACE and row.value is not None]
        mesh = _panel(panel, dof, points)
        figure.colorbar(
            mesh, ax=panel, label=with_unit("MSE", points[0].unit), pad=0.02, extend="max"
        )
        chosen = {row.name: row.value for row in of_dof if row.name in (ORDER, VARIABLES)}
        if len(chosen) == 2:
            place = [chosen[VARIABLES]], [chosen[ORDER]]
            panel.plot(*place, "D", color="#D55E00", mec="black", ms=9, label="selected")
    headed(figure, axes, f"Force MSE over order and variables, {subtitle(run)}")
    footnote(
        figure,
        [
            f"contours: powers of ten; brightest: {WORST:g} times the smallest error and more; "
            "blank: no model of that order"
        ],
    )
    return Drawing(f"surface-run-{run.id}", figure)


def _panel(axes: Axes, dof: str, points: Sequence[StoredDiagnostic]) -> QuadMesh:
    """Draw the grid and its contours; return the mesh for the colour bar."""
    orders, variables = sorted({p.i for p in points}), sorted({p.j for p in points})
    mse: Sample = np.full((len(orders), len(variables)), np.nan)
    for point in points:
        mse[orders.index(point.i), variables.index(point.j)] = point.value
    low, high = float(np.nanmin(mse)), float(np.nanmax(mse))
    low = max(low, 1e-12 * high, np.finfo(float).tiny)
    norm = LogNorm(low, max(min(high, WORST * low), 1.0000001 * low))
    masked = np.ma.masked_invalid(mse)
    mesh = axes.pcolormesh(variables, orders, masked, norm=norm, cmap=COLOURS, shading="nearest")
    powers = np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
    if min(mse.shape) > 1 and powers.size:
        axes.contour(variables, orders, masked, levels=10.0**powers, colors="white", linewidths=0.8)
    axes.set_title(dof, loc="left")
    axes.set_xlabel("Number of variables")
    axes.set_ylabel("Model order")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(visible=False)
    return mesh
