"""The candidates of a search: their objective with the best so far, or the front of several.

The figure shows one sweep of hydra/sweeper=optuna, by default the newest.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import (
    MUTED,
    PALETTE,
    REFERENCE,
    Drawing,
    footnote,
    headed,
    metric_label,
    panels,
)
from seatrial.runner.compare.results import Queries
from seatrial.runner.compare.search_candidates import Candidate, Objective, candidates, search_of

FIGURE = Figure(
    "search",
    "The candidates of a search, and the best so far or the front.",
    "a sweep of hydra/sweeper=optuna",
)

MOST_PANELS, ABREAST = 6, 3
LINEAR_RANGE = 30.0  # largest ratio of values on a linear axis
COLOURS = {"complete": PALETTE[0], "pruned": MUTED}
MARKERS = {"complete": "o", "pruned": "x"}


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one search: over its candidates, or each pair of its objectives."""
    sweep, objectives = search_of(results, request.sweep)
    found = candidates(results, sweep, objectives)
    pairs = list(combinations(range(len(objectives)), 2))[:MOST_PANELS]
    columns = min(max(len(pairs), 1), ABREAST)
    rows = -(-max(len(pairs), 1) // columns)
    figure, axes = panels(rows, columns, max(4.2, 6.5 / columns), 3.9)
    for spare in axes[max(len(pairs), 1) :]:
        spare.remove()
    if pairs:
        for panel, pair in zip(axes, pairs, strict=False):
            _front(panel, found, objectives, pair)
    else:
        _progress(axes[0], found, objectives[0])
    seeds = max((len(one.runs) for one in found), default=0)
    headed(figure, axes[: max(len(pairs), 1)], f"Search, sweep {sweep.id}: {sweep.name}")
    infeasible = sum(one.state == "infeasible" for one in found)
    notes = [f"{objectives[0].statistic} over {seeds} seeds; pruned: over those that were sailed"]
    notes += [f"failed or diverged: {infeasible} of {len(found)}"] if infeasible else []
    footnote(figure, notes)
    return [Drawing(f"search-sweep-{sweep.id}", figure)]


def _progress(axes: Axes, found: Sequence[Candidate], objective: Objective) -> None:
    """The objective over the candidates, and the best complete one so far."""
    for state in ("complete", "pruned"):
        own = [one for one in found if one.state == state]
        if own:
            axes.plot(
                [one.number for one in own], [one.values[0] for one in own], MARKERS[state],
                color=COLOURS[state], markersize=4, linestyle="none", label=state,
            )  # fmt: skip
    failed = [one.number for one in found if one.state == "infeasible"]
    if failed:
        axes.plot(
            failed, [0.02] * len(failed), "v", color=PALETTE[5], markersize=5, linestyle="none",
            transform=axes.get_xaxis_transform(), label="infeasible",
        )  # fmt: skip
    best: list[float] = []
    for one in found:
        previous = best[-1] if best else np.nan
        value = one.values[0] if one.state == "complete" else np.nan
        better = np.isnan(previous) or objective.loss(value) < objective.loss(previous)
        best.append(value if better else previous)
    numbers = [one.number for one in found]
    axes.step(numbers, best, where="post", color=REFERENCE, label="best so far")
    axes.set_xlabel("Candidate")
    axes.set_ylabel(metric_label(objective.metric, objective.dof, objective.unit))
    if _wide([one.values[0] for one in found]):
        axes.set_yscale("log")


def _wide(values: Sequence[float]) -> bool:
    finite = [value for value in values if np.isfinite(value)]
    return bool(finite) and min(finite) > 0.0 and max(finite) > LINEAR_RANGE * min(finite)


def _front(
    axes: Axes, found: Sequence[Candidate], objectives: Sequence[Objective], pair: tuple[int, int]
) -> None:
    """Two objectives of all complete candidates, with those that no other one dominates."""
    complete = [one for one in found if one.state == "complete"]
    i, j = pair
    axes.plot(
        [one.values[i] for one in complete], [one.values[j] for one in complete], "o",
        color=MUTED, markersize=3.5, linestyle="none", label="candidates",
    )  # fmt: skip
    losses = np.array(
        [[each.loss(v) for each, v in zip(objectives, one.values, strict=True)] for one in complete]
    )
    best = [
        one
        for one, own in zip(complete, losses, strict=True)
        if not np.any(np.all(losses <= own, axis=1) & np.any(losses < own, axis=1))
    ]
    best.sort(key=lambda one: one.values[i])
    axes.plot(
        [one.values[i] for one in best], [one.values[j] for one in best],
        "o-" if len(objectives) == 2 else "o", color=PALETTE[0], markersize=5, label="front",
    )  # fmt: skip
    if complete:
        axes.plot(
            complete[0].values[i], complete[0].values[j], "D", color=PALETTE[5], markersize=5,
            linestyle="none", label=f"candidate {complete[0].number}",
        )  # fmt: skip
    for k, label, scale in (
        (i, axes.set_xlabel, axes.set_xscale),
        (j, axes.set_ylabel, axes.set_yscale),
    ):
        if _wide([one.values[k] for one in complete]):
            scale("log")
        label(metric_label(objectives[k].metric, objectives[k].dof, objectives[k].unit))
