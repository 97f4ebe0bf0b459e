"""SQL queries of users: one query, which cannot write.

The connection is read-only. This module also rejects what a read-only connection allows: on SQLite
ATTACH and VACUUM INTO (they write other files), on PostgreSQL COPY ... TO and several statements
in one query.
"""

import sqlite3
from typing import Any

from sqlalchemy import Connection

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.records import Answer

_READING = {
    sqlite3.SQLITE_SELECT,
    sqlite3.SQLITE_READ,
    sqlite3.SQLITE_RECURSIVE,
}
_PRAGMAS = {"table_info", "table_xinfo", "table_list", "index_list", "index_info"}
_REFUSED = "expected one query that only reads (SELECT, WITH, VALUES)"


def ask(connection: Connection, query: str) -> Answer:
    """Run `query` on a read-only `connection`; raises LogbookError if it fails or would write."""
    if not query.strip():
        raise LogbookError(f"sql: got an empty query; {_REFUSED}")
    raw = connection.connection.dbapi_connection
    if isinstance(raw, sqlite3.Connection):
        return _ask_sqlite(raw, query)
    return _ask_postgresql(raw, query)


def _permit(action: int, first: str | None, second: str | None, *_: str | None) -> int:
    allowed = (
        action in _READING
        or (action == sqlite3.SQLITE_FUNCTION and second != "load_extension")
        or (action == sqlite3.SQLITE_PRAGMA and first in _PRAGMAS)
        # needed for pragma_table_info(...); SQLite itself forbids UPDATE on this table
        or (action == sqlite3.SQLITE_UPDATE and first == "sqlite_master")
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


def _ask_sqlite(raw: sqlite3.Connection, query: str) -> Answer:
    raw.set_authorizer(_permit)
    cursor = raw.cursor()
    try:
        rows = cursor.execute(query).fetchall()
        description = cursor.description
    except (sqlite3.Error, sqlite3.Warning) as error:
        message = one_line(error)
        if "not authorized" in message or "prohibited" in message or "readonly" in message:
            raise LogbookError(f"sql: refused: the logbook is read-only; {_REFUSED}") from None
        raise LogbookError(f"sql: {message}") from None
    finally:
        cursor.close()
        raw.set_authorizer(None)
    if description is None:
        raise LogbookError(f"sql: the statement returns no rows; {_REFUSED}")
    return Answer(tuple(column[0] for column in description), rows)


def _ask_postgresql(raw: Any, query: str) -> Answer:
    import psycopg

    # A named cursor is declared with DECLARE ... CURSOR FOR, which takes exactly one query.
    cursor = raw.cursor(name="question")
    try:
        rows = cursor.execute(query.strip().rstrip(";")).fetchall()
        return Answer(tuple(column.name for column in cursor.description or ()), rows)
    except psycopg.Error as error:
        message = one_line(error)
        if isinstance(error, psycopg.errors.ReadOnlySqlTransaction | psycopg.errors.SyntaxError):
            message = f"{message}; {_REFUSED}"
        raise LogbookError(f"sql: {message}") from None
    finally:
        cursor.close()
