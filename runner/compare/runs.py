"""Lists of runs, the details of one run, and the command that repeats it."""

import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from decimal import Decimal
from pathlib import Path

import sqlalchemy as sa

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.frame import RUN, Queries, flat
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, one_line, unit_text
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.engine import Address, file_url
from seatrial.runner.database.records import RunDetail, RunSummary
from seatrial.runner.database.terminal import error_line
from seatrial.runner.database.views import run_overview
from seatrial.runner.invocation import trial_program
from seatrial.runner.vocabulary import GROUPS, STATUSES

RUN_COLUMNS = (
    "run_id",
    "status",
    *GROUPS,
    "seed",
    "sweep",
    "tags",
    "attempt",
    "superseded",
    "started_at",
    "duration_s",
    "below_true_model",
    "error",
)
SUMMARY = (
    *("status", "error_type", "error", *GROUPS, "seed", "attempt", "superseded", "sweep"),
    *("started_at", "finished_at", "duration_s"),
)
METRIC_COLUMNS = ("stage", "name", "dof", "model", "value", "unit")
COEFFICIENT_COLUMNS = ("model", "dof", "term", "value", "std_error", "true_value", "unit")
DIAGNOSTIC_COLUMNS = ("name", "dof", "value", "unit", "label")
UNCERTAINTY = ("model_error", "no_model_error", "no_band", "tracking_", "no_tracking")
SERIES_COLUMNS = ("kind", "path", "n_rows", "sha256")
EXCITATION = ("regressor_unknowns", "regressor_rank", "regressor_condition", "spectral_lines")
INSEPARABLE = "inseparable_terms"
DATABASE = re.compile(r"[+~]*database(\.url)?=")
SHOWN_BYTES = 16
NEWEST = 50  # runs that a shell is offered


def run_list(
    results: Queries,
    where: str | None,
    status: str | None,
    limit: int,
    sweep: str | None = None,
    tag: str | None = None,
) -> TextTable:
    """List the newest runs that meet the condition, newest first, with every attempt.

    `where` is the text of --where; with `status` only runs of this status, with `sweep` (a number,
    a name or `all`) and `tag` only runs of these sweeps, and at most `limit`. Raises
    ConfigurationError for a wrong condition, status, sweep or tag, and if no run matches.
    """
    condition, _ = results.selected(where, sweep or "all", tag)
    summaries = runs_of(results, condition, [status] if status else [], limit)[:limit]
    if not summaries:
        raise ConfigurationError(results.why_none(condition, status))
    return _runs_grid(run_rows(results, summaries, RUN_COLUMNS), limit)


def numbers(results: Queries, beginning: str) -> list[tuple[str, str]]:
    """Return the newest runs whose numbers have this beginning, with their choices, for a shell."""
    matching = sa.cast(RUN.c.id, sa.Text).startswith(beginning, autoescape=True)
    newest = results.reader.runs(matching, newest_first=True, limit=NEWEST)
    return [(str(run.run_id), error_line(_described(run))) for run in newest]


def _described(run: RunSummary) -> str:
    return f"{run.status}, {run.vessel} {run.disturbance} {run.identifier} seed={run.seed}"


def run_rows(
    results: Queries, summaries: Sequence[RunSummary], names: Sequence[str]
) -> list[list[Scalar]]:
    """Return one row for each run with the named columns, some of RUN_COLUMNS."""
    tags: dict[int | None, str | None] = {
        sweep.id: ", ".join(sweep.tags or ()) or None for sweep in results.reader.sweeps()
    }
    return [
        [tags.get(run.sweep_id) if n == "tags" else plain(getattr(run, n)) for n in names]
        for run in summaries
    ]


def runs_of(
    results: Queries, condition: Condition, statuses: Sequence[str], limit: int | None = None
) -> list[RunSummary]:
    """Return runs that meet the condition and have one of the statuses, newest first.

    Empty `statuses` mean any status. The result may have more than `limit` runs. Raises
    ConfigurationError for a wrong condition or status.
    """
    for status in statuses:
        if status not in STATUSES:
            expected = ", ".join(STATUSES)
            raise ConfigurationError(f"--status: got {status!r}, expected one of {expected}")
    conditions = results.names.clauses(condition)
    if statuses:  # the view may still show an interrupted run as running
        candidates = [*statuses, *(["running"] if "interrupted" in statuses else [])]
        conditions.append(run_overview.c.status.in_(candidates))
    limited = not {"running", "interrupted"} & set(statuses)
    summaries = results.reader.runs(
        *conditions, newest_first=True, limit=limit if limited else None
    )
    return [run for run in summaries if not statuses or run.status in statuses]


def _runs_grid(rows: Sequence[Sequence[Scalar]], limit: int) -> TextTable:
    """Return the list; the table shows only informative columns, the records hold all."""
    all_columns = grid_of("runs", RUN_COLUMNS, rows)
    informative = [
        i for i, name in enumerate(RUN_COLUMNS) if _is_informative(name, [row[i] for row in rows])
    ]
    headers = ["id" if RUN_COLUMNS[i] == "run_id" else RUN_COLUMNS[i] for i in informative]
    cells = [[_brief(RUN_COLUMNS[i], row[i]) for i in informative] for row in rows]
    brief = grid_of("", headers, cells, labels=len(headers))
    notes = [f"the newest {limit}; --limit shows more"] if len(rows) == limit else []
    return TextTable("", brief.headers, brief.rows, len(headers), notes, all_columns.as_records())


def _is_informative(name: str, values: Sequence[Scalar]) -> bool:
    if name in ("attempt", "superseded"):
        return any(value not in (1, 0, False) for value in values) or any(
            value and name == "superseded" for value in values
        )
    unnamed = ("sweep",) if name == "sweep" else ()  # the name of a sweep without one
    return any(value not in (None, 0.0, "", *unnamed) for value in values)


def _brief(name: str, value: Scalar) -> Scalar:
    match name:
        case "started_at":
            return str(value)[:16].replace("T", " ")
        case "duration_s":
            return None if value is None else f"{value:.1f}"
        case "error":
            return one_line(str(value or ""), 60)
        case "sweep" | "tags":
            return one_line(str(value or ""), 40)
        case "below_true_model":
            return "yes" if value else ""
        case "superseded":
            return "yes" if value else ""
        case _:
            return value


def run_details(results: Queries, run_id: int) -> list[TextTable]:
    """Return status, provenance, configuration, metrics, coefficients and series of a run.

    Raises LogbookError for an unknown run.
    """
    reader = results.reader
    run = reader.run(run_id)
    configuration = [[key, _config_text(value)] for key, value in flat(run.config).items()]
    properties = _properties(run)
    after = next((i for i, (name, _) in enumerate(properties) if name == "sweep"), 0) + 1
    properties[after:after] = _labels(results, run.summary.sweep_id)
    position = next(i for i, (name, _) in enumerate(properties) if name == "vessel")
    warnings = results.warnings(Condition(run=run_id))
    properties[position:position] = [["warning", text] for text, _ in warnings]
    grids = [
        grid_of(f"run {run_id}", ("property", "value"), properties, labels=2),
        grid_of("configuration", ("key", "value"), configuration, labels=2),
        _row_grid("metrics", METRIC_COLUMNS, reader.metrics(run_id), 4),
        _row_grid("coefficients", COEFFICIENT_COLUMNS, reader.coefficients(run_id), 3),
        _row_grid("uncertainty", DIAGNOSTIC_COLUMNS, _uncertainty(reader.diagnostics(run_id)), 2),
        _excitation(results, run_id),
        _row_grid("series", SERIES_COLUMNS, reader.series_files(run_id), 2),
    ]
    return [grid for grid in grids if grid.rows]


def _uncertainty(rows: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Return the numbers of the model error, or why there is none, and the intervals of errors."""
    return [row for row in rows if row.name.startswith(UNCERTAINTY)]


def _excitation(results: Queries, run_id: int) -> TextTable:
    """Return which terms the recording can separate, one row for each degree of freedom."""
    names = (*EXCITATION, INSEPARABLE)
    diagnostics = [row for row in results.reader.diagnostics(run_id) if row.name in names]
    rows: list[list[Scalar]] = []
    for dof in dict.fromkeys(row.dof for row in diagnostics):
        numbers = {row.name: row.value for row in diagnostics if row.dof == dof}
        groups = [row.label for row in diagnostics if row.dof == dof and row.name == INSEPARABLE]
        inseparable = "; ".join(" ~ ".join((group or "").split()) for group in groups)
        values = [numbers.get(name) for name in EXCITATION]
        cells = [int(n) if n is not None and n == int(n) else n for n in values]
        rows.append([dof, *cells, inseparable])
    headers = ("dof", "unknowns", "rank", "condition", "spectral lines", "not told apart")
    return grid_of("excitation", headers, rows, labels=1)


def _row_grid(
    title: str, names: Sequence[str], records: Sequence[object], labels: int
) -> TextTable:
    rows = [[plain(getattr(record, name)) for name in names] for record in records]
    shown = [
        [
            unit_text(str(value)) if name == "unit" else value
            for name, value in zip(names, row, strict=True)
        ]
        for row in rows
    ]
    plain_grid = grid_of(title, names, rows, labels)
    return replace(grid_of(title, names, shown, labels), records=plain_grid.records)


def _properties(run: RunDetail) -> list[list[Scalar]]:
    properties: list[list[Scalar]] = [[n, _property(getattr(run.summary, n))] for n in SUMMARY]
    properties[3:3] = [["note", run.note]]
    dirty = " with uncommitted changes" if run.git_dirty else ""
    versions: list[list[Scalar]] = [[f"version of {n}", str(v)] for n, v in run.versions.items()]
    properties += [
        ["heartbeat_at", _property(run.heartbeat_at)],
        ["host", run.host],
        ["pid", run.pid],
        ["git_commit", f"{run.git_commit}{dirty}" if run.git_commit else None],
        ["fingerprint", run.summary.fingerprint],
        ["overrides", shlex.join(run.overrides)],
        ["started by", run.command],
    ]
    properties += versions
    return [pair for pair in properties if pair[1] not in (None, "")]


def _property(value: object) -> Scalar:
    """Return a value for display: dates to the second, `yes` for true, None for false."""
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M:%S} UTC"
    return None if value is False else "yes" if value is True else plain(value)


def _labels(results: Queries, sweep_id: int | None) -> list[list[Scalar]]:
    """Return tags and note of the sweep of a run, if it has them."""
    labels: list[list[Scalar]] = []
    for sweep in results.reader.sweeps():
        if sweep.id == sweep_id:
            labels += [["tags of the sweep", ", ".join(sweep.tags)]] if sweep.tags else []
            labels += [["note on the sweep", sweep.note]] if sweep.note else []
    return labels


def _config_text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def traceback_of(results: Queries, run_id: int) -> str:
    """The traceback of a failed run, or a line that says why there is none."""
    run = results.reader.run(run_id)
    return (run.traceback or f"run {run_id} is {run.summary.status}: no traceback").rstrip()


def command_of(results: Queries, run_id: int) -> str:
    """Return the shell command, on one line, that repeats a run into the same logbook."""
    overrides = results.reader.run(run_id).overrides
    return repeat_command(overrides, results.reader.address, rerun=True)


def answer(results: Queries, query: str, timeout_s: float, limit: int) -> tuple[TextTable, bool]:
    """Return the first rows of one SQL query, and whether there are more."""
    result = results.reader.sql(query, timeout_s, limit)
    rows = [[plain(value) for value in row] for row in result.rows]
    return grid_of("", result.columns, rows, labels=0, digits=6), result.more


def repeat_command(overrides: Sequence[str], address: Address, rerun: bool) -> str:
    """Return the shell command, on one line, that repeats a trial into the same logbook.

    The address of a PostgreSQL logbook that holds a password is in SEATRIAL_DATABASE.
    """
    words = [
        word for word in overrides if not DATABASE.match(word) and not word.startswith("rerun=")
    ]
    if address.path is not None:
        words = [word for word in words if not word.startswith("results_dir=")]
        words += _location(address.path)
    elif address.url.password:
        words.append("database=postgresql")
    else:
        words.append(f"database.url={_quoted(str(address))}")
    if any(word.startswith("experiment=") for word in words):
        words.append("hydra.mode=RUN")  # an experiment may define a sweep
    if rerun:
        words.append("rerun=true")
    return f"{trial_program()} {shlex.join(words)}".rstrip()


def _location(database: Path) -> list[str]:
    """Return the overrides that select a SQLite file; empty for the default file."""
    here, file = Path.cwd(), database.resolve()
    folder = file.parent.relative_to(here) if file.parent.is_relative_to(here) else file.parent
    overrides = [] if folder == Path("results") else [f"results_dir={_quoted(str(folder))}"]
    if file.name != "results.db":
        overrides.append(f"database.url={_quoted(file_url(folder / file.name))}")
    return overrides


def _quoted(text: str) -> str:
    """Return a value as Hydra parses it: quoted if it has special characters."""
    if all(letter.isalnum() or letter in "/._-:" for letter in text):
        return text
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def plain(value: object) -> Scalar:
    """Return a value of the database as a cell value.

    Dates are ISO text, JSON is JSON text, and bytes are marked, with the first of them.
    """
    if isinstance(value, datetime):
        return value.isoformat()
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if isinstance(value, Decimal):
        return int(value) if abs(value) < 2**63 and value == int(value) else float(value)
    if isinstance(value, bytes):
        return f"({len(value)} bytes) {value[:SHOWN_BYTES].hex()}" + (
            "…" if len(value) > SHOWN_BYTES else ""
        )
    return json.dumps(value, ensure_ascii=False, default=str)


HEADERS = ("column", "N", "mean", "std", "median", "min", "max")
NAMES = ("count", "mean", "std", "median", "minimum", "maximum")


def recording_statistics(results: Queries, run_id: int, digits: int) -> TextTable:
    """Return N, mean, standard deviation, median, minimum and maximum of every recorded column.

    Raises LogbookError for a run without statistics; only measured files have them.
    """
    reader = results.reader
    reader.run(run_id)
    stored = {
        (row.i, row.label, row.name.removeprefix("statistic_")): row.value
        for row in reader.diagnostics(run_id)
        if row.name.startswith("statistic_")
    }
    columns = sorted({(i or 0, label or "") for i, label, _ in stored})
    if not columns:
        raise LogbookError(
            f"run {run_id} has no statistics; expected a run of a measured file "
            "(excitation=recording)"
        )
    rows: list[list[Scalar]] = [
        [label, *(stored.get((i, label, name)) for name in NAMES)] for i, label in columns
    ]
    return grid_of(f"recording of run {run_id}, as measured", HEADERS, rows, 1, digits=digits)
