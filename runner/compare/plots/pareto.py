"""The Pareto set of a multi-objective identification: its objectives and the deployed model.

Diagnostics: `pareto_objective` (i = point, j = objective, label = name of the objective),
`pareto_chosen` (i = point) and `objective` (j) of the model, which is the chosen point or what a
polish has made of it. With up to three objectives every pair has a panel; with more, only pairs of
the same degree of freedom have one.
"""

from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from seatrial.models.diagnostics import NOMINAL_EQUATION
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.selection import Facet, per_facet

FIGURE = Figure(
    "pareto", "The Pareto set of a multi-objective identification.",
    "the diagnostic pareto_objective, as of identifier=nsga2", ("run", "rows", "columns", "facet"),
    place=4,
)  # fmt: skip

OBJECTIVE, CHOSEN, DEPLOYED = "pareto_objective", "pareto_chosen", "objective"
MOST_PANELS, ABREAST = 6, 3
LINEAR_RANGE = 30.0  # largest ratio of values on a linear axis
RING: dict[str, Any] = {"fillstyle": "none", "color": "black", "zorder": 4, "linestyle": "none"}


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> style.Drawing | None:
    frame = facet.diagnostics(results, (OBJECTIVE, CHOSEN, DEPLOYED, *NOMINAL_EQUATION))
    points = frame[(frame["name"] == OBJECTIVE) & frame["i"].notna()]
    objectives = points.drop_duplicates("j").set_index("j").sort_index()
    every, dofs = [*combinations(objectives.index, 2)], objectives["dof"]
    if not every:
        return None
    alike = [(a, b) for a, b in every if dofs[a] == dofs[b]] if len(dofs) > 3 else []
    pairs = (alike or every)[:MOST_PANELS]
    columns = min(len(pairs), ABREAST)
    grid = -(-len(pairs) // columns), columns, max(3.8, 5.0 / columns), 3.9
    figure, axes = style.panels(*grid, count=len(pairs))
    runs, groups, polished = [*points.groupby("run")], list[str](), False
    for run, own in runs:
        front, mine = own.pivot(index="i", columns="j", values="value"), frame[frame["run"] == run]
        chosen = front.loc[front.index.isin(mine.loc[mine["name"] == CHOSEN, "i"])]
        deployed = mine[mine["name"] == DEPLOYED].set_index("j")["value"].reindex(front.columns)
        moved = deployed.notna().all() and not np.isclose(chosen, deployed).all(axis=1).any()
        polished |= moved
        group = ", ".join(own[[request.rows, request.columns]].iloc[0])
        groups += [group] if group not in groups else []
        i = groups.index(group)
        look: dict[str, Any] = {"color": style.colour_of(i), "label": group}
        for panel, (x, y) in zip(axes, pairs, strict=True):
            marker = style.marker_of(i)
            panel.plot(front[x], front[y], marker, markersize=4, alpha=0.75, **look)
            panel.plot(chosen[x], chosen[y], marker="o", markersize=11, **RING)
            if moved:
                panel.plot([deployed[x]], [deployed[y]], marker="D", markersize=9, **RING)
    ends = pd.concat([points, frame[frame["name"] == DEPLOYED]]).groupby("j")["value"]
    log = (ends.min() > 0.0) & (ends.max() > LINEAR_RANGE * ends.min())
    scales = log.map({True: "log", False: "linear"})
    rows = objectives.iterrows()
    named = {j: with_unit(row.label or f"objective {j}", row.unit) for j, row in rows}
    for panel, (x, y) in zip(axes, pairs, strict=True):
        panel.set(xlabel=named[x], ylabel=named[y], xscale=scales[x], yscale=scales[y])
    seeds = "; one front for each run" if len(runs) > 1 else ""
    left_out = f"; {len(pairs)} of {len(every)} pairs" if len(pairs) < len(every) else ""
    made = "; diamond: what the polish made of it" if polished else ""
    notes = [f"circle: the chosen point{made}{seeds}{left_out}"]
    if kept := [*frame.loc[frame["name"].isin([*NOMINAL_EQUATION]), "dof"].unique()]:
        notes.append(
            f"deployed with the nominal equations of {', '.join(kept)}, which are not drawn"
        )
    return style.drawing_of(facet.file("pareto"), figure, axes, facet.title("Pareto set"), notes)


drawings = per_facet(_drawing)
