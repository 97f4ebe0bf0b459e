"""Identified against true coefficients with 95 % intervals, per degree of freedom.

Coefficients differ by orders of magnitude, so each is shown relative to its true value or, if
that is not known, to its estimate. Only some identifiers have an interval that is tested to cover
the coefficient; the intervals of the others do not include their bias, and are dashed.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from seatrial.runner.compare.comparability import with_conditions
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import FINISHED, Queries, observations, ordered
from seatrial.runner.compare.grid import number_text, unit_text
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.selection import Facet, per_facet
from seatrial.runner.compare.statistics import confidence_interval, pivot

FIGURE = Figure(
    "coefficients", "Identified against true coefficients with 95 % intervals.",
    "coefficients of an identified model",
    ("run", "rows", "columns", "dof", "model", "facet", "pool"), place=6,
)  # fmt: skip

LOOKS: dict[bool, tuple[str, dict[str, Any]]] = {  # of an interval, by whether it covers
    True: ("95 % interval", {"linewidth": 1.3}),
    False: ("95 % interval, without bias", {"linewidth": 0.8, "linestyle": "--", "color": "0.5"}),
}
OF_SEEDS = "intervals: of the mean over seeds (t) where they differ, else of the fit"
NORMAL_95 = 1.959963984540054
LINE_INCH = 0.145  # height of the line of an estimate [inch]; a text of 8 points fits
WIDEST = 4.0  # limit of the axis, in multiples of the reference; arrows mark values beyond it
MOST_NAMED = 8  # terms of a note
AT_EDGE: dict[str, Any] = {"fontsize": 7.5, "zorder": 4}  # of the text of an arrow
NARROWEST = 0.02  # smallest half-range of the axis; hides the rounding errors of an exact fit


def drawings(results: Queries, request: PlotRequest) -> list[style.Drawing]:
    """Draw one figure for each facet, one panel for each DOF, one mark for each group and term.

    Each vessel has its own figure: the values at 1 on the axis are those of one vessel.
    """
    if request.facet is None and "vessel" in (request.rows, request.columns):
        request = replace(request, facet="vessel")
    return per_facet(_drawing, averages=True)(results, request)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> style.Drawing | None:
    marks = results.marks(facet.condition)
    numbers = observations(results.coefficients(facet.condition), facet.trials, marks)
    numbers = numbers[(numbers["model"] == request.model) & (numbers["reason"] == "")]
    dofs = request.shown(lambda dof: bool((numbers["dof"] == dof).any()))
    numbers = numbers[numbers["dof"].isin(dofs)]
    if numbers.empty:
        return None
    numbers = with_conditions(results, facet.trials, numbers.assign(is_baseline=False))[0]
    numbers["interval_of_estimate"] = ~numbers["run"].isin(results.covering(facet.condition))
    estimates = _estimates(numbers, request)
    if estimates.empty:
        return None
    shown = dict(iter(estimates.groupby("dof", observed=True, sort=False)))
    groups = ordered(estimates["group"])
    lowest = max(int(own.groupby("term").size().clip(lower=2).sum()) for own in shown.values())
    width = max(3.9, 5.5 / len(shown))
    figure, axes = style.panels(1, len(shown), width, 2.2 + LINE_INCH * lowest)
    for panel, dof in zip(axes, [dof for dof in dofs if dof in shown], strict=True):
        _panel(panel, shown[dof], groups)
        panel.set_title(dof, loc="left")
        panel.set_ylim(lowest, 0.0)
    notes = [OF_SEEDS] if estimates["of_seeds"].any() else []
    known = numbers[numbers["true_value"] == 0.0]
    zero = dict.fromkeys(f"{row.metric} ({row.dof})" for row in known.itertuples())
    if zero:
        named = ", ".join(zero) if len(zero) <= MOST_NAMED else f"{len(zero)} terms"
        notes.append(f"not shown, as the true value is zero: {named}")
    if request.rows in facet.trials:
        gone = facet.trials.loc[facet.trials["status"] != FINISHED, request.rows]
        gone = gone.value_counts(sort=False)
        lost = ", ".join(f"{count} of {level}" for level, count in gone.items() if count)
        notes += [f"trials that were lost: {lost}"] if lost else []
    title = facet.title(f"Coefficients of the {request.model} model")
    return style.drawing_of(facet.file("coefficients"), figure, axes, title, notes)


def _estimates(numbers: pd.DataFrame, request: PlotRequest) -> pd.DataFrame:
    """Return mean and interval over seeds, or of a single run, of each group and term.

    A group is a row, and a column and a vessel if there are several. `value`, `low` and `high` are
    relative to `reference`, the true value or, if it is not `known`, the estimate. A term whose
    true value is zero has no relative scale and is left out; so is a term without a true value
    whose standard error is missing or whose mean is zero.
    """
    factors = [request.rows]
    for name in (request.columns, "vessel"):
        if name not in factors and numbers[name].nunique() > 1:
            factors.append(name)
    table, rows = pivot(numbers, tuple(factors), ("dof", "metric")), []
    samples = table.samples()
    for cell in table.cells.itertuples():
        sample, truth = samples[cell.Index], cell.true_value
        mean = float(np.mean(sample))
        reference = mean if np.isnan(truth) else truth
        if reference == 0.0 or np.isnan([truth, cell.std_error]).all():
            continue
        half, of_seeds = NORMAL_95 * np.nan_to_num(cell.std_error), bool(np.ptp(sample) > 0.0)
        ends = confidence_interval(sample) if of_seeds else (mean - half, mean + half)
        low, high = sorted(end / reference for end in ends)
        rows.append({
            "group": ", ".join(cell.row), "dof": cell.column[0], "term": cell.column[1],
            "unit": min(cell.units, default=""), "reference": reference,
            "known": not np.isnan(truth), "value": mean / reference, "low": low, "high": high,
            "of_seeds": of_seeds, "covers": not cell.interval_of_estimate,
        })  # fmt: skip
    return pd.DataFrame(rows)


def _panel(axes: Axes, estimates: pd.DataFrame, groups: list[str]) -> None:
    """Draw the estimates, each on its own line, inertia first; every second term is shaded."""
    axes.axvline(1.0, color="black", linewidth=1.2)
    top, ticks = 0, {}
    terms = sorted({*estimates["term"]}, key=lambda term: ("_dot" not in term, len(term), term))
    for k, term in enumerate(terms):
        own = estimates[estimates["term"] == term]
        lines = max(2, len(own))
        first = top + 0.5 * (lines - len(own)) + 0.5
        for i, row in enumerate(sorted(own.itertuples(), key=lambda row: groups.index(row.group))):
            place, number = first + i, groups.index(row.group)
            colour, side = style.colour_of(number), np.sign(row.value - 1.0)
            if row.high > row.low:
                look = {"color": colour} | LOOKS[row.covers][1]
                axes.plot([row.low, row.high], [place, place], **look)
            marker = style.marker_of(number)
            axes.plot([row.value], [place], marker, color=colour, markersize=5, label=row.group)
            if abs(row.value - 1.0) > WIDEST:  # an arrow at the edge
                text, edge = number_text(row.value, 2), 1.0 + side * WIDEST
                words, ha = (f"{text} → ", "right") if side > 0.0 else (f" ← {text}", "left")
                axes.text(edge, place, words, va="center", ha=ha, color=colour, **AT_EDGE)
        reference, unit = own["reference"].iloc[0], unit_text(own["unit"].iloc[0])
        ticks[f"{term}: {number_text(reference, 4)} {unit}".rstrip()] = top + 0.5 * lines
        if k % 2 == 0:
            axes.axhspan(top, top + lines, color=style.SHADE, alpha=0.6, linewidth=0, zorder=0)
        top += lines
    for covers, (label, look) in LOOKS.items():
        if ((estimates["covers"] == covers) & (estimates["high"] > estimates["low"])).any():
            axes.plot([], [], label=label, **({"color": "black"} | look))
    axes.set_yticks([*ticks.values()], [*ticks])
    known = estimates["known"].all()
    axes.set_xlabel("identified / true value" if known else "relative to the estimate")
    low, high = axes.get_xlim()
    low, high = min(low, 1.0 - NARROWEST), max(high, 1.0 + NARROWEST)
    axes.set_xlim(max(low, 1.0 - WIDEST), min(high, 1.0 + WIDEST))
    axes.grid(axis="y", visible=False)
