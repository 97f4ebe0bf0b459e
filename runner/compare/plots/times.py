"""Time of n predictions without JIT, with it and many at once, as Hoyer (2021), Fig. 7.21.

Diagnostics: `prediction_time` (i = n, label = way), which includes the compilation, and
`prediction_time_compiled`, which does not.
"""

from collections.abc import Sequence
from typing import Any

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
from seatrial.runner.compare.results import Results

FIGURE = Figure(
    "times",
    "Time of n predictions without JIT, with it and many at once.",
    "diagnostic prediction_time, of identifier=prediction_times",
)

TIME, COMPILED = "prediction_time", "prediction_time_compiled"


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """One figure a facet, of its newest run that has times."""
    made = []
    for facet in facets(results, request):
        findings = results.diagnostics(facet.runs, (TIME, COMPILED), facet.condition)
        having = [r for r in facet.runs if any(one.name == TIME for one in findings[r.id])]
        if having:
            run = having[-1]
            made.append(_drawing(run.id, subtitle(run), findings[run.id]))
    if not made:
        raise ConfigurationError(f"plot times: no run that matches has the diagnostic {TIME}")
    return made


def _drawing(number: int, about: str, rows: Sequence[Any]) -> Drawing:
    made = figure(6.5, 4.2)
    axes = made.subplots()
    axes.set_xscale("log")
    axes.set_yscale("log")
    for k, way in enumerate(dict.fromkeys(row.label for row in rows)):
        for name, line, text in ((TIME, "-", way), (COMPILED, ":", None)):
            points = sorted((r.i, r.value) for r in rows if (r.name, r.label) == (name, way))
            x, y = zip(*points, strict=True)
            axes.plot(x, y, color=PALETTE[k], marker=marker_of(k), linestyle=line, label=text)
    axes.set_xlabel("Number of predictions")
    axes.set_ylabel("Time [s]")
    headed(made, [axes], f"Time of predictions, {about}")
    footnote(made, ["solid: the machine code is compiled first; dotted: it is there already"])
    return Drawing(f"times-run-{number}", made)
