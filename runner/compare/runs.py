"""Lists of runs, the details of one run, and the command that repeats it."""

import json
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import Queries, flat
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, one_line, unit_text
from seatrial.runner.compare.where import Condition
from seatrial.runner.configuration.invocation import config_folder, quoted, trial_program
from seatrial.runner.database.engine import Address, file_url
from seatrial.runner.database.records import RunSummary
from seatrial.runner.database.views import run_overview
from seatrial.runner.record.catalogue import definition_of, headlines
from seatrial.runner.record.vocabulary import GROUPS, NOT_STARTED, SAILED, STATUSES

RUN_COLUMNS = (
    *("run_id", "status", *GROUPS, "seed", "sweep", "tags", "attempt", "superseded"),
    *("started_at", "duration_s", "below_true_model", "error"),
)
USUAL: dict[str, tuple[Scalar, ...]] = {  # of a column: what is not worth showing
    "attempt": (1, None), "superseded": (False, None), "sweep": ("sweep", None),
}  # fmt: skip
BRIEF: dict[str, Callable[[Any], str]] = {  # of a column: what a list shows of a value
    "started_at": lambda time: str(time)[:16].replace("T", " "), "duration_s": "{:.1f}".format,
    **dict.fromkeys(("below_true_model", "superseded"), lambda is_so: "yes" if is_so else ""),
    **dict.fromkeys(("error", "sweep", "tags"), lambda text: one_line(text, 60)),
}  # fmt: skip
SUMMARY = (
    *("status", "error_type", "error", *GROUPS, "seed", "attempt", "superseded", "sweep"),
    *("started_at", "finished_at", "duration_s"),
)
TABLES = {  # of what a run has stored: their columns
    "metrics": ("stage", "name", "dof", "model", "value", "unit"),
    "coefficients": ("model", "dof", "term", "value", "std_error", "true_value", "unit"),
    "diagnostics": ("name", "dof", "value", "unit", "label"),
    "series": ("kind", "path", "n_rows", "sha256"),
}  # fmt: skip
SHOWN = (  # diagnostics: uncertainty, what the excitation tells apart, columns of a recording
    *("model_error", "no_model_error", "no_band", "tracking_", "no_tracking"),
    *("regressor_", "spectral_lines", "inseparable_terms", "statistic_"),
)
DATABASE = re.compile(r"[+~]*database(\.url)?=")


def run_table(
    results: Queries, runs: Sequence[RunSummary], title: str = "", notes: Sequence[str] = (),
    without: Sequence[str] = (),
) -> TextTable:  # fmt: skip
    """Return runs as a table of the informative columns; its records hold all RUN_COLUMNS.

    Columns that are named in `without`, or hold what is usual, are not shown.
    """
    tags = {sweep.id: ", ".join(sweep.tags or ()) for sweep in results.reader.sweeps()}
    records = [{name: plain(getattr(run, name, None)) for name in RUN_COLUMNS} for run in runs]
    for record, run in zip(records, runs, strict=True):
        record["tags"] = tags.get(run.sweep_id or 0) or None
    shown = list[str]()
    for name in (name for name in RUN_COLUMNS if name not in without):
        if any(record[name] not in USUAL.get(name, (None, 0.0, "")) for record in records):
            shown.append(name)
    known = ([(name, record[name]) for name in shown] for record in records)
    cells = [[v if v is None else BRIEF.get(n, plain)(v) for n, v in pairs] for pairs in known]
    headers = ["id" if name == "run_id" else name for name in shown]
    return replace(grid_of(title, headers, cells, len(headers), notes), records=records)


def runs_of(
    results: Queries, condition: Condition, statuses: Sequence[str], limit: int | None = None,
    known: Sequence[str] = STATUSES,
) -> list[RunSummary]:  # fmt: skip
    """Return runs that meet the condition and have one of the statuses, newest first.

    Empty `statuses` mean any status. The result may have more than `limit` runs. Raises
    ConfigurationError for a wrong condition or status.
    """
    if wrong := [status for status in statuses if status not in known]:
        raise ConfigurationError(f"--status: got {wrong[0]!r}, expected one of {', '.join(known)}")
    conditions = results.clauses(condition, own_attempts=True)
    if statuses:  # the view may still show an interrupted run as running
        conditions.append(run_overview.c.status.in_([*statuses, "running"]))
    most = None if statuses else limit
    summaries = results.reader.runs(*conditions, newest_first=True, limit=most)
    return [run for run in summaries if not statuses or run.status in statuses]


def not_started(results: Queries, condition: Condition) -> TextTable:
    """Return the trials that a sweep planned and no run is of, as a table."""
    trials = results.trials(condition, planned=True)
    names = ["of_sweep", *GROUPS, "seed"]
    chosen = trials.loc[trials["status"] == NOT_STARTED, names].astype(str).sort_values(names)
    if chosen.empty:
        raise ConfigurationError(results.why_none(condition, NOT_STARTED))
    rows: list[list[Scalar]] = [[*row] for row in chosen.itertuples(index=False)]
    return grid_of("", ["sweep", *names[1:]], rows, len(names))


def headline(results: Queries, run_id: int) -> TextTable:
    """Return the main metrics of a run, nominal beside identified, with its warnings as notes."""
    summary = results.reader.run(run_id).summary
    rows: list[list[Scalar]] = []
    for pair in headlines(results.reader.metrics(run_id)):
        one = next(row for row in pair if row)
        values = [row.value if row else None for row in pair]
        rows.append([definition_of(one.name).label, one.dof, unit_text(one.unit), *values])
    choices = ", ".join(getattr(summary, group) for group in GROUPS)
    title = f"run {run_id}, {summary.status}: {choices}, seed {summary.seed}"
    notes = [summary.error] if summary.error else []
    notes += [text for text, _ in results.warnings(Condition(runs=(run_id,)))]
    return grid_of(title, ("metric", "dof", "unit", *SAILED), rows, 3, notes)


def run_details(results: Queries, run_id: int) -> list[TextTable]:
    """Return all that is stored of a run: metrics, coefficients, configuration, provenance, ...

    Raises LogbookError for an unknown run.
    """
    reader = results.reader
    run, diagnostics = reader.run(run_id), reader.diagnostics(run_id)
    configuration: list[list[Scalar]] = [
        [key, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)]
        for key, value in flat(run.config).items()
    ]
    grids = [
        _stored("metrics", reader.metrics(run_id), 4),
        _stored("coefficients", reader.coefficients(run_id), 3),
        _stored("diagnostics", [row for row in diagnostics if row.name.startswith(SHOWN)], 2),
        grid_of("configuration", ("key", "value"), configuration, labels=2),
        grid_of(f"run {run_id}", ("property", "value"), _properties(results, run_id), labels=2),
        _stored("series", reader.series_files(run_id), 2),
    ]
    return [grid for grid in grids if grid.rows]


def _stored(title: str, records: Sequence[object], labels: int) -> TextTable:
    rows = [{name: plain(getattr(one, name)) for name in TABLES[title]} for one in records]
    units = [{"unit": unit_text(str(row["unit"]))} if "unit" in row else {} for row in rows]
    shown = [[*(row | unit).values()] for row, unit in zip(rows, units, strict=True)]
    return replace(grid_of(title, TABLES[title], shown, labels), records=rows)


def _properties(results: Queries, run_id: int) -> list[list[Scalar]]:
    """Return status, labels and origin of a run, without what is empty."""
    run = results.reader.run(run_id)
    sweep = next((s for s in results.reader.sweeps() if s.id == run.summary.sweep_id), None)
    dirty = " with uncommitted changes" if run.git_dirty else ""
    properties: list[tuple[str, object]] = [
        *((name, getattr(run.summary, name)) for name in SUMMARY),
        ("tags of the sweep", ", ".join(sweep.tags or ()) if sweep else None),
        ("note on the sweep", sweep.note if sweep else None),
        ("note", run.note),
        ("host", run.host),
        ("git_commit", f"{run.git_commit}{dirty}" if run.git_commit else None),
        ("fingerprint", run.summary.fingerprint),
        ("overrides", shlex.join(run.overrides)),
        ("started by", run.command),
        *((f"version of {name}", str(version)) for name, version in run.versions.items()),
    ]
    texts: list[list[Scalar]] = []
    for name, value in properties:
        if value is not None and value is not False and value != "":
            text = f"{value:%Y-%m-%d %H:%M:%S} UTC" if isinstance(value, datetime) else plain(value)
            texts.append([name, "yes" if value is True else text])
    return texts


def repeat_command(
    overrides: Sequence[str], address: Address, rerun: bool, typed: str | None = None
) -> str:
    """Return the shell command, on one line, that repeats a trial into the same logbook.

    Its folder of options is that of the command line that started it (`typed`). The address of a
    PostgreSQL logbook that holds a password is in SEATRIAL_DATABASE.
    """
    words = [
        word for word in overrides if not DATABASE.match(word) and not word.startswith("rerun=")
    ]
    if address.path is not None:
        here, file = Path.cwd(), address.path.resolve()
        folder = file.parent.relative_to(here) if file.parent.is_relative_to(here) else file.parent
        words = [word for word in words if not word.startswith("results_dir=")]
        words += [] if folder == Path("results") else [f"results_dir={quoted(str(folder))}"]
        if file.name != "results.db":
            words.append(f"database.url={quoted(file_url(folder / file.name))}")
    elif address.url.password:
        words.append("database=postgresql")
    else:
        words.append(f"database.url={quoted(str(address))}")
    if any(word.startswith("experiment=") for word in words):
        words.append("hydra.mode=RUN")  # an experiment may define a sweep
    if rerun:
        words.append("rerun=true")
    return f"{trial_program()} {shlex.join([*config_folder(typed or ''), *words])}".rstrip()


def plain(value: object) -> Scalar:
    """Return a value of the database as a cell value.

    Dates are ISO text, and JSON is JSON text.
    """
    if isinstance(value, datetime):
        return value.isoformat()
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if isinstance(value, Decimal):
        return int(value) if abs(value) < 2**63 and value == int(value) else float(value)
    return json.dumps(value, ensure_ascii=False, default=str)
