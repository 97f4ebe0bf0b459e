"""SQL of a user: one query on a read-only connection, its first rows, within a time limit."""

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from sqlalchemy import Connection

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.records import Answer

TIMEOUT_S = 30.0
ROWS = 10_000
_STEPS = 1000  # of SQLite's virtual machine between two looks at the clock
_READS = "expected one query that only reads (SELECT, WITH, VALUES)"
_REFUSALS = ("readonly", "read-only", "syntax", "one statement at a time")


def ask(connection: Connection, query: str, timeout_s: float, limit: int) -> Answer:
    """Run `query` on a read-only `connection` and return its first `limit` rows.

    Raises LogbookError if it fails, would write, or takes longer than `timeout_s` [s].
    """
    errors = (connection.dialect.loaded_dbapi.Error, sqlite3.Warning, ValueError)
    try:
        with closing(_cursor(connection)) as cursor, _limited(connection, timeout_s):
            cursor.execute(query.strip().rstrip(";"))
            rows = cursor.fetchmany(limit + 1)
            columns = tuple(column[0] for column in cursor.description or ())
    except errors as error:
        message = one_line(error)
        if message == "interrupted" or getattr(error, "sqlstate", None) == "57014":
            message = f"stopped after {timeout_s:g} s; expected a shorter query, or a longer"
            raise LogbookError(f"sql: {message} --timeout") from None
        hint = f"; {_READS}" if any(word in message for word in _REFUSALS) else ""
        raise LogbookError(f"sql: {message}{hint}") from None
    if not columns:
        raise LogbookError(f"sql: the statement returns no rows; {_READS}")
    return Answer(columns, [tuple(row) for row in rows[:limit]], len(rows) > limit)


def _cursor(connection: Connection) -> Any:
    """Return a cursor of the driver; that of PostgreSQL is declared, which takes one query."""
    raw: Any = connection.connection.dbapi_connection
    return raw.cursor() if isinstance(raw, sqlite3.Connection) else raw.cursor(name="question")


@contextmanager
def _limited(connection: Connection, timeout_s: float) -> Iterator[None]:
    """Let the driver end a query after `timeout_s` [s]."""
    raw: Any = connection.connection.dbapi_connection
    if not isinstance(raw, sqlite3.Connection):
        raw.execute(f"SET LOCAL statement_timeout = {max(1, round(1000 * timeout_s))}")
        yield
        return
    end = time.monotonic() + timeout_s
    raw.set_progress_handler(lambda: time.monotonic() > end, _STEPS)
    try:
        yield
    finally:
        raw.set_progress_handler(None, 0)
