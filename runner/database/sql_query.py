"""SQL from people: one query, which cannot write, whatever it says.

The connection is read-only already. What that alone would leave open is closed here: on SQLite
ATTACH and VACUUM INTO (they write other files), on PostgreSQL COPY ... TO and several statements
in one.
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
_REFUSED = "only one query that reads is answered (SELECT, WITH, VALUES)"


def ask(connection: Connection, query: str) -> Answer:
    """The answer to `query` over a read-only `connection`."""
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
        # how SQLite itself declares pragma_table_info(...); it lets no UPDATE near this table
        or (action == sqlite3.SQLITE_UPDATE and first == "sqlite_master")
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


def _ask_sqlite(raw: sqlite3.Connection, query: str) -> Answer:
    raw.set_authorizer(_permit)
    cursor = raw.cursor()
    try:
        rows = cursor.execute(query).fetchall()
        described = cursor.description
    except (sqlite3.Error, sqlite3.Warning) as error:
        said = one_line(error)
        if "not authorized" in said or "prohibited" in said or "readonly" in said:
            raise LogbookError(
                f"sql: refused: the logbook is open to be read; {_REFUSED}"
            ) from None
        raise LogbookError(f"sql: {said}") from None
    finally:
        cursor.close()
        raw.set_authorizer(None)
    if described is None:
        raise LogbookError(f"sql: no rows come of this; {_REFUSED}")
    return Answer(tuple(column[0] for column in described), rows)


def _ask_postgresql(raw: Any, query: str) -> Answer:
    import psycopg

    # DECLARE ... CURSOR FOR takes nothing but a query, and a named cursor sends just one.
    cursor = raw.cursor(name="question")
    try:
        rows = cursor.execute(query.strip().rstrip(";")).fetchall()
        return Answer(tuple(column.name for column in cursor.description or ()), rows)
    except psycopg.Error as error:
        said = one_line(error)
        if isinstance(error, psycopg.errors.ReadOnlySqlTransaction | psycopg.errors.SyntaxError):
            said = f"{said}; {_REFUSED}"
        raise LogbookError(f"sql: {said}") from None
    finally:
        cursor.close()
