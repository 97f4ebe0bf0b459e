"""One self-contained page about a set of runs: tables, figures, failures, provenance."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.comparison_table import comparison
from seatrial.runner.compare.figures import Figure, drawings_of, figures
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.grid import Grid, grid_of, one_line
from seatrial.runner.compare.page import Picture, picture, render_page, write_page
from seatrial.runner.compare.results import Results, Run, ordered
from seatrial.runner.compare.runs import RUN_COLUMNS, plain
from seatrial.runner.compare.selection import TableRequest
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.mask import without_passwords
from seatrial.runner.database.records import RunDetail, SweepSummary
from seatrial.runner.database.tables import Run as RunTable
from seatrial.runner.record.catalogue import METRICS, definition_of
from seatrial.runner.vocabulary import COMBINED, DOF_ORDER, GROUPS

if TYPE_CHECKING:
    from seatrial.runner.compare.plots.request import PlotRequest


# The metrics that have a table, and whether it is open when the page opens.
TABLES = {
    "force_mse": True,
    "force_mse_filtered": False,
    "velocity_rmse_free_run": True,
    "velocity_rmse_one_step": False,
    "coefficient_error": False,
    "e_pos_mae": True,
    "e_psi_mae": True,
    "error_mae": False,
    "steady_state_error": False,
    "tau_mean_abs": False,
    "power_mean": False,
    "iaew": False,
}
MOST_LISTED = 500  # runs and failures on the page; the database has them all


@dataclass(frozen=True)
class ReportRequest:
    """What a report is about."""

    rows: str = "identifier"
    columns: str = "disturbance"
    where: str | None = None
    sweep: int | None = None
    title: str | None = None


@dataclass(frozen=True)
class Section:
    """A table of the page, folded unless `shown`."""

    caption: str
    table: Markup
    shown: bool


def write_report(results: Results, request: ReportRequest, file: Path) -> None:
    """Writes the page; LogbookError where the file cannot be written."""
    write_page(render_report(results, request), file)


def render_report(results: Results, request: ReportRequest) -> str:
    """The page as text; raises ConfigurationError where no runs match."""
    where = _where(results, request)
    condition = results.where(where)
    runs = results.runs(condition)
    sweeps = _sweeps(results, runs)
    pictures, trouble = _pictures(results, request, where, runs)
    return render_page(
        "report.html",
        title=request.title or _title(sweeps, request),
        database=str(results.reader.address),
        where=request.where,
        statuses=Counter(run.status for run in runs),
        runs=len(runs),
        varied=_varied(runs),
        sweeps=sweeps,
        settings=_settings(results, runs),
        tables=_tables(results, request, where, runs),
        pictures=pictures,
        trouble=trouble,
        warnings=_warnings(results, condition),
        failures=_failures(results, runs),
        provenance=_provenance(results, condition),
        listed=html_table(_listed(results, runs)),
    )


def _where(results: Results, request: ReportRequest) -> str | None:
    """The condition with the sweep's runs in it: its own, and those it found done already."""
    if request.sweep is None:
        return request.where
    known = [sweep.id for sweep in results.reader.sweeps()]
    if request.sweep not in known:
        expected = f"1 to {max(known)}" if known else "none: there are none"
        raise ConfigurationError(f"--sweep: got {request.sweep}, expected one of {expected}")
    ids = results.of_sweep(request.sweep)
    if not ids:
        raise ConfigurationError(f"--sweep: sweep {request.sweep} has no runs yet")
    within = f"id in ({', '.join(map(str, ids))})"
    return f"({request.where}) and {within}" if request.where else within


def _title(sweeps: Sequence[SweepSummary], request: ReportRequest) -> str:
    if request.sweep is not None and sweeps:
        return f"Sea trials, sweep {request.sweep}"
    return "Sea trials"


def _sweeps(results: Results, runs: Sequence[Run]) -> list[SweepSummary]:
    ids = {run.sweep for run in runs}
    return [sweep for sweep in results.reader.sweeps() if sweep.id in ids]


def _varied(runs: Sequence[Run]) -> list[tuple[str, str]]:
    """Every choice with its levels; many seeds as a range."""
    found = []
    for name in (*GROUPS, "seed"):
        levels = ordered(run.levels[name] for run in runs)
        text = ", ".join(levels)
        if name == "seed" and len(levels) > 5:
            text = f"{len(levels)} seeds, {levels[0]} to {levels[-1]}"
        found.append((name, text))
    return found


def _settings(results: Results, runs: Sequence[Run]) -> Markup:
    """The configuration values that the runs share, and those in which they differ."""
    newest = {tuple(run.levels[name] for name in GROUPS): run.id for run in runs}
    configs = results.configs(sorted(newest.values())[-MOST_LISTED:])
    keys = dict.fromkeys(key for config in configs for key in config if key != "seed")
    rows = []
    for key in keys:
        values = dict.fromkeys(str(config[key]) for config in configs if key in config)
        rows.append([key, one_line(", ".join(values), 200)])
    return html_table(grid_of("", ("key", "value"), rows, labels=2))


def _tables(
    results: Results, request: ReportRequest, where: str | None, runs: Sequence[Run]
) -> list[Section]:
    levels = {run.levels.get(request.rows) for run in runs}
    baseline = (request.rows, "none") if "none" in levels and len(levels) > 1 else None
    known, found = results.metric_names(), []
    apart = ("vessel",) if _several_vessels(runs) and request.rows != "vessel" else ()
    for metric, shown in TABLES.items():
        if metric not in known:
            continue
        wanted = TableRequest(
            names=[metric],
            rows=(*apart, request.rows),
            columns=(request.columns,),
            baseline=baseline,
            where=where,
        )
        grid = comparison(results, wanted)
        if any(cell.sort is not None for row in grid.rows for cell in row):
            found.append(Section(definition_of(metric).caption, html_table(grid), shown))
    return found


def _pictures(
    results: Results, request: ReportRequest, where: str | None, runs: Sequence[Run]
) -> tuple[list[Picture], list[str]]:
    """Every kind of figure that the runs have something for, and why any could not be drawn."""
    from seatrial.runner.compare.plots.request import PlotRequest
    from seatrial.runner.compare.plots.style import drawn

    found: list[Picture] = []
    trouble: list[str] = []
    facet = "vessel" if _several_vessels(runs) else None
    shared = PlotRequest(columns=request.columns, facet=facet, where=where)
    shown = sorted((one for one in figures().values() if one.caption), key=lambda one: one.place)
    with drawn():
        for figure in shown:
            drawings_for = drawings_of(figure.name)
            for caption, variant in _variants(figure, shared, request.rows):
                try:
                    drawings = drawings_for(results, variant)
                except ConfigurationError:
                    continue  # these runs have nothing of this kind
                except LogbookError as error:
                    trouble.append(f"{caption}: {error}")
                    continue
                about = f"{caption}, {variant.dofs[0]}" if _is_dof(variant.dofs) else caption
                for drawing in drawings:
                    found.append(picture(drawing.figure, about, f"f{len(found)}-"))
    return found, trouble


def _variants(
    figure: Figure, shared: "PlotRequest", rows: str
) -> Iterator[tuple[str, "PlotRequest"]]:
    """The figures, with their captions, that one wide or crowded figure is split into."""
    wanted = replace(shared, rows=figure.rows or rows)
    by_dof = [replace(wanted, dofs=(dof,)) for dof in DOF_ORDER]  # narrow, for narrow screens
    match figure.each:
        case "metric and dof":
            for metric in (one for one in METRICS if one.headline):
                yield from ((metric.caption, replace(one, metric=metric.name)) for one in by_dof)
        case "dof":
            yield from ((figure.caption, one) for one in by_dof)
        case "column":
            yield figure.caption, replace(wanted, facet=wanted.columns)
        case _:
            yield figure.caption, wanted


def _several_vessels(runs: Sequence[Run]) -> bool:
    return len({run.levels["vessel"] for run in runs}) > 1


def _is_dof(dofs: Sequence[str]) -> bool:
    return len(dofs) == 1 and dofs[0] not in COMBINED


def _warnings(results: Results, condition: Condition | None) -> list[str]:
    """What the runs warned of, and which did."""
    found = []
    for text, ids in results.warnings(condition)[:MOST_LISTED]:
        runs = ", ".join(map(str, ids[:10])) + (", …" if len(ids) > 10 else "")
        found.append(f"{text} (run{'s'[: len(ids) != 1]} {runs})")
    return found


def _failures(results: Results, runs: Sequence[Run]) -> list[RunDetail]:
    lost = [run.id for run in runs if run.status not in ("finished", "running")]
    return [results.reader.run(run_id) for run_id in lost[:MOST_LISTED]]


def _provenance(results: Results, condition: Condition | None) -> list[tuple[str, list[str]]]:
    """Where the results come from: each property with its distinct values."""
    found: dict[str, Counter[str]] = {}
    for row in results.provenance(condition):
        dirty = " with uncommitted changes" if row.git_dirty else ""
        facts = {"git commit": f"{row.git_commit or 'unknown'}{dirty}", "host": row.host}
        facts |= {str(name): str(version) for name, version in row.versions.items()}
        facts |= {"command": without_passwords(row.command)} if row.command else {}
        for name, value in facts.items():
            found.setdefault(name, Counter())[value] += 1
    return [
        (name, [value for value, _ in counts.most_common(20)]) for name, counts in found.items()
    ]


def _listed(results: Results, runs: Sequence[Run]) -> Grid:
    chosen = [run.id for run in runs][-MOST_LISTED:]
    found = results.reader.runs(RunTable.id.in_(chosen), newest_first=True)
    names = [name for name in RUN_COLUMNS if name not in ("superseded", "error")]
    rows = [[plain(getattr(run, name)) for name in names] for run in found]
    notes = [f"the newest {MOST_LISTED} of {len(runs)}"] if len(runs) > MOST_LISTED else []
    return grid_of("", names, rows, labels=1, notes=notes)
