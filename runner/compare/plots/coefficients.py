"""Identified against true coefficients with 95 % intervals, per degree of freedom.

Coefficients differ by orders of magnitude, so each is shown relative to its true value or, if
that is not known, to its estimate. Only some identifiers have an interval that is tested to cover
the coefficient; the intervals of the others do not include their bias, and are drawn otherwise.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from seatrial.runner.compare.comparability import distinct, with_conditions
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, observations, ordered
from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.plots.request import Facet, PlotRequest, each_facet
from seatrial.runner.compare.plots.style import (
    PALETTE,
    SHADE,
    Drawing,
    footnote,
    headed,
    marker_of,
    panels,
)
from seatrial.runner.compare.statistics import confidence_interval

FIGURE = Figure(
    "coefficients",
    "Identified against true coefficients with 95 % intervals.",
    "coefficients of an identified model",
    caption="Identified against true coefficients",
    each="column",
    place=6,
)

OF_ESTIMATE = "interval of the estimate"
UNCERTAIN = "0.5"  # grey
NORMAL_95 = 1.959963984540054
LINE = 0.145  # height of the line of an estimate [inch]; a text of 8 points fits
WIDEST = 4.0  # limit of the axis, in multiples of the reference; arrows mark values beyond it
NARROWEST = 0.02  # smallest half-range of the axis; hides the rounding errors of an exact fit


@dataclass(frozen=True)
class CoefficientEstimate:
    """A coefficient of one group of runs, relative to `reference`, with its interval."""

    term: str
    unit: str
    reference: float
    known: bool  # the reference is the true value
    value: float
    low: float
    high: float
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
    by_dof = {dof: _groups(numbers[numbers["dof"] == dof], request) for dof in dofs}
    by_dof = {dof: groups for dof, groups in by_dof.items() if any(groups.values())}
    if not by_dof:
        return None
    labels = ordered(label for groups in by_dof.values() for label in groups)
    terms = {dof: _terms(groups) for dof, groups in by_dof.items()}
    lines = {dof: _lines(terms[dof], groups) for dof, groups in by_dof.items()}
    height = 2.2 + LINE * max(places[-1].stop for places in lines.values())
    figure, axes = panels(1, len(by_dof), max(3.9, 5.5 / len(by_dof)), height, rigid=True)
    for panel, (dof, groups) in zip(axes, by_dof.items(), strict=True):
        _panel(panel, dof, dict(zip(terms[dof], lines[dof], strict=True)), groups, labels)
    if len({panel.get_position().y0 for panel in axes}) == 1:  # side by side: lines of one height
        for panel in axes:
            panel.set_ylim(max(places[-1].stop for places in lines.values()), 0.0)
    headed(figure, axes, facet.title(f"Coefficients of the {request.model} model"))
    footnote(figure, _notes(numbers, by_dof))
    return Drawing(facet.file("coefficients"), figure)


def _groups(
    numbers: pd.DataFrame, request: PlotRequest
) -> Mapping[str, Sequence[CoefficientEstimate]]:
    """Return estimates by group: the row, and column and vessel if there are several."""
    factors = [request.rows]
    for name in (request.columns, "vessel"):
        if name not in factors and numbers[name].nunique() > 1:
            factors.append(name)
    groups: dict[str, list[CoefficientEstimate]] = {}
    for levels, group in numbers.groupby(factors, observed=True, sort=False):
        estimates = groups.setdefault(", ".join(levels), [])
        for _, sample in group.groupby("metric", observed=True, sort=False):
            if (estimate := _estimate(sample)) is not None:
                estimates.append(estimate)
    return groups


def _estimate(sample: pd.DataFrame) -> CoefficientEstimate | None:
    """Return mean and interval over seeds, or of a single run; None if it cannot be shown.

    A term whose true value is zero has no relative scale. Neither has a term without a true value
    whose standard error is missing or whose mean is zero.
    """
    values = sample["value"].to_numpy()
    truths = sample["true_value"].unique()
    truth = None if len(truths) > 1 or np.isnan(truths[0]) else float(truths[0])
    errors = sample["std_error"].dropna().tolist()
    mean = float(np.mean(values))
    if truth == 0.0 or (truth is None and (not errors or mean == 0.0)):
        return None
    low, high = mean, mean
    if np.ptp(values) > 0.0:
        low, high = confidence_interval(values)
    elif errors:
        half = NORMAL_95 * math.sqrt(sum(e * e for e in errors) / len(errors))
        low, high = mean - half, mean + half
    reference = mean if truth is None else truth
    ends = sorted((low / reference, high / reference))
    return CoefficientEstimate(
        sample["metric"].iloc[0], sample["unit"].iloc[0], reference, truth is not None,
        mean / reference, ends[0], ends[1], covers=bool(sample["covers"].all()),
    )  # fmt: skip


def _terms(groups: Mapping[str, Sequence[CoefficientEstimate]]) -> list[CoefficientEstimate]:
    """Return one estimate of every term, inertia first, for the labels of the axis."""
    by_term: dict[str, CoefficientEstimate] = {}
    for estimates in groups.values():
        for estimate in estimates:
            by_term.setdefault(estimate.term, estimate)
    return sorted(
        by_term.values(),
        key=lambda estimate: ("_dot" not in estimate.term, len(estimate.term), estimate.term),
    )


def _lines(
    terms: Sequence[CoefficientEstimate], groups: Mapping[str, Sequence[CoefficientEstimate]]
) -> list[range]:
    """Return the lines of each term from the top: one for each group that has it, at least two."""
    first, lines = 0, []
    for term in terms:
        count = sum(any(e.term == term.term for e in estimates) for estimates in groups.values())
        lines.append(range(first, first + max(2, count)))
        first = lines[-1].stop
    return lines


def _panel(
    axes: Axes,
    dof: str,
    lines: Mapping[CoefficientEstimate, range],
    groups: Mapping[str, Sequence[CoefficientEstimate]],
    labels: Sequence[str],
) -> None:
    """Draw the estimates, each on its own line, the lines of every second term shaded."""
    axes.axvline(1.0, color="black", linewidth=1.2)
    places: dict[str, dict[str, float]] = {}
    for k, (term, span) in enumerate(lines.items()):
        having = [i for i in labels if any(e.term == term.term for e in groups.get(i, ()))]
        gap = 0.5 * (len(span) - len(having))
        places[term.term] = {label: span.start + gap + i + 0.5 for i, label in enumerate(having)}
        if k % 2 == 0:
            axes.axhspan(span.start, span.stop, color=SHADE, alpha=0.6, linewidth=0, zorder=0)
    for label, estimates in groups.items():
        heights = [places[e.term][label] for e in estimates]
        _marks(axes, estimates, heights, labels.index(label), label)
    ticks = [0.5 * (span.start + span.stop) for span in lines.values()]
    axes.set_yticks(ticks, [_tick(estimate) for estimate in lines])
    axes.set_ylim([*lines.values()][-1].stop, 0.0)
    known = all(estimate.known for estimate in lines)
    axes.set_xlabel("identified / true value" if known else "relative to the estimate")
    axes.set_title(dof, loc="left")
    low, high = axes.get_xlim()
    low, high = min(low, 1.0 - NARROWEST), max(high, 1.0 + NARROWEST)
    beyond = [e.value for part in groups.values() for e in part if abs(e.value - 1.0) > WIDEST]
    low = 1.0 - WIDEST if any(value < 1.0 for value in beyond) else low
    high = 1.0 + WIDEST if any(value > 1.0 for value in beyond) else high
    axes.set_xlim(max(low, 1.0 - WIDEST), min(high, 1.0 + WIDEST))
    axes.grid(axis="y", visible=False)


def _tick(estimate: CoefficientEstimate) -> str:
    """Return `u_dot: 1195 kg`: the term and the value at 1 on the axis."""
    value = with_unit(number_text(estimate.reference, 4), estimate.unit)
    return f"{estimate.term}: {value}".replace("[", "").replace("]", "")


def _marks(
    axes: Axes,
    estimates: Sequence[CoefficientEstimate],
    places: Sequence[float],
    i: int,
    label: str,
) -> None:
    colour, marker = PALETTE[i % len(PALETTE)], marker_of(i)
    for covers in (True, False):
        part = [
            (e, place) for e, place in zip(estimates, places, strict=True) if e.covers == covers
        ]
        if part:
            _whiskers(axes, part, colour, marker, label)
    for estimate, place in zip(estimates, places, strict=True):
        if abs(estimate.value - 1.0) > WIDEST:
            _arrow(axes, estimate.value, place, colour)


def _whiskers(
    axes: Axes,
    part: Sequence[tuple[CoefficientEstimate, float]],
    colour: str,
    marker: str,
    label: str,
) -> None:
    """Draw marks with intervals; those of the estimate only are thin, grey and dashed."""
    covers = part[0][0].covers
    spans = np.array([[e.value - e.low, e.high - e.value] for e, _ in part])
    drawn = axes.errorbar(
        [estimate.value for estimate, _ in part],
        [place for _, place in part],
        xerr=np.clip(spans.T, 0.0, None),
        fmt=marker,
        color=colour,
        ecolor=colour if covers else UNCERTAIN,
        label=label,
        capsize=2.5 if covers else 0.0,
        markersize=5,
        elinewidth=1.3 if covers else 0.8,
    )
    if any(map(_of_estimate, (estimate for estimate, _ in part))):
        for line in drawn.lines[2]:
            line.set_linestyle("--")
        axes.plot([], [], color=UNCERTAIN, linewidth=0.8, linestyle="--", label=OF_ESTIMATE)


def _of_estimate(estimate: CoefficientEstimate) -> bool:
    """Return whether an interval is shown that is not one of the coefficient."""
    return not estimate.covers and estimate.high > estimate.low


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


def _notes(
    numbers: pd.DataFrame, by_dof: Mapping[str, Mapping[str, Sequence[CoefficientEstimate]]]
) -> list[str]:
    known = numbers.loc[numbers["true_value"] == 0.0, ["dof", "metric"]]
    zero = len(known.drop_duplicates())
    seeds = numbers["run"].nunique() > sum(map(len, by_dof.values())) / len(by_dof)
    notes = [
        "whiskers: 95 % interval, of the mean over seeds (t) where they differ, else of the fit"
    ]
    if not seeds:
        notes = [
            "whiskers: 95 % interval of the fit (1.96 standard errors): what the data leave open;"
            " the model error is in the bands of predictions"
        ]
    if any(_of_estimate(e) for groups in by_dof.values() for part in groups.values() for e in part):
        notes.append(
            f"dashed: {OF_ESTIMATE}, not of the coefficient: without the bias of the identifier"
        )
    if zero:
        notes.append(f"not shown: {zero} terms whose true value is zero")
    return notes
