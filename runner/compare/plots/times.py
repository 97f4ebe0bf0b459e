"""Time of n predictions without JIT, with JIT and in batches, as in Hoyer (2021), Fig. 7.21.

Diagnostics: `prediction_time` (i = n, label = way), which includes the compilation, and
`prediction_time_compiled`, which does not.
"""

from functools import partial

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.plots.request import (
    Facet,
    PlotRequest,
    each_facet,
    newest_with,
    subtitle,
)
from seatrial.runner.compare.plots.style import (
    PALETTE,
    Drawing,
    footnote,
    headed,
    marker_of,
    panels,
)
from seatrial.runner.compare.results import Results

FIGURE = Figure(
    "times",
    "Time of n predictions without JIT, with JIT and in batches.",
    "diagnostic prediction_time, of identifier=prediction_times",
)

TIME, COMPILED = "prediction_time", "prediction_time_compiled"


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet, of its newest run with times."""
    missing = f"plot times: no run that matches has the diagnostic {TIME}"
    return each_facet(results, request, partial(_drawing, results), missing)


def _drawing(results: Results, facet: Facet) -> Drawing | None:
    newest = newest_with(results, facet, (TIME, COMPILED))
    if newest is None:
        return None
    run, rows = newest
    chart, (axes,) = panels(1, 1, 6.5, 4.2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for k, method in enumerate(dict.fromkeys(row.label for row in rows)):
        for name, line, text in ((TIME, "-", method), (COMPILED, ":", None)):
            points = sorted((r.i, r.value) for r in rows if (r.name, r.label) == (name, method))
            x, y = zip(*points, strict=True)
            axes.plot(x, y, color=PALETTE[k], marker=marker_of(k), linestyle=line, label=text)
    axes.set_xlabel("Number of predictions")
    axes.set_ylabel("Time [s]")
    headed(chart, [axes], f"Time of predictions, {subtitle(run)}")
    footnote(chart, ["solid: with compilation of the machine code; dotted: without"])
    return Drawing(f"times-run-{run.id}", chart)
