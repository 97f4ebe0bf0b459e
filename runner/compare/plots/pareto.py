"""The Pareto set of a multi-objective identification: its objectives and the deployed model.

Diagnostics: `pareto_objective` (i = point, j = objective, label = name of the objective),
`pareto_chosen` (i = point) and `objective` (j) of the model, which is the chosen point or what a
polish has made of it. With up to three objectives every pair has a panel; with more, only pairs of
the same degree of freedom have one.
"""

from collections.abc import Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries
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
    "pareto",
    "The Pareto set of a multi-objective identification.",
    "diagnostic pareto_objective, as of identifier=nsga2",
    caption="Pareto set",
    place=4,
)

OBJECTIVE, CHOSEN, DEPLOYED = "pareto_objective", "pareto_chosen", "objective"
MOST_PANELS, ABREAST = 6, 3
LINEAR_RANGE = 30.0  # largest ratio of values on a linear axis


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, one panel for each pair, one colour for each group."""
    missing = f"plot pareto: no run that matches has the diagnostic {OBJECTIVE}"
    return each_facet(results, request, partial(_drawing, results, request), missing)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    named = (OBJECTIVE, CHOSEN, DEPLOYED)
    diagnostics = results.diagnostics(facet.runs, named, facet.condition)
    fronts: list[_Front] = []
    names: list[str] = []
    dofs: list[str] = []
    for run in facet.runs:
        points = [row for row in diagnostics[run.id] if row.name == OBJECTIVE and row.i is not None]
        if not points:
            continue
        axes_of = {row.j: with_unit(row.label or f"objective {row.j}", row.unit) for row in points}
        names = names or [axes_of[j] for j in sorted(axes_of)]
        dof_of = {row.j: row.dof for row in points}
        dofs = dofs or [dof_of[j] for j in sorted(dof_of)]
        front = np.full((1 + max(row.i for row in points), len(names)), np.nan)
        for row in points:
            front[row.i, sorted(axes_of).index(row.j)] = row.value
        chosen = {int(row.i) for row in diagnostics[run.id] if row.name == CHOSEN}
        deployed = np.full(len(names), np.nan)
        for row in diagnostics[run.id]:
            if row.name == DEPLOYED and row.j in axes_of:
                deployed[sorted(axes_of).index(row.j)] = row.value
        label = f"{run.levels[request.rows]}, {run.levels[request.columns]}"
        fronts.append(_Front(label, front, chosen, deployed))
    if len(names) < 2:
        return None
    all_pairs = list(combinations(range(len(names)), 2))
    alike = [(a, b) for a, b in all_pairs if dofs[a] == dofs[b]] if len(dofs) > 3 else []
    pairs = (alike or all_pairs)[:MOST_PANELS]
    columns = min(len(pairs), ABREAST)
    rows = -(-len(pairs) // columns)
    figure, axes = panels(rows, columns, max(3.8, 5.0 / columns), 3.9)
    for spare in axes[len(pairs) :]:
        spare.remove()
    axes = axes[: len(pairs)]
    for panel, pair in zip(axes, pairs, strict=True):
        _panel(panel, fronts, names, pair)
    headed(figure, axes, facet.title("Pareto set"))
    seeds = "; one front for each run" if len(fronts) > 1 else ""
    left_out = f"; {len(pairs)} of {len(all_pairs)} pairs" if len(pairs) < len(all_pairs) else ""
    moved = "; diamond: what the polish made of it" if any(map(_moved, fronts)) else ""
    footnote(figure, [f"circle: the chosen point{moved}{seeds}{left_out}"])
    return Drawing(facet.file("pareto"), figure)


class _Front(NamedTuple):
    """The front of one run."""

    label: str
    front: Sample  # (n, n_objectives)
    chosen: set[int]
    deployed: Sample  # (n_objectives,) of the model


def _moved(front: _Front) -> bool:
    """Whether the model is none of the chosen points."""
    points = front.front[sorted(front.chosen & set(range(len(front.front))))]
    known = np.all(np.isfinite(front.deployed))
    return bool(known and not np.any(np.all(np.isclose(points, front.deployed), axis=1)))


def _panel(
    axes: Axes, fronts: Sequence[_Front], names: Sequence[str], pair: tuple[int, int]
) -> None:
    labels = list(dict.fromkeys(front.label for front in fronts))
    for own in fronts:
        i = labels.index(own.label)
        colour = PALETTE[i % len(PALETTE)]
        x, y = own.front[:, pair[0]], own.front[:, pair[1]]
        marker = marker_of(i)
        axes.plot(x, y, marker, color=colour, markersize=4, alpha=0.75, label=own.label)
        ring: dict[str, Any] = {"fillstyle": "none", "color": "black", "zorder": 4}
        for index in own.chosen & set(range(len(own.front))):
            axes.plot(x[index], y[index], "o", markersize=11, **ring)
        if _moved(own):
            axes.plot(*own.deployed[list(pair)], "D", markersize=9, **ring)
    axes.set_xlabel(names[pair[0]])
    axes.set_ylabel(names[pair[1]])
    for column, set_scale in ((pair[0], axes.set_xscale), (pair[1], axes.set_yscale)):
        values = np.concatenate([np.append(f.front[:, column], f.deployed[column]) for f in fronts])
        low, high = np.nanmin(values), np.nanmax(values)
        if low > 0.0 and high > LINEAR_RANGE * low:
            set_scale("log")
