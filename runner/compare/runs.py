"""The statistics of a measured recording that a run stored of its file."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.factors import flat
from seatrial.runner.compare.grid import Grid, Scalar, grid_of, one_line, unit_text
from seatrial.runner.compare.results import Results
from seatrial.runner.compare.where import Comparison
from seatrial.runner.database.engine import file_url
from seatrial.runner.database.mask import without_address
from seatrial.runner.database.records import RunDetail, RunSummary
from seatrial.runner.database.views import run_overview
from seatrial.runner.invocation import trial_program
from seatrial.runner.vocabulary import GROUPS, STATUSES

# Lists of runs, and all that is known of one run.


RUN_COLUMNS = (
    "run_id",
    "status",
    *GROUPS,
    "seed",
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
SERIES_COLUMNS = ("kind", "path", "n_rows", "sha256")
EXCITATION = ("regressor_unknowns", "regressor_rank", "regressor_condition", "spectral_lines")
INSEPARABLE = "inseparable_terms"
PLACES = ("results_dir=", "database=")


def run_list(results: Results, where: str | None, status: str | None, limit: int) -> Grid:
    """The newest runs that meet the condition, newest first; every attempt is listed."""
    found = runs_of(results, where, [status] if status else [], limit)[:limit]
    if not found:
        raise ConfigurationError(results.why_none(where, status))
    return _runs_grid([[plain(getattr(run, n)) for n in RUN_COLUMNS] for run in found], limit)


def runs_of(
    results: Results, where: str | None, statuses: Sequence[str], limit: int | None = None
) -> list[RunSummary]:
    """Runs that meet the condition and have one of the statuses (any where empty), newest first.

    At least `limit` of them, where there are so many.
    """
    for status in statuses:
        if status not in STATUSES:
            expected = ", ".join(STATUSES)
            raise ConfigurationError(f"--status: got {status!r}, expected one of {expected}")
    condition = results.where(where)
    conditions = [] if condition is None else [results.names.clause(condition)]
    if statuses:  # a run whose process is gone is known to be interrupted before the view says so
        shown = [*statuses, *(["running"] if "interrupted" in statuses else [])]
        conditions.append(run_overview.c.status.in_(shown))
    certain = not {"running", "interrupted"} & set(statuses)
    found = results.reader.runs(*conditions, newest_first=True, limit=limit if certain else None)
    return [run for run in found if not statuses or run.status in statuses]


def _runs_grid(rows: Sequence[Sequence[Scalar]], limit: int) -> Grid:
    """The list: facts in full for machines, for eyes only the columns that tell runs apart."""
    full = grid_of("runs", RUN_COLUMNS, rows)
    said = [i for i, name in enumerate(RUN_COLUMNS) if _tells(name, [row[i] for row in rows])]
    headers = ["id" if RUN_COLUMNS[i] == "run_id" else RUN_COLUMNS[i] for i in said]
    cells = [[_brief(RUN_COLUMNS[i], row[i]) for i in said] for row in rows]
    brief = grid_of("", headers, cells, labels=len(headers))
    notes = [f"the newest {limit}; --limit shows more"] if len(rows) == limit else []
    return Grid("", brief.headers, brief.rows, len(headers), notes, full.as_records())


def _tells(name: str, values: Sequence[Scalar]) -> bool:
    if name in ("attempt", "superseded"):
        return any(value not in (1, 0, False) for value in values) or any(
            value and name == "superseded" for value in values
        )
    return any(value not in (None, 0.0, "") for value in values)


def _brief(name: str, value: Scalar) -> Scalar:
    match name:
        case "started_at":
            return str(value)[:16].replace("T", " ")
        case "duration_s":
            return None if value is None else f"{value:.1f}"
        case "error":
            return one_line(str(value or ""), 60)
        case "below_true_model":
            return "yes" if value else ""
        case "superseded":
            return "yes" if value else ""
        case _:
            return value


def run_details(results: Results, run_id: int) -> list[Grid]:
    """One run whole: status and provenance, configuration, metrics, coefficients, series."""
    reader = results.reader
    run = reader.run(run_id)
    configuration = [[key, _config_text(value)] for key, value in flat(run.config).items()]
    properties = _properties(run)
    at = next(i for i, (name, _) in enumerate(properties) if name == "vessel")
    warned = results.warnings(Comparison("id", "=", run_id))
    properties[at:at] = [["warning", text] for text, _ in warned]
    grids = [
        grid_of(f"run {run_id}", ("property", "value"), properties, labels=2),
        grid_of("configuration", ("key", "value"), configuration, labels=2),
        _facts("metrics", METRIC_COLUMNS, reader.metrics(run_id), 4),
        _facts("coefficients", COEFFICIENT_COLUMNS, reader.coefficients(run_id), 3),
        _excitation(results, run_id),
        _facts("series", SERIES_COLUMNS, reader.series_files(run_id), 2),
    ]
    return [grid for grid in grids if grid.rows]


def _excitation(results: Results, run_id: int) -> Grid:
    """What the recording can tell apart, a row a degree of freedom."""
    runs = results.runs(Comparison("id", "=", run_id), superseded=True)
    found = results.diagnostics(runs, (*EXCITATION, INSEPARABLE))[run_id]
    rows: list[list[Scalar]] = []
    for dof in dict.fromkeys(one.dof for one in found):
        numbers = {one.name: one.value for one in found if one.dof == dof}
        groups = [one.label for one in found if one.dof == dof and one.name == INSEPARABLE]
        told = "; ".join(" ~ ".join(group.split()) for group in groups)
        known = [numbers.get(name) for name in EXCITATION]
        whole = [int(n) if n is not None and n == int(n) else n for n in known]
        rows.append([dof, *whole, told])
    headers = ("dof", "unknowns", "rank", "condition", "spectral lines", "not told apart")
    return grid_of("excitation", headers, rows, labels=1)


def _facts(title: str, names: Sequence[str], facts: Sequence[object], labels: int) -> Grid:
    rows = [[plain(getattr(fact, name)) for name in names] for fact in facts]
    shown = [
        [
            unit_text(str(value)) if name == "unit" else value
            for name, value in zip(names, row, strict=True)
        ]
        for row in rows
    ]
    full = grid_of(title, names, rows, labels)
    return replace(grid_of(title, names, shown, labels), records=full.records)


def _properties(run: RunDetail) -> list[list[Scalar]]:
    found: list[list[Scalar]] = [[n, _property(getattr(run.summary, n))] for n in SUMMARY]
    found[3:3] = [["note", run.note]]
    dirty = " with uncommitted changes" if run.git_dirty else ""
    versions: list[list[Scalar]] = [[f"version of {n}", str(v)] for n, v in run.versions.items()]
    found += [
        ["heartbeat_at", _property(run.heartbeat_at)],
        ["host", run.host],
        ["pid", run.pid],
        ["git_commit", f"{run.git_commit}{dirty}" if run.git_commit else None],
        ["fingerprint", run.summary.fingerprint],
        ["overrides", shlex.join(run.overrides)],
        ["started by", run.command],
    ]
    found += versions
    return [pair for pair in found if pair[1] not in (None, "")]


def _property(value: Any) -> Scalar:
    """A value as a person reads it: dates to the second, nothing for no."""
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M:%S} UTC"
    return None if value is False else "yes" if value is True else plain(value)


def _config_text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def traceback_of(results: Results, run_id: int) -> str:
    """The traceback of a failed run, or a line that says why there is none."""
    run = results.reader.run(run_id)
    return (run.traceback or f"run {run_id} is {run.summary.status}: no traceback").rstrip()


def command_of(results: Results, run_id: int) -> str:
    """One line for a shell that repeats a run into the same logbook."""
    overrides = results.reader.run(run_id).overrides
    return repeat_command(overrides, results.reader.address.path, rerun=True)


def answer(results: Results, query: str) -> Grid:
    """The answer to one query in SQL."""
    found = results.reader.sql(query)
    rows = [[plain(value) for value in row] for row in found.rows]
    return grid_of("", found.columns, rows, labels=0, digits=6)


def repeat_command(overrides: Sequence[str], database: Path | None, rerun: bool) -> str:
    """One line for a shell that repeats a trial, its results going to the same logbook.

    `database` is the SQLite file; with None (PostgreSQL) the command takes the address from
    SEATRIAL_DATABASE, because a URL with its password does not belong on a command line.
    """
    kept = without_address(overrides)
    if database is not None:
        kept = [one for one in kept if not one.startswith(PLACES)]
        kept += _location(database)
    elif "database=postgresql" not in kept:
        kept.append("database=postgresql")
    kept = [one for one in kept if not one.startswith("rerun=")]
    if any(one.startswith("experiment=") for one in kept):
        kept.append("hydra.mode=RUN")  # an experiment may hold a sweep
    if rerun:
        kept.append("rerun=true")
    return f"{trial_program()} {shlex.join(kept)}".rstrip()


def _location(database: Path) -> list[str]:
    """Overrides that lead to a SQLite file; none for the default place."""
    here, file = Path.cwd(), database.resolve()
    folder = file.parent.relative_to(here) if file.parent.is_relative_to(here) else file.parent
    found = [] if folder == Path("results") else [f"results_dir={_quoted(str(folder))}"]
    if file.name != "results.db":
        found.append(f"database.url={_quoted(file_url(folder / file.name))}")
    return found


def _quoted(text: str) -> str:
    """A value as Hydra reads it back: quoted where it has more than plain letters."""
    if all(letter.isalnum() or letter in "/._-:" for letter in text):
        return text
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def plain(value: Any) -> Scalar:
    """A value of the database as a cell holds it: dates as ISO text, JSON as JSON."""
    if isinstance(value, datetime):
        return value.isoformat()
    if value is None or isinstance(value, str | int | float | bool):
        return value
    return json.dumps(value, ensure_ascii=False)


HEADERS = ("column", "N", "mean", "std", "median", "min", "max")
NAMES = ("count", "mean", "std", "median", "minimum", "maximum")


def recording_statistics(results: Results, run_id: int, digits: int) -> Grid:
    """N, mean, standard deviation, median, minimum and maximum of every column, as recorded.

    Raises LogbookError for a run that has none: only measured files are described.
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
