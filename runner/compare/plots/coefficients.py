"""Identified against true coefficients with 95 % intervals, per degree of freedom.

Coefficients differ by orders of magnitude, so each is shown relative to its true value or, if
that is not known, to its estimate. Only some identifiers have an interval that is tested to cover
the coefficient; the intervals of the others do not include their bias, and are dashed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from seatrial.runner.compare.comparability import distinct, with_conditions
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, observations, ordered
from seatrial.runner.compare.grid import number_text, unit_text
from seatrial.runner.compare.plots.request import Facet, PlotRequest, each_facet
from seatrial.runner.compare.plots.style import (
    PALETTE,
    SHADE,
    Drawing,
    drawing_of,
    marker_of,
    panels,
)
from seatrial.runner.compare.statistics import confidence_interval

FIGURE = Figure(
    "coefficients",
    "Identified against true coefficients with 95 % intervals.",
    "coefficients of an identified model",
    ("run", "rows", "columns", "dof", "model", "facet", "pool"),
    caption="Identified against true coefficients",
    each="column",
    place=6,
)

INTERVAL, BIASED = "95 % interval", "95 % interval, without bias"  # by whether it covers
OF_SEEDS = "intervals: of the mean over seeds (t) where they differ, else of the fit"
UNCERTAIN = "0.5"  # grey
NORMAL_95 = 1.959963984540054
LINE = 0.145  # height of the line of an estimate [inch]; a text of 8 points fits
WIDEST = 4.0  # limit of the axis, in multiples of the reference; arrows mark values beyond it
MOST_NAMED = 8  # terms of a note
NARROWEST = 0.02  # smallest half-range of the axis; hides the rounding errors of an exact fit


@dataclass(frozen=True)
class CoefficientEstimate:
    """A coefficient of one group of runs, relative to `reference`, with its interval."""

    group: str
    term: str
    unit: str
    reference: float
    known: bool  # the reference is the true value
    value: float
    low: float
    high: float
    of_seeds: bool  # the interval is that of a mean over seeds
    covers: bool  # the interval is one of the coefficient, not only of its estimate


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, one panel for each DOF, one mark for each group and term.

    Each vessel has its own figure: the values at 1 on the axis are those of one vessel.
    """
    if request.facet is None and "vessel" in (request.rows, request.columns):
        request = replace(request, facet="vessel")
    missing = f"no finished run that matches has coefficients of model {request.model}"
    draw = partial(_drawing, results, request)
    return each_facet(results, request, draw, f"plot coefficients: {missing}", averages=True)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    marks = results.marks(facet.condition)
    numbers = observations(results.coefficients(facet.condition), facet.trials, marks)
    numbers = numbers[(numbers["model"] == request.model) & (numbers["reason"] == "")]
    if numbers.empty:
        return None
    numbers = distinct(with_conditions(results, facet.trials, numbers)[0])
    numbers["covers"] = numbers["run"].isin(results.covering(facet.condition))
    dofs = request.shown(lambda dof: bool((numbers["dof"] == dof).any()))
    by_dof = {dof: _estimates(numbers[numbers["dof"] == dof], request) for dof in dofs}
    by_dof = {dof: estimates for dof, estimates in by_dof.items() if estimates}
    if not by_dof:
        return None
    groups = ordered(one.group for estimates in by_dof.values() for one in estimates)
    spans = {dof: _spans(estimates) for dof, estimates in by_dof.items()}
    lowest = max(span.stop for own in spans.values() for span in own.values())
    width = max(3.9, 5.5 / len(by_dof))
    figure, axes = panels(1, len(by_dof), width, 2.2 + LINE * lowest, rigid=True)
    for panel, (dof, estimates) in zip(axes, by_dof.items(), strict=True):
        _panel(panel, estimates, spans[dof], groups)
        panel.set_title(dof, loc="left")
    if len({panel.get_position().y0 for panel in axes}) == 1:  # side by side: lines of one height
        for panel in axes:
            panel.set_ylim(lowest, 0.0)
    known = numbers[(numbers["true_value"] == 0.0) & numbers["dof"].isin([*by_dof])]
    terms = zip(known["metric"], known["dof"], strict=True)
    zero = dict.fromkeys(f"{term} ({dof})" for term, dof in terms)
    notes = [OF_SEEDS] * any(e.of_seeds for estimates in by_dof.values() for e in estimates)
    if zero:
        named = ", ".join(zero) if len(zero) <= MOST_NAMED else f"{len(zero)} terms"
        notes.append(f"not shown, as the true value is zero: {named}")
    title = facet.title(f"Coefficients of the {request.model} model")
    return drawing_of(facet.file("coefficients"), figure, axes, title, notes)


def _estimates(numbers: pd.DataFrame, request: PlotRequest) -> list[CoefficientEstimate]:
    """Return the estimates of each group (row, and column and vessel if several) and term."""
    factors = [request.rows]
    for name in (request.columns, "vessel"):
        if name not in factors and numbers[name].nunique() > 1:
            factors.append(name)
    groups = numbers.groupby([*factors, "metric"], observed=True, sort=False)
    estimates = (_estimate(", ".join(levels[:-1]), sample) for levels, sample in groups)
    return [estimate for estimate in estimates if estimate is not None]


def _estimate(group: str, sample: pd.DataFrame) -> CoefficientEstimate | None:
    """Return mean and interval over seeds, or of a single run; None if it cannot be shown.

    A term whose true value is zero has no relative scale. Neither has a term without a true value
    whose standard error is missing or whose mean is zero.
    """
    values, first = sample["value"].to_numpy(), sample.iloc[0]
    truths, errors = sample["true_value"].unique(), sample["std_error"].dropna().tolist()
    truth = None if len(truths) > 1 or np.isnan(truths[0]) else float(truths[0])
    mean = float(np.mean(values))
    if truth == 0.0 or (truth is None and (not errors or mean == 0.0)):
        return None
    low, high, of_seeds = mean, mean, bool(np.ptp(values) > 0.0)
    if of_seeds:
        low, high = confidence_interval(values)
    elif errors:
        half = NORMAL_95 * math.sqrt(sum(e * e for e in errors) / len(errors))
        low, high = mean - half, mean + half
    reference = mean if truth is None else truth
    ends = sorted((low / reference, high / reference))
    return CoefficientEstimate(
        group, first["metric"], first["unit"], reference, truth is not None, mean / reference,
        ends[0], ends[1], of_seeds, bool(sample["covers"].all()),
    )  # fmt: skip


def _spans(estimates: Sequence[CoefficientEstimate]) -> dict[str, range]:
    """Return the lines of each term from the top, inertia first.

    There is one line for each group that has the term, and at least two.
    """
    counts: dict[str, int] = {}
    for estimate in estimates:
        counts[estimate.term] = counts.get(estimate.term, 0) + 1
    first, spans = 0, {}
    for term in sorted(counts, key=lambda term: ("_dot" not in term, len(term), term)):
        spans[term] = range(first, first + max(2, counts[term]))
        first = spans[term].stop
    return spans


def _panel(
    axes: Axes,
    estimates: Sequence[CoefficientEstimate],
    spans: Mapping[str, range],
    groups: Sequence[str],
) -> None:
    """Draw the estimates, each on its own line, the lines of every second term shaded."""
    axes.axvline(1.0, color="black", linewidth=1.2)
    ticks = {}
    for k, (term, span) in enumerate(spans.items()):
        own = sorted((e for e in estimates if e.term == term), key=lambda e: groups.index(e.group))
        first = span.start + 0.5 * (len(span) - len(own)) + 0.5
        for i, estimate in enumerate(own):
            _mark(axes, estimate, first + i, groups.index(estimate.group))
        ticks[_tick(own[0])] = 0.5 * (span.start + span.stop)
        if k % 2 == 0:
            axes.axhspan(span.start, span.stop, color=SHADE, alpha=0.6, linewidth=0, zorder=0)
    for covers, label in ((True, INTERVAL), (False, BIASED)):
        if any(e.covers == covers and e.high > e.low for e in estimates):
            axes.plot([], [], label=label, **_look(covers, "black"))
    axes.set_yticks([*ticks.values()], [*ticks])
    axes.set_ylim([*spans.values()][-1].stop, 0.0)
    known = all(estimate.known for estimate in estimates)
    axes.set_xlabel("identified / true value" if known else "relative to the estimate")
    low, high = axes.get_xlim()
    low, high = min(low, 1.0 - NARROWEST), max(high, 1.0 + NARROWEST)
    beyond = [e.value for e in estimates if abs(e.value - 1.0) > WIDEST]
    low = 1.0 - WIDEST if any(value < 1.0 for value in beyond) else low
    high = 1.0 + WIDEST if any(value > 1.0 for value in beyond) else high
    axes.set_xlim(max(low, 1.0 - WIDEST), min(high, 1.0 + WIDEST))
    axes.grid(axis="y", visible=False)


def _tick(estimate: CoefficientEstimate) -> str:
    """Return `u_dot: 1195 kg`: the term and the value at 1 on the axis."""
    value = f"{number_text(estimate.reference, 4)} {unit_text(estimate.unit)}"
    return f"{estimate.term}: {value.rstrip()}"


def _look(covers: bool, colour: str) -> dict[str, Any]:
    """Return how an interval is drawn: that of an estimate only is thin, grey and dashed."""
    if covers:
        return {"color": colour, "linewidth": 1.3}
    return {"color": UNCERTAIN, "linewidth": 0.8, "linestyle": "--"}


def _mark(axes: Axes, estimate: CoefficientEstimate, place: float, i: int) -> None:
    """Draw one estimate, of group i, with its interval."""
    colour = PALETTE[i % len(PALETTE)]
    if estimate.high > estimate.low:
        look = _look(estimate.covers, colour)
        axes.plot([estimate.low, estimate.high], [place, place], **look)
    axes.plot(
        [estimate.value], [place], marker_of(i), color=colour, markersize=5, label=estimate.group
    )
    if abs(estimate.value - 1.0) > WIDEST:
        _arrow(axes, estimate.value, place, colour)


def _arrow(axes: Axes, value: float, place: float, colour: str) -> None:
    """Draw an arrow at the edge for a value outside the axis."""
    right = value > 1.0
    axes.annotate(
        f"{number_text(value, 2)} →" if right else f"← {number_text(value, 2)}",
        (1.0 + (WIDEST if right else -WIDEST), place),
        xytext=(-4 if right else 4, 0),
        textcoords="offset points",
        ha="right" if right else "left",
        va="center",
        fontsize=7.5,
        color=colour,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        zorder=4,
    )
