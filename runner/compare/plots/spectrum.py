"""Singular values and eigenvalues, with the unit circle, of a subspace identification.

Diagnostics: `singular_value` (i = number, from 1), `selected_order`, and `eigenvalue_real`,
`eigenvalue_imag` (i = number), discrete time, of the identified model.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredDiagnostic
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.request import Facet, PlotRequest, each_facet
from seatrial.runner.compare.plots.style import (
    MUTED,
    PALETTE,
    Drawing,
    footnote,
    headed,
    marker_of,
    panels,
)

FIGURE = Figure(
    "spectrum",
    "Singular values and eigenvalues of a subspace identification.",
    "diagnostic singular_value, as of identifier=dsr",
    caption="Singular values and eigenvalues",
    place=5,
)

SINGULAR, ORDER = "singular_value", "selected_order"
REAL, IMAGINARY = "eigenvalue_real", "eigenvalue_imag"


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet: singular values left, eigenvalues right, if stored."""
    missing = f"plot spectrum: no run that matches has the diagnostic {SINGULAR} or {REAL}"
    return each_facet(results, request, partial(_drawing, results, request), missing)


def _drawing(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    names = (SINGULAR, ORDER, REAL, IMAGINARY)
    diagnostics = results.diagnostics(facet.runs, names, facet.condition)
    groups: dict[str, list[Sequence[StoredDiagnostic]]] = {}
    for run in facet.runs:
        if any(row.name in (SINGULAR, REAL) for row in diagnostics[run.id]):
            label = f"{run.levels[request.rows]}, {run.levels[request.columns]}"
            groups.setdefault(label, []).append(diagnostics[run.id])
    if not groups:
        return None
    rows = [row for group in groups.values() for diagnostics in group for row in diagnostics]
    panel_functions = [
        draw
        for draw, name_needed in ((_singular_values, SINGULAR), (_eigenvalues, REAL))
        if any(row.name == name_needed for row in rows)
    ]
    figure, axes = panels(1, len(panel_functions), max(4.4, 5.0 / len(panel_functions)), 4.2)
    for panel, draw in zip(axes, panel_functions, strict=True):
        for i, (label, group) in enumerate(groups.items()):
            for marks in group:
                draw(panel, marks, i, label)
    headed(figure, axes, facet.title("Spectrum"))
    notes = ["filled: within the selected order"] if _singular_values in panel_functions else []
    footnote(figure, [*notes, "one set of marks for each run"])
    return Drawing(facet.file("spectrum"), figure)


def _singular_values(axes: Axes, rows: Sequence[StoredDiagnostic], i: int, label: str) -> None:
    points = sorted((row.i, row.value) for row in rows if row.name == SINGULAR and row.value)
    order = next((row.value for row in rows if row.name == ORDER), None)
    unit = next((row.unit for row in rows if row.name == SINGULAR), "")
    colour, marker = PALETTE[i % len(PALETTE)], marker_of(i)
    numbers, values = [n for n, _ in points], [v for _, v in points]
    axes.plot(numbers, values, marker=marker, color=colour, fillstyle="none", label=label)
    if order is not None:
        selected = [(n, v) for n, v in points if n <= order]
        axes.plot([n for n, _ in selected], [v for _, v in selected], marker, color=colour)
    axes.set_yscale("log")
    axes.set_xlabel("Number")
    axes.set_ylabel(with_unit("Singular value", unit))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _eigenvalues(axes: Axes, rows: Sequence[StoredDiagnostic], i: int, label: str) -> None:
    real = {row.i: row.value for row in rows if row.name == REAL}
    imaginary = {row.i: row.value for row in rows if row.name == IMAGINARY}
    numbers = sorted(real.keys() & imaginary.keys())
    if not axes.patches:
        axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=MUTED, linewidth=1.2))
        axes.axhline(0.0, color=MUTED, linewidth=0.6)
        axes.axvline(0.0, color=MUTED, linewidth=0.6)
    axes.plot(
        [real[k] for k in numbers],
        [imaginary[k] for k in numbers],
        marker_of(i),
        color=PALETTE[i % len(PALETTE)],
        label=label,
        markersize=6,
        alpha=0.8,
    )
    reach = 1.1 * max([1.0, *np.abs(list(real.values())), *np.abs(list(imaginary.values()))])
    low, high = axes.get_xlim()
    reach = max(reach, abs(low), abs(high)) if len(axes.lines) > 3 else reach
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_xlabel("Real part")
    axes.set_ylabel("Imaginary part")
