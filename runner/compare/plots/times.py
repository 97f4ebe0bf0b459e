"""Time of n predictions without JIT, with JIT and in batches, as in Hoyer (2021), Fig. 7.21.

Diagnostics: `prediction_time` (i = n, label = way), which includes the compilation, and
`prediction_time_compiled`, which does not.
"""

from collections.abc import Sequence

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.plots.request import PlotRequest, facets, subtitle
from seatrial.runner.compare.plots.style import (
    PALETTE,
    Drawing,
    figure,
    footnote,
    headed,
    marker_of,
)
from seatrial.runner.compare.results import DiagnosticRow, Results

FIGURE = Figure(
    "times",
    "Time of n predictions without JIT, with JIT and in batches.",
    "diagnostic prediction_time, of identifier=prediction_times",
)

TIME, COMPILED = "prediction_time", "prediction_time_compiled"


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, of its newest run with times."""
    figures = []
    for facet in facets(results, request):
        findings = results.diagnostics(facet.runs, (TIME, COMPILED), facet.condition)
        candidates = [r for r in facet.runs if any(row.name == TIME for row in findings[r.id])]
        if candidates:
            run = candidates[-1]
            figures.append(_drawing(run.id, subtitle(run), findings[run.id]))
    if not figures:
        raise ConfigurationError(f"plot times: no run that matches has the diagnostic {TIME}")
    return figures


def _drawing(number: int, subject: str, rows: Sequence[DiagnosticRow]) -> Drawing:
    chart = figure(6.5, 4.2)
    axes = chart.subplots()
    axes.set_xscale("log")
    axes.set_yscale("log")
    for k, method in enumerate(dict.fromkeys(row.label for row in rows)):
        for name, line, text in ((TIME, "-", method), (COMPILED, ":", None)):
            points = sorted((r.i, r.value) for r in rows if (r.name, r.label) == (name, method))
            x, y = zip(*points, strict=True)
            axes.plot(x, y, color=PALETTE[k], marker=marker_of(k), linestyle=line, label=text)
    axes.set_xlabel("Number of predictions")
    axes.set_ylabel("Time [s]")
    headed(chart, [axes], f"Time of predictions, {subject}")
    footnote(chart, ["solid: with compilation of the machine code; dotted: without"])
    return Drawing(f"times-run-{number}", chart)
