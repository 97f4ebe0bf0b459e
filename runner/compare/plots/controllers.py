"""Two or more controllers on one mission, over one another: pose, force and wind by axis."""

from collections.abc import Sequence

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.plots.request import PlotRequest, facets
from seatrial.runner.compare.plots.response import NOTE, overlaid
from seatrial.runner.compare.plots.sailed_missions import PREFIX
from seatrial.runner.compare.plots.style import PALETTE, Drawing, footnote, headed
from seatrial.runner.compare.results import FINISHED, Results, Run, ordered
from seatrial.runner.vocabulary import GROUPS

FIGURE = Figure(
    "controllers",
    "Responses of several controllers on one mission over one another.",
    "two runs with the series deployment_* that differ in the rows alone",
    caption="Controllers on one mission",
    each="dof",
    rows="controller",
    place=11,
)

SAME = (*GROUPS, "seed")


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """One figure a facet: the newest run of every level of the rows, all other choices equal.

    Rows are one factor or several parted by commas; the newest run says what the rest must be.
    """
    found = []
    rows = [name.strip() for name in request.rows.split(",")]
    for facet in facets(results, request, rows):
        runs = _rivals(results, request, facet.runs, rows)
        if len(runs) > 1:
            found.append(_drawing(results, request, runs, facet.file("controllers"), facet.label))
    if not found:
        raise ConfigurationError(
            f"plot controllers: got no two finished runs that differ in {request.rows} alone, "
            f"expected a mission that each of them sailed with the {request.model} model"
        )
    return found


def _rivals(
    results: Results, request: PlotRequest, runs: Sequence[Run], rows: Sequence[str]
) -> dict[str, Run]:
    """The newest run of every level that met the same circumstances as the newest of all."""
    condition = results.where(request.where)
    kind, stored = PREFIX + request.model, results.series_columns(condition)
    able = [run for run in runs if run.status == FINISHED and kind in stored.get(run.id, ())]
    kept = [name for name in SAME if name not in rows]
    found: dict[str, Run] = {}
    for run in able:
        if all(run.levels[name] == able[-1].levels[name] for name in kept):
            found[", ".join(run.levels[name] for name in rows)] = run
    return {label: found[label] for label in ordered(found)}


def _drawing(
    results: Results, request: PlotRequest, runs: dict[str, Run], name: str, label: str
) -> Drawing:
    lines = {
        level: results.reader.series(run.id, PREFIX + request.model) for level, run in runs.items()
    }
    colours = [PALETTE[i % len(PALETTE)] for i in range(len(lines))]
    made = overlaid(lines, request, colours, f"plot of {request.rows}")
    one = next(iter(runs.values()))
    about = [one.levels[n] for n in ("vessel", "disturbance", "evaluation")]
    about += [label] if label else []
    headed(
        made, made.axes,
        f"{request.model.capitalize()} model, {', '.join(about)}, seed {one.levels['seed']}",
    )  # fmt: skip
    which = ", ".join(f"{level}: run {run.id}" for level, run in runs.items())
    footnote(made, [NOTE, which])
    return Drawing(name, made)
