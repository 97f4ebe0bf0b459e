"""The Pareto set of a multi-objective identification: its objectives, and what it chose.

Diagnostics: `pareto_objective` (i = point, j = objective, label = name of the objective) and
`pareto_chosen` (i = point). Of three objectives every pair gets a panel; of more, those of the
same degree of freedom, such as the errors of its pose and of its velocity.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import Facet, PlotRequest, facets
from seatrial.runner.compare.plots.style import (
    PALETTE,
    Drawing,
    footnote,
    headed,
    marker_of,
    panels,
)
from seatrial.runner.compare.results import Results
from seatrial.runner.compare.statistics import Sample

FIGURE = Figure(
    "pareto",
    "The Pareto set of a multi-objective identification.",
    "diagnostic pareto_objective, as of identifier=nsga2",
    caption="Pareto set",
    place=4,
)

OBJECTIVE, CHOSEN = "pareto_objective", "pareto_chosen"
MOST_PANELS, ABREAST = 6, 3
WIDE = 30.0  # ratio of the largest to the smallest value from which an axis is logarithmic


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """One figure a facet, one panel a pair of objectives, one colour a group of runs."""
    made = [_drawing(results, request, facet) for facet in facets(results, request)]
    found = [one for one in made if one is not None]
    if not found:
        raise ConfigurationError(f"plot pareto: no run that matches has the diagnostic {OBJECTIVE}")
    return found


def _drawing(results: Results, request: PlotRequest, facet: Facet) -> Drawing | None:
    findings = results.diagnostics(facet.runs, (OBJECTIVE, CHOSEN), facet.condition)
    fronts: list[tuple[str, Sample, set[int]]] = []
    names: list[str] = []
    dofs: list[str] = []
    for run in facet.runs:
        points = [one for one in findings[run.id] if one.name == OBJECTIVE and one.i is not None]
        if not points:
            continue
        axes_of = {one.j: with_unit(one.label or f"objective {one.j}", one.unit) for one in points}
        names = names or [axes_of[j] for j in sorted(axes_of)]
        dof_of = {one.j: one.dof for one in points}
        dofs = dofs or [dof_of[j] for j in sorted(dof_of)]
        front = np.full((1 + max(one.i for one in points), len(names)), np.nan)
        for one in points:
            front[one.i, sorted(axes_of).index(one.j)] = one.value
        chosen = {int(one.i) for one in findings[run.id] if one.name == CHOSEN}
        label = f"{run.levels[request.rows]}, {run.levels[request.columns]}"
        fronts.append((label, front, chosen))
    if len(names) < 2:
        return None
    every = list(combinations(range(len(names)), 2))
    pairs = (_of_one_dof(every, dofs) or every)[:MOST_PANELS]
    abreast = min(len(pairs), ABREAST)
    rows = -(-len(pairs) // abreast)
    made, axes = panels(rows, abreast, max(3.8, 5.0 / abreast), 3.9)
    for spare in axes[len(pairs) :]:
        spare.remove()
    axes = axes[: len(pairs)]
    for panel, pair in zip(axes, pairs, strict=True):
        _panel(panel, fronts, names, pair)
    headed(made, axes, facet.title("Pareto set"))
    seeds = "; one front a run" if len(fronts) > 1 else ""
    left_out = f"; {len(pairs)} of {len(every)} pairs" if len(pairs) < len(every) else ""
    footnote(made, [f"ringed: the point that was chosen{seeds}{left_out}"])
    return Drawing(facet.file("pareto"), made)


def _of_one_dof(pairs: Sequence[tuple[int, int]], dofs: Sequence[str]) -> list[tuple[int, int]]:
    """Of more than three objectives, the pairs that belong to the same degree of freedom."""
    return [(a, b) for a, b in pairs if dofs[a] == dofs[b]] if len(dofs) > 3 else []


def _panel(
    axes: Axes,
    fronts: Sequence[tuple[str, Sample, set[int]]],
    names: Sequence[str],
    pair: tuple[int, int],
) -> None:
    labels = list(dict.fromkeys(label for label, _, _ in fronts))
    for label, front, chosen in fronts:
        i = labels.index(label)
        colour = PALETTE[i % len(PALETTE)]
        x, y = front[:, pair[0]], front[:, pair[1]]
        marker = marker_of(i)
        axes.plot(x, y, marker, color=colour, markersize=4, alpha=0.75, label=label)
        for at in chosen & set(range(len(front))):
            axes.plot(x[at], y[at], "o", markersize=11, fillstyle="none", color="black", zorder=4)
    axes.set_xlabel(names[pair[0]])
    axes.set_ylabel(names[pair[1]])
    for column, scaled in ((pair[0], axes.set_xscale), (pair[1], axes.set_yscale)):
        values = np.concatenate([front[:, column] for _, front, _ in fronts])
        low, high = np.nanmin(values), np.nanmax(values)
        if low > 0.0 and high > WIDE * low:
            scaled("log")
