"""One self-contained page about a set of runs: tables, figures, failures, provenance."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.factors import CHOICES
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.grid import Grid, grid_of, one_line
from seatrial.runner.compare.page import Picture, picture, render_page, write_page
from seatrial.runner.compare.pivot import DOF_ORDER
from seatrial.runner.compare.results import Results, Run, ordered
from seatrial.runner.compare.runs import RUN_COLUMNS, plain
from seatrial.runner.compare.selection import TableRequest
from seatrial.runner.compare.table import comparison
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.mask import without_passwords
from seatrial.runner.database.records import RunDetail, SweepSummary
from seatrial.runner.database.tables import Run as RunTable

if TYPE_CHECKING:
    from seatrial.runner.compare.plots.request import PlotRequest


# Metric, what it says, and whether its table is open when the page opens.
TABLES = (
    ("force_mse", "Force residual on the held-out part", True),
    ("force_mse_filtered", "Force residual, thruster lag taken into account", False),
    ("velocity_rmse_free_run", "Velocity error of a free run over the held-out part", True),
    ("velocity_rmse_one_step", "Velocity error one step ahead, which hides bias", False),
    ("coefficient_error", "Largest relative error of a coefficient", False),
    ("e_pos_mae", "Position error when deployed", True),
    ("e_psi_mae", "Heading error when deployed", True),
    ("error_mae", "Pose error by axis when deployed", False),
    ("steady_state_error", "Steady-state error when deployed", False),
    ("tau_mean_abs", "Mean absolute force when deployed", False),
    ("power_mean", "Mean power when deployed", False),
    ("iaew", "Integral of absolute error times work", False),
)
# Kind of figure, its options, and its caption.
FIGURES: tuple[tuple[str, Mapping[str, Any], str], ...] = (
    ("bars", {"metric": "force_mse"}, "Force residual on the held-out part"),
    ("bars", {"metric": "e_pos_mae"}, "Position error when deployed"),
    ("bars", {"metric": "e_psi_mae"}, "Heading error when deployed"),
    ("orders", {}, "Error over model order"),
    ("surface", {}, "Error over order and variables"),
    ("pareto", {}, "Pareto set"),
    ("spectrum", {}, "Singular values and eigenvalues"),
    ("coefficients", {}, "Identified against true coefficients"),
    ("track", {}, "Track of the newest deployed run"),
    ("plan", {}, "Planned path of the newest mix"),
    ("errors", {}, "Tracking error of the newest deployed run"),
    ("response", {}, "Response of the newest deployed run"),
    ("controllers", {"rows": "controller"}, "Controllers on one mission"),
    ("residual", {}, "Force residual of the newest run"),
    ("excitation", {}, "Forces of the newest run and their spectrum"),
    ("wind", {}, "Wind of the newest run that met some"),
    ("quality", {}, "Velocity against position of the newest measured recording"),
)
PER_DOF = ("bars", "orders", "response", "controllers")  # a narrow figure each, for narrow screens
PER_COLUMN = ("coefficients",)  # one figure a level of the columns, or it is crowded
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
    for name in (*CHOICES, "seed"):
        levels = ordered(run.levels[name] for run in runs)
        text = ", ".join(levels)
        if name == "seed" and len(levels) > 5:
            text = f"{len(levels)} seeds, {levels[0]} to {levels[-1]}"
        found.append((name, text))
    return found


def _settings(results: Results, runs: Sequence[Run]) -> Markup:
    """The configuration values that the runs share, and those in which they differ."""
    newest = {tuple(run.levels[name] for name in CHOICES): run.id for run in runs}
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
    for metric, caption, shown in TABLES:
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
            found.append(Section(caption, html_table(grid), shown))
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
    with drawn():
        for kind, options, caption in FIGURES:
            module = import_module(f"{__package__}.plots.{kind}")
            shared = {"rows": request.rows, "columns": request.columns, "facet": facet}
            wanted = PlotRequest(**(shared | {"where": where} | dict(options)))
            for variant in _variants(kind, wanted):
                try:
                    drawings = module.drawings(results, variant)
                except ConfigurationError:
                    continue  # these runs have nothing of this kind
                except LogbookError as error:
                    trouble.append(f"{caption}: {error}")
                    continue
                about = f"{caption}, {variant.dofs[0]}" if _is_dof(variant.dofs) else caption
                for drawing in drawings:
                    found.append(picture(drawing.figure, about, f"f{len(found)}-"))
    return found, trouble


def _variants(kind: str, wanted: "PlotRequest") -> list["PlotRequest"]:
    """The figures that one wide or crowded figure is split into."""
    if kind in PER_DOF:
        return [replace(wanted, dofs=(dof,)) for dof in DOF_ORDER]
    if kind in PER_COLUMN:
        return [replace(wanted, facet=wanted.columns)]
    return [wanted]


def _several_vessels(runs: Sequence[Run]) -> bool:
    return len({run.levels["vessel"] for run in runs}) > 1


def _is_dof(dofs: Sequence[str]) -> bool:
    return len(dofs) == 1 and dofs[0] not in ("position", "heading", "all")


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
