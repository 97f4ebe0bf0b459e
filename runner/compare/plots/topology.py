"""An objective over two parameters with its minimum and the truth, as in Hoyer (2021), Fig. 7.20.

Diagnostics: `topology` (i, j), and `topology_first` (i) and `topology_second` (j), the values of
the parameters. The newest run of each excitation and objective gets a panel.
"""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import Facet, PlotRequest, each_facet
from seatrial.runner.compare.plots.style import Drawing, footnote, headed, panels
from seatrial.runner.compare.plots.surface import COLOURS
from seatrial.runner.compare.results import DiagnosticRow, Results, Run
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition

FIGURE = Figure(
    "topology",
    "An objective over two parameters.",
    "diagnostic topology, as of identifier=grid",
)

Z, FIRST, SECOND = "topology", "topology_first", "topology_second"
OBJECTIVE = "identifier.objective"
MOST_PANELS = 6
COLUMNS = 2
DECADES = 4.0  # range of the colours below the highest value


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, one panel for each excitation and objective."""
    missing = f"plot topology: no run that matches has the diagnostic {Z}"
    return each_facet(results, request, partial(_drawing, results), missing)


def _drawing(results: Results, facet: Facet) -> Drawing | None:
    findings = results.diagnostics(facet.runs, (Z, FIRST, SECOND), facet.condition)
    runs = [run for run in facet.runs if any(row.name == Z for row in findings[run.id])]
    if not runs:
        return None
    configs = results.configs_of([run.id for run in runs]).values()
    newest = {
        f"{run.levels['excitation']}, {config.get(OBJECTIVE)}": run
        for run, config in zip(sorted(runs, key=lambda run: run.id), configs, strict=True)
    }
    panel_runs = list(newest.items())[-MOST_PANELS:]
    columns = min(COLUMNS, len(panel_runs))
    figure, axes = panels(-(-len(panel_runs) // columns), columns, 4.7, 3.9)
    truths = _truths(results, [run for _, run in panel_runs], facet.condition)
    for panel, (title, run) in zip(axes, panel_runs, strict=False):
        mesh = _panel(panel, findings[run.id], truths[run.id])
        panel.set_title(title, loc="left")
        figure.colorbar(mesh, ax=panel, label="sum of the objectives", pad=0.02)
    for panel in axes[len(panel_runs) :]:
        panel.remove()
    headed(figure, axes[: len(panel_runs)], facet.title("Objective over two parameters"))
    footnote(figure, ["colours: logarithmic, down to a ten-thousandth of the highest value"])
    return Drawing(facet.file("topology"), figure)


def _truths(
    results: Results, runs: Sequence[Run], condition: Condition | None
) -> dict[int, dict[str, float]]:
    """Return the known true values of identified coefficients (`surge.u_dot`) by run."""
    truths: dict[int, dict[str, float]] = {run.id: {} for run in runs}
    for observation in results.coefficients(runs, condition):
        if observation.model == "identified" and observation.true_value is not None:
            truths[observation.run.id][f"{observation.dof}.{observation.name}"] = (
                observation.true_value
            )
    return truths


def _panel(axes: Axes, rows: Sequence[DiagnosticRow], truth: Mapping[str, float]) -> QuadMesh:
    """Draw the grid, its minimum and the truth; return the mesh for the colour bar."""
    sides = [
        sorted((row for row in rows if row.name == name), key=lambda row: row.i)
        for name in (FIRST, SECOND)
    ]
    x, y = ([row.value for row in side] for side in sides)
    z: Sample = np.full((len(x), len(y)), np.nan)
    for row in rows:
        if row.name == Z and row.value is not None:
            z[row.i, row.j] = row.value
    high = float(np.nanmax(z))
    norm = LogNorm(max(high * 10.0**-DECADES, np.finfo(float).tiny), high)
    mesh = axes.pcolormesh(
        x, y, np.maximum(z, norm.vmin or 0.0).T, norm=norm, cmap=COLOURS, shading="nearest",
        rasterized=True,
    )  # fmt: skip
    i, j = np.unravel_index(int(np.nanargmin(z)), z.shape)
    axes.plot(x[i], y[j], "o", mfc="none", mec="#D55E00", mew=2.0, ms=13, label="lowest")
    labels = [side[0].label for side in sides]
    if all(label in truth for label in labels):
        place = [truth[labels[0]]], [truth[labels[1]]]
        axes.plot(*place, "*", color="black", mec="white", mew=0.6, ms=12, label="true values")
    axes.set_xlabel(with_unit(labels[0], sides[0][0].unit))
    axes.set_ylabel(with_unit(labels[1], sides[1][0].unit))
    axes.grid(visible=False)
    return mesh
