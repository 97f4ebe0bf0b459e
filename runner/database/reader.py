"""Queries of a logbook over a read-only connection."""

import sqlite3
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, TypeVar, TypeVarTuple

from sqlalchemy import (
    URL,
    BigInteger,
    ColumnElement,
    Connection,
    Engine,
    Row,
    Select,
    literal,
    or_,
    select,
)
from sqlalchemy.exc import DataError, DBAPIError

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import LogbookError
from seatrial.runner.database import engine as engines
from seatrial.runner.database import maintenance, schema, tables
from seatrial.runner.database import series_files as files
from seatrial.runner.database.claims import is_gone
from seatrial.runner.database.engine import Address, parse
from seatrial.runner.database.outage import repeated
from seatrial.runner.database.records import (
    AT_ONCE,
    Answer,
    RunDetail,
    RunSummary,
    SweepStatus,
    Verification,
)
from seatrial.runner.database.tables import SeriesRow
from seatrial.runner.database.views import run_overview
from seatrial.runner.record.rows import Coefficient, Metric, Series
from seatrial.runner.record.vocabulary import ENDINGS, LOST

Fact = TypeVar("Fact", Metric, Coefficient, Diagnostic, SeriesRow)
Columns = TypeVarTuple("Columns")
STEPS = 1000  # of SQLite's virtual machine between two looks at the clock
READS = "expected one query that only reads (SELECT, WITH, VALUES)"
REFUSALS = ("readonly", "read-only", "syntax", "one statement at a time")


class LogbookReader:
    """A logbook, opened for reading; `results_dir` holds its series files."""

    def __init__(self, address: Address, engine: Engine, results_dir: Path) -> None:
        self.address = address
        self.results_dir = results_dir
        self._engine = engine

    @classmethod
    def read(cls, url: str | URL, *, results_dir: Path | None = None) -> "LogbookReader":
        """Open the logbook at `url`; `results_dir` is the folder of a SQLite file by default.

        Raises LogbookError if there is none, or if this version cannot read it.
        """
        address = parse(url)
        schema.require_current(address)
        folder = results_dir or (address.path.parent if address.path else Path("results"))
        return LogbookReader(address, engines.reader(address), folder.absolute())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close every connection."""
        self._engine.dispose()

    def sql(self, query: str, timeout_s: float = 30.0, limit: int = 10_000) -> Answer:
        """Run one SQL query and return its first `limit` rows.

        Raises LogbookError if it fails, would write, or takes longer than `timeout_s` [s].
        """
        # A cursor that PostgreSQL streams from takes one query.
        options = {"no_parameters": True, "stream_results": True}
        with engines.explained(self.address), self._engine.connect() as connection:
            try:
                text = query.strip().rstrip(";")
                with (
                    _limited(connection, timeout_s),
                    connection.exec_driver_sql(text, execution_options=options) as result,
                ):
                    if not result.returns_rows:
                        raise LogbookError(f"sql: the statement returns no rows; {READS}")
                    columns, rows = tuple(result.keys()), result.fetchmany(limit + 1)
            except (DBAPIError, sqlite3.Warning, ValueError) as error:
                message, cause = engines.one_line(error), getattr(error, "orig", None)
                if message == "interrupted" or getattr(cause, "sqlstate", None) == "57014":
                    hint = "expected a shorter query, or a longer --timeout"
                    raise LogbookError(f"sql: stopped after {timeout_s:g} s; {hint}") from None
                hint = f"; {READS}" if any(word in message for word in REFUSALS) else ""
                raise LogbookError(f"sql: {message}{hint}") from None
        return Answer(columns, [tuple(row) for row in rows[:limit]], len(rows) > limit)

    def select(self, statement: Select[*Columns]) -> Sequence[Row[*Columns]]:
        """Return the rows of a SQLAlchemy query over `tables` and `views.run_overview`."""

        def rows() -> Sequence[Row[*Columns]]:
            with self._engine.connect() as connection:
                return connection.execute(statement).all()

        try:
            with engines.explained(self.address):
                return repeated(self.address, rows)
        except (DataError, OverflowError, ValueError, TypeError) as error:
            # A number beyond the range of its column, text that is not UTF-8, a damaged cell.
            raise LogbookError(f"{self.address}: {engines.one_line(error)}") from error

    def runs(
        self, *where: ColumnElement[bool], newest_first: bool = False, limit: int | None = None
    ) -> list[RunSummary]:
        """Return the runs that meet all conditions on `run_overview` and the table `run`."""
        view, run = run_overview.c, tables.RunRow
        query = select(*(view[name] for name in RunSummary.__dataclass_fields__), run.process)
        query = query.join_from(run_overview, run, run.id == view.run_id).where(*where)
        query = query.order_by(run.id.desc() if newest_first else run.id).limit(limit)
        return [
            replace(RunSummary(*row[:-1]), status=_status(row), superseded=bool(row.superseded))
            for row in self.select(query)
        ]

    def sweeps(self, *where: ColumnElement[bool]) -> list[tables.SweepRow]:
        """Return the sweeps that meet all conditions, oldest first."""
        query = select(tables.SweepRow.__table__).where(*where).order_by(tables.SweepRow.id)
        return [tables.SweepRow(**row._asdict()) for row in self.select(query)]

    def run(self, run_id: int) -> RunDetail:
        """Return a run with its configuration; raises LogbookError if there is no such run."""
        summaries = self.runs(tables.RunRow.id == literal(run_id, BigInteger()))
        if not summaries:
            raise LogbookError(f"{self.address}: there is no run {run_id}")
        (row,) = self.select(select(tables.RunRow.__table__).where(tables.RunRow.id == run_id))
        names = RunDetail.__dataclass_fields__
        cells = {name: cell for name, cell in row._asdict().items() if name in names}
        return RunDetail(summary=summaries[0], **cells)

    def trials(self, fingerprints: Iterable[str]) -> dict[str, RunSummary]:
        """Return the valid attempts at trials by fingerprint, of those that have one."""
        runs: dict[str, RunSummary] = {}
        wanted = list(fingerprints)
        for start in range(0, len(wanted), AT_ONCE):
            part = wanted[start : start + AT_ONCE]
            for run in self.runs(tables.RunRow.fingerprint.in_(part)):
                if not run.superseded:
                    runs.setdefault(run.fingerprint, run)
        return runs

    def metrics(self, run_id: int) -> list[Metric]:
        """Return the metrics of a run, in the order of storage."""
        return self._facts(Metric, tables.MetricRow, run_id)

    def coefficients(self, run_id: int) -> list[Coefficient]:
        """Return the coefficients of a run's models, in the order of storage."""
        return self._facts(Coefficient, tables.CoefficientRow, run_id)

    def diagnostics(self, run_id: int) -> list[Diagnostic]:
        """Return the diagnostics of a run, in the order of storage."""
        return self._facts(Diagnostic, tables.DiagnosticRow, run_id)

    def series_files(self, run_id: int) -> list[SeriesRow]:
        """Return the series of a run, which share its file."""
        return self._facts(SeriesRow, SeriesRow, run_id)

    def _facts(self, record: type[Fact], table: type[tables.Base], run_id: int) -> list[Fact]:
        columns = table.__table__.c
        names = getattr(record, "__dataclass_fields__", columns.keys())
        statement = select(*(columns[name] for name in names)).where(columns.run_id == run_id)
        return [record(**row._asdict()) for row in self.select(statement.order_by(columns.id))]

    def series(self, run_id: int, kind: str) -> Series:
        """Read a series of a run; raises LogbookError if it is missing or its checksum differs."""
        for file in self.series_files(run_id):
            if file.kind == kind:
                return files.read(self.results_dir, file)
        raise LogbookError(f"{self.address}: run {run_id} has no series {kind!r}")

    def sweep_status(self, sweep_id: int) -> SweepStatus:
        """Return the progress of a sweep; raises LogbookError if there is no such sweep."""
        run, reuse, plan = tables.RunRow, tables.Reuse, tables.PlannedRow
        own = self.sweeps(tables.SweepRow.id == sweep_id)
        if not own:
            raise LogbookError(f"{self.address}: there is no sweep {sweep_id}")
        reused, view = select(reuse.run_id).where(reuse.sweep_id == sweep_id), run_overview.c
        names = ("run_id", "fingerprint", "status", "duration_s", "sweep_id")
        trials = select(*(view[name] for name in names), run.process)
        trials = trials.join_from(run_overview, run, run.id == view.run_id).order_by(run.id)
        trials = trials.where(or_(run.sweep_id == sweep_id, run.id.in_(reused)))
        last = {trial.fingerprint: trial for trial in self.select(trials)}.values()  # at each
        statuses = {trial.run_id: _status(trial) for trial in last}
        lost = [run_id for run_id, status in statuses.items() if status in LOST]
        plans = select(plan.fingerprint, plan.choices).where(plan.sweep_id == sweep_id)
        choices = {row.fingerprint: " ".join(row.choices.values()) for row in self.select(plans)}
        spent_s = defaultdict[str, list[float]](list)
        ended = [trial for trial in last if statuses[trial.run_id] in ENDINGS]
        for trial in ended:
            spent_s[choices.get(trial.fingerprint, "")].append(trial.duration_s or 0.0)
        left = Counter(choices.values())
        left[""] += max(own[0].planned - len(choices), 0)
        left.subtract(choices.get(trial.fingerprint, "") for trial in ended)
        return SweepStatus(
            sweep_id=sweep_id,
            name=own[0].name,
            planned=own[0].planned,
            counts=dict(Counter(statuses.values())),
            reused=sum(trial.sweep_id != sweep_id for trial in last),
            failed=self.runs(run.id.in_(lost)) if lost else [],
            finished_at=own[0].finished_at,
            left=left,
            spent_s=spent_s,
        )

    def verify(self) -> Verification:
        """Check the database, every foreign key and every series file."""
        with engines.explained(self.address), self._engine.connect() as connection:
            return maintenance.verify(connection, self.results_dir)

    def export(self, folder: Path) -> list[Path]:
        """Write every table to `folder` as Parquet and CSV; returns the paths."""
        with engines.explained(self.address), self._engine.connect() as connection:
            if self.address.path is None:  # one snapshot; SQLite always has one
                connection = connection.execution_options(isolation_level="REPEATABLE READ")
            return maintenance.export(connection, folder)


def _status(row: Row[*tuple[object, ...]]) -> str:
    """Return the status of the view; `interrupted` if the process of a running run has ended."""
    status: str = row.status
    return "interrupted" if status == "running" and is_gone(row.process) else status


@contextmanager
def _limited(connection: Connection, timeout_s: float) -> Iterator[None]:
    """Let the database end a query after `timeout_s` [s]."""
    if connection.dialect.name != "sqlite":
        milliseconds = max(1, round(1000 * timeout_s))
        connection.exec_driver_sql(f"SET LOCAL statement_timeout = {milliseconds}")
        yield
        return
    raw: Any = connection.connection.dbapi_connection
    end = time.monotonic() + timeout_s
    raw.set_progress_handler(lambda: time.monotonic() > end, STEPS)
    try:
        yield
    finally:
        raw.set_progress_handler(None, 0)
