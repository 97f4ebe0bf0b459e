"""An objective over two parameters with its minimum and the truth, as Hoyer (2021), Fig. 7.20.

Diagnostics: `topology` (i, j), and `topology_first` (i) and `topology_second` (j), the values of
the parameters. The newest run of each excitation and objective gets a panel.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import Facet, PlotRequest, facets
from seatrial.runner.compare.plots.style import Drawing, footnote, headed, panels
from seatrial.runner.compare.plots.surface import COLOURS
from seatrial.runner.compare.results import Results, Run
from seatrial.runner.compare.statistics import Sample

FIGURE = Figure(
    "topology",
    "An objective over two parameters.",
    "diagnostic topology, as of identifier=grid",
)

Z, FIRST, SECOND = "topology", "topology_first", "topology_second"
OBJECTIVE = "identifier.objective"
MOST_PANELS = 6
COLUMNS = 2
DECADES = 4.0  # of the colours below the highest value


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """One figure a facet, one panel an excitation and objective."""
    made = [_drawing(results, facet) for facet in facets(results, request)]
    found = [one for one in made if one is not None]
    if not found:
        raise ConfigurationError(f"plot topology: no run that matches has the diagnostic {Z}")
    return found


def _drawing(results: Results, facet: Facet) -> Drawing | None:
    findings = results.diagnostics(facet.runs, (Z, FIRST, SECOND), facet.condition)
    having = [run for run in facet.runs if any(one.name == Z for one in findings[run.id])]
    if not having:
        return None
    configs = results.configs([run.id for run in having])
    newest = {
        f"{run.levels['excitation']}, {config.get(OBJECTIVE)}": run
        for run, config in zip(sorted(having, key=lambda run: run.id), configs, strict=True)
    }
    shown = list(newest.items())[-MOST_PANELS:]
    columns = min(COLUMNS, len(shown))
    made, axes = panels(-(-len(shown) // columns), columns, 4.7, 3.9)
    truths = _truths(results, [run for _, run in shown])
    for one, (about, run) in zip(axes, shown, strict=False):
        mesh = _panel(one, findings[run.id], truths[run.id])
        one.set_title(about, loc="left")
        made.colorbar(mesh, ax=one, label="sum of the objectives", pad=0.02)
    for one in axes[len(shown) :]:
        one.remove()
    headed(made, axes[: len(shown)], facet.title("Objective over two parameters"))
    footnote(made, ["colours: logarithmic, down to a ten-thousandth of the highest value"])
    return Drawing(facet.file("topology"), made)


def _truths(results: Results, runs: Sequence[Run]) -> dict[int, dict[str, float]]:
    """The true value of each identified coefficient (`surge.u_dot`) by run, where it is known."""
    found: dict[int, dict[str, float]] = {run.id: {} for run in runs}
    for seen in results.coefficients(runs):
        if seen.model == "identified" and seen.true_value is not None:
            found[seen.run.id][f"{seen.dof}.{seen.name}"] = seen.true_value
    return found


def _panel(axes: Axes, rows: Sequence[Any], truth: Mapping[str, float]) -> Any:
    """Draws the grid, its minimum and the truth; the coloured mesh, for its scale."""
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
