"""Responses of several controllers on one mission: pose, force and wind by axis."""

from collections.abc import Sequence

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import FINISHED, Queries, StoredRun, ordered
from seatrial.runner.compare.plots.request import PREFIX, Facet, PlotRequest, facets
from seatrial.runner.compare.plots.response import NOTE, overlaid
from seatrial.runner.compare.plots.style import PALETTE, Drawing, footnote, headed, limits_of
from seatrial.runner.vocabulary import GROUPS

FIGURE = Figure(
    "controllers",
    "Responses of several controllers on one mission, in the same axes.",
    "two runs with the series deployment_* that differ in the rows alone",
    caption="Controllers on one mission",
    each="dof",
    rows="controller",
    place=11,
)

SHARED_CHOICES = (*GROUPS, "seed")


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure for each facet: the newest run of every level of the rows.

    Rows are one factor or several, comma-separated; all other choices equal those of the newest
    run.
    """
    figures = []
    rows = [name.strip() for name in request.rows.split(",")]
    for facet in facets(results, request, rows):
        runs = _newest_runs(results, request, facet, rows)
        if len(runs) > 1:
            figures.append(_drawing(results, request, runs, facet.file("controllers"), facet.label))
    if not figures:
        raise ConfigurationError(
            f"plot controllers: got no two finished runs that differ in {request.rows} only, "
            f"expected a mission that each of them sailed with the {request.model} model"
        )
    return figures


def _newest_runs(
    results: Queries, request: PlotRequest, facet: Facet, rows: Sequence[str]
) -> dict[str, StoredRun]:
    """Return the newest run of every level, with all other choices as in the newest run."""
    kind, stored = PREFIX + request.model, results.series_columns(facet.condition)
    candidates = [
        run for run in facet.runs if run.status == FINISHED and kind in stored.get(run.id, ())
    ]
    fixed = [name for name in SHARED_CHOICES if name not in rows]
    newest: dict[str, StoredRun] = {}
    for run in candidates:
        if all(run.levels[name] == candidates[-1].levels[name] for name in fixed):
            newest[", ".join(run.levels[name] for name in rows)] = run
    return {label: newest[label] for label in ordered(newest)}


def _drawing(
    results: Queries, request: PlotRequest, runs: dict[str, StoredRun], name: str, label: str
) -> Drawing:
    lines = {
        level: results.reader.series(run.id, PREFIX + request.model) for level, run in runs.items()
    }
    colours = [PALETTE[i % len(PALETTE)] for i in range(len(lines))]
    first = next(iter(runs.values()))
    limits = limits_of(results.reader.run(first.id).config)
    figure = overlaid(lines, request, colours, f"plot of {request.rows}", limits)
    title = [first.levels[n] for n in ("vessel", "disturbance", "evaluation")]
    title += [label] if label else []
    headed(
        figure, figure.axes,
        f"Response with the {request.model} model, {', '.join(title)}, "
        f"seed {first.levels['seed']}",
    )  # fmt: skip
    sources = ", ".join(f"{level}: run {run.id}" for level, run in runs.items())
    footnote(figure, [NOTE, sources])
    return Drawing(name, figure)
