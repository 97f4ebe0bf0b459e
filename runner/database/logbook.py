"""The logbook, opened for writing: the start and end of sweeps and runs, and their results.

with LogbookWriter.open("sqlite:///results/results.db", results_dir=Path("results")) as logbook:
    begun = logbook.begin_run(start)
    if begun.state == "new":
        logbook.finish_run(begun.run_id, Results(metrics=[...]))
"""

import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import TypeVar

from sqlalchemy import Connection, Engine, delete, insert, or_, select, update
from sqlalchemy.engine import URL

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import LogbookError
from seatrial.runner.database import claims, schema, tables
from seatrial.runner.database import engine as engines
from seatrial.runner.database import series_files as files
from seatrial.runner.database.engine import Address, parse
from seatrial.runner.database.outage import hurry, repeated
from seatrial.runner.database.reader import LogbookReader
from seatrial.runner.database.records import AT_ONCE, RunClaim, cell, plain
from seatrial.runner.record.rows import Coefficient, Metric, Results
from seatrial.runner.record.vocabulary import Ending

T = TypeVar("T")


class LogbookWriter(LogbookReader):
    """A logbook, opened for writing."""

    def __init__(self, address: Address, results_dir: Path) -> None:
        super().__init__(address, engines.reader(address), results_dir)
        self._writer: Engine = engines.writer(address)
        self._begun: dict[int, float] = {}  # time.monotonic() at the start of runs under way
        self._ended = Event()
        beat = partial(claims.beat, self._writer, address, self._begun, self._ended)
        self._heartbeat = Thread(target=beat, name="heartbeat", daemon=True)

    @classmethod
    def open(cls, url: str | URL, *, results_dir: Path, create: bool = True) -> "LogbookWriter":
        """Open the logbook at `url`; create it (if `create`) if there is none.

        Raises LogbookError, and changes nothing, if the database belongs to another program, has
        another schema, is damaged or cannot be reached.
        """
        address = parse(url)
        schema.prepare(address, create=create)
        return cls(address, results_dir.absolute())

    def close(self) -> None:
        """Mark the runs that have not ended as interrupted, and close every connection."""
        if self._begun:
            hurry(self.address)
        self._ended.set()
        if self._heartbeat.is_alive():  # it starts with the first run
            self._heartbeat.join()
        super().close()
        self._writer.dispose()  # ends a transaction that Ctrl-C left open
        try:
            with suppress(LogbookError):  # without a heartbeat they count as interrupted anyway
                for run_id in self._begun:
                    reason = "the program ended before the run did"
                    self._write(partial(claims.give_up, run_id=run_id, reason=reason))
        finally:
            self._begun.clear()
            self._writer.dispose()  # last: the last writer of a SQLite file removes its log

    def _write(self, task: Callable[[Connection], T]) -> T:
        """Run `task` in one transaction; repeat it if the connection to the server is lost."""

        def transaction() -> T:
            with self._writer.begin() as connection:
                return task(connection)

        with engines.explained(self.address):
            return repeated(self.address, transaction)

    def begin_sweep(
        self,
        name: str,
        command: str,
        overrides: Sequence[str],
        planned: int,
        *,
        tags: Sequence[str] = (),
        note: str | None = None,
        trials: Sequence[Mapping[str, object]] = (),
    ) -> int:
        """Store the start of a sweep of `planned` trials; returns its id.

        `trials` are their rows of the table `planned`, where they are known before.
        """
        own = {"host": socket.gethostname(), "pid": os.getpid(), "started_at": datetime.now(UTC)}
        texts = {"name": name, "command": command, "overrides": overrides, "note": note}
        row = {key: plain(value) for key, value in (texts | {"tags": tags}).items()} | own
        row["planned"] = planned
        sweep = tables.SweepRow

        def store(connection: Connection) -> int:
            same = [getattr(sweep, key) == value for key, value in own.items()]
            stored = connection.scalar(select(sweep.id).where(*same))
            if stored is not None:  # the reply to an earlier insert was lost
                return stored
            query = insert(sweep).values(row).returning(sweep.id)
            sweep_id = connection.execute(query).scalar_one()
            rows = [
                {**trial, "overrides": plain(trial["overrides"]), "sweep_id": sweep_id}
                for trial in trials
            ]
            if rows:
                connection.execute(insert(tables.PlannedRow), rows)
            return sweep_id

        return self._write(store)

    def end_sweep(self, sweep_id: int, planned: int | None = None) -> None:
        """Store the end of a sweep; a SQLite file is then complete without its write-ahead log.

        `planned` is the number of trials where it was not known before.
        """
        values: dict[str, object] = {"finished_at": datetime.now(UTC)}
        if planned is not None:
            values["planned"] = planned
        ended = update(tables.SweepRow).where(tables.SweepRow.id == sweep_id).values(values)
        self._write(lambda connection: connection.execute(ended))
        if self.address.path is not None:
            with engines.explained(self.address):
                engines.checkpoint(self.address.path)

    def give_up_sweep(self, sweep_id: int) -> None:
        """Mark the runs of a sweep as interrupted whose processes on this machine have ended.

        The program is about to end, so it does not wait for an unreachable server.
        """
        hurry(self.address)
        with suppress(LogbookError):  # without a heartbeat the runs count as interrupted anyway
            self._write(partial(claims.give_up_gone, sweep_id=sweep_id))

    def reuse(self, sweep_id: int, run_ids: Sequence[int]) -> set[int]:
        """Store that a sweep takes over finished runs; returns those that are there and finished.

        Another process may have deleted the others in the meantime.
        """
        return self._write(partial(claims.reuse, sweep_id=sweep_id, run_ids=run_ids))

    def begin_run(
        self, start: tables.RunRow, sweep_id: int | None = None, *, rerun: bool = False
    ) -> RunClaim:
        """Claim a trial: `new` if the caller is to run it, else the run that finished or runs it.

        A new run has a heartbeat until it ends.
        """
        order = (start, sweep_id, rerun, datetime.now(UTC))
        begun = self._write(lambda connection: claims.claim(connection, *order))
        if begun.state == "new":
            self._begun[begun.run_id] = time.monotonic()
            if self._heartbeat.ident is None:
                self._heartbeat.start()
        return begun

    def finish_run(self, run_id: int, results: Results) -> None:
        """End a run: write its series file, then its rows and its status in one transaction.

        Raises LogbookError, and does not change the run, if the results cannot be stored.
        """
        self._end_run(run_id, "finished", results, {})

    def fail_run(
        self,
        run_id: int,
        status: Ending,
        error_type: str,
        error: str,
        traceback: str | None,
        results: Results | None = None,
    ) -> None:
        """End a run that failed or diverged, with the results that are valid."""
        cause = {"error_type": error_type, "error": plain(error), "traceback": plain(traceback)}
        self._end_run(run_id, status, results or Results(), cause)

    def _end_run(
        self, run_id: int, status: Ending, results: Results, cause: Mapping[str, object]
    ) -> None:
        begun = self._begun.get(run_id)
        ending = {
            "status": status,
            **cause,
            "note": plain(results.note),
            "drawn": None if results.drawn is None else list(results.drawn),
            "finished_at": datetime.now(UTC),
            "duration_s": None if begun is None else time.monotonic() - begun,
        }
        written = files.write(self.results_dir, run_id, results.series)
        run = tables.RunRow

        def end(connection: Connection) -> None:
            running = update(run).where(run.id == run_id, run.status == "running")
            if connection.execute(running, ending).rowcount == 1:
                for facts in (results.metrics, results.coefficients, results.diagnostics):
                    _insert(connection, run_id, facts)
                if written:  # few rows, with a JSON column
                    connection.execute(insert(tables.SeriesRow), written)
                return
            query = select(run.status, run.finished_at).where(run.id == run_id)
            stored = connection.execute(query).one_or_none()
            if stored is None or tuple(stored) != (status, ending["finished_at"]):
                raise LogbookError(
                    f"{self.address}: run {run_id} cannot be ended: it is"
                    f" {stored.status if stored else 'missing'}, expected running"
                )

        try:
            self._write(end)
        except BaseException:
            with suppress(OSError):  # `verify` lists a file that remains
                for path in {str(row["path"]) for row in written}:
                    files.locate(self.results_dir, path).unlink(missing_ok=True)
            raise
        self._begun.pop(run_id, None)

    def prune(self, run_ids: Sequence[int]) -> tuple[int, int, list[str]]:
        """Delete runs with their rows, then their files; running runs are not deleted.

        Their trials are no longer planned: nobody waits for what was deleted. Returns the number of
        deleted runs and files, and the files that could not be deleted.
        """
        run, series, planned = tables.RunRow, tables.SeriesRow, tables.PlannedRow
        ended = or_(run.status != "running", claims.stale(self.address.dialect))
        deleted, paths, left = 0, list[str](), list[str]()
        with engines.explained(self.address), self._writer.begin() as connection:
            for first in range(0, len(run_ids), AT_ONCE):
                own = select(run.id).where(run.id.in_(run_ids[first : first + AT_ONCE]), ended)
                part = connection.scalars(own.with_for_update()).all()
                paths += connection.scalars(
                    select(series.path).where(series.run_id.in_(part)).distinct()
                )
                trials = select(run.fingerprint).where(run.id.in_(part))
                connection.execute(delete(planned).where(planned.fingerprint.in_(trials)))
                connection.execute(delete(run).where(run.id.in_(part)))
                deleted += len(part)
        for path in paths:
            try:
                files.locate(self.results_dir, path).unlink(missing_ok=True)
            except (OSError, LogbookError):
                left.append(path)
        with suppress(OSError):  # the folder is removed only if it is empty
            (self.results_dir / files.FOLDER).rmdir()
        return deleted, len(paths) - len(left), left


def _insert(
    connection: Connection, run_id: int, facts: Sequence[Metric | Coefficient | Diagnostic]
) -> None:
    """Insert facts into the table of their name, by one statement; their fields are its columns.

    SQLAlchemy takes five times as long.
    """
    if not facts:
        return
    table, names = type(facts[0]).__name__.lower(), ["run_id", *vars(facts[0])]
    mark = "?" if connection.dialect.paramstyle == "qmark" else "%s"
    connection.exec_driver_sql(
        f"INSERT INTO {table} ({', '.join(names)}) VALUES ({', '.join(mark for _ in names)})",
        [(run_id, *map(cell, vars(fact).values())) for fact in facts],
    )
