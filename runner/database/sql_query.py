"""SQL queries of users: one query, which cannot write and ends in a limited time.

The connection is read-only. This module also rejects what a read-only connection allows: on SQLite
ATTACH and VACUUM INTO (they write other files), on PostgreSQL COPY ... TO, several statements in
one query, large objects, and functions that read files of the server or change the session. A
PostgreSQL role that may read files of the server gives up this right for the query.
"""

import re
import sqlite3
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import Connection

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.records import Answer

TIMEOUT_S = 30.0
ROWS = 10_000
_LONGEST = 64 * 2**20  # bytes of a value
_LARGEST = 256 * 2**20  # characters and bytes of all texts of an answer
_AT_ONCE = 10  # rows that a PostgreSQL server sends at once
_PATTERN = 1000  # characters of a pattern of LIKE, whose time grows with the square
_STEPS = 1000  # of SQLite's virtual machine between two looks at the clock
_READING = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_RECURSIVE}
_PRAGMAS = {"table_info", "table_xinfo", "table_list", "index_list", "index_info"}
_REFUSED = "expected one query that only reads (SELECT, WITH, VALUES)"


# Functions and notations by which a query reads files, writes large objects, changes the session's
# role or settings, or runs text as a query (which could do all of this).
_FORBIDDEN = re.compile(
    r"\b(?:pg_read_\w+|pg_ls_\w+|pg_stat_file|pg_file_\w+|pg_logdir_ls|pg_current_logfile"
    r"|lo_\w+|loread|lowrite|set_config|dblink\w*|(?:query|cursor|table|schema|database)_to_xml\w*"
    r"|ts_stat|ts_rewrite|pg_terminate_backend|pg_cancel_backend|pg_reload_conf)\b|\bU&",
    re.IGNORECASE,
)
_SERVER_RIGHTS = ("pg_read_server_files", "pg_write_server_files", "pg_execute_server_program")
_ROLE = (
    "SELECT current_user, rolsuper, ARRAY(SELECT rolname FROM pg_roles WHERE rolname = ANY(%s)"
    " AND pg_has_role(current_user, oid, 'MEMBER')) FROM pg_roles WHERE rolname = current_user"
)


def ask(
    connection: Connection, query: str, timeout_s: float = TIMEOUT_S, limit: int = ROWS
) -> Answer:
    """Run `query` on a read-only `connection` and return its first `limit` rows.

    Raises LogbookError if it fails, would write, takes longer than `timeout_s` [s], or if the
    answer is too large.
    """
    if not query.strip():
        raise LogbookError(f"sql: got an empty query; {_REFUSED}")
    raw = connection.connection.dbapi_connection
    try:
        if isinstance(raw, sqlite3.Connection):
            return _ask_sqlite(raw, query, timeout_s, limit)
        return _ask_postgresql(raw, query, timeout_s, limit)
    except ValueError as error:  # text that is not UTF-8, or with a NUL
        raise LogbookError(f"sql: the query is not text: {error}") from None


def _first(rows: Iterable[tuple[object, ...]], limit: int) -> tuple[list[tuple[object, ...]], bool]:
    """Return the first rows, and whether there are more."""
    first: list[tuple[object, ...]] = []
    size = 0
    for row in rows:
        if len(first) == limit:
            return first, True
        size += sum(len(value) for value in row if isinstance(value, str | bytes))
        if size > _LARGEST:
            raise LogbookError(
                f"sql: the answer is larger than {_LARGEST >> 20} MB after {len(first)} rows;"
                " expected fewer rows or columns"
            )
        first.append(row)
    return first, False


def _too_long(timeout_s: float) -> LogbookError:
    return LogbookError(
        f"sql: stopped after {timeout_s:g} s; expected a shorter query, or a longer --timeout"
    )


def _permit(action: int, first: str | None, second: str | None, *_: str | None) -> int:
    allowed = (
        action in _READING
        or (action == sqlite3.SQLITE_FUNCTION and second != "load_extension")
        or (action == sqlite3.SQLITE_PRAGMA and first in _PRAGMAS)
        # needed for pragma_table_info(...); SQLite itself forbids UPDATE on this table
        or (action == sqlite3.SQLITE_UPDATE and first == "sqlite_master")
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY


@contextmanager
def _limited(raw: sqlite3.Connection, timeout_s: float) -> Iterator[None]:
    """Restrict a connection to reading, to a time and to the sizes above."""
    end = time.monotonic() + timeout_s
    sizes = {
        sqlite3.SQLITE_LIMIT_LENGTH: _LONGEST,
        sqlite3.SQLITE_LIMIT_LIKE_PATTERN_LENGTH: _PATTERN,
    }
    before = {name: raw.setlimit(name, size) for name, size in sizes.items()}
    text_factory = raw.text_factory
    raw.text_factory = lambda content: content.decode("utf-8", "backslashreplace")
    raw.set_authorizer(_permit)
    raw.set_progress_handler(lambda: time.monotonic() > end, _STEPS)
    try:
        yield
    finally:
        raw.set_progress_handler(None, 0)
        raw.set_authorizer(None)
        raw.text_factory = text_factory
        for name, size in before.items():
            raw.setlimit(name, size)


def _ask_sqlite(raw: sqlite3.Connection, query: str, timeout_s: float, limit: int) -> Answer:
    cursor = raw.cursor()
    with _limited(raw, timeout_s):
        try:
            rows, more = _first(cursor.execute(query), limit)
            description = cursor.description
        except (sqlite3.Error, sqlite3.Warning) as error:
            message = one_line(error)
            if message == "interrupted":
                raise _too_long(timeout_s) from None
            if "not authorized" in message or "prohibited" in message or "readonly" in message:
                refusal = f"sql: refused: the logbook is read-only; {_REFUSED}"
                raise LogbookError(refusal) from None
            raise LogbookError(f"sql: {message}") from None
        finally:
            cursor.close()
    if description is None:
        raise LogbookError(f"sql: the statement returns no rows; {_REFUSED}")
    return Answer(tuple(column[0] for column in description), rows, more)


def _ask_postgresql(raw: Any, query: str, timeout_s: float, limit: int) -> Answer:
    import psycopg

    if match := _FORBIDDEN.search(query):
        raise LogbookError(
            f"sql: refused: {match[0]} can read files of the server, write large objects or change"
            f" the session; {_REFUSED}"
        )
    _give_up_server_rights(raw)
    raw.execute(f"SET LOCAL statement_timeout = {max(1, round(1000 * timeout_s))}")
    # A named cursor is declared with DECLARE ... CURSOR FOR, which takes exactly one query.
    cursor = raw.cursor(name="question")
    cursor.itersize = _AT_ONCE
    try:
        cursor.execute(query.strip().rstrip(";"))
        rows, more = _first(cursor, limit)
        return Answer(tuple(column.name for column in cursor.description or ()), rows, more)
    except psycopg.errors.QueryCanceled:
        raise _too_long(timeout_s) from None
    except psycopg.Error as error:
        message = one_line(error)
        if isinstance(error, psycopg.errors.ReadOnlySqlTransaction | psycopg.errors.SyntaxError):
            message = f"{message}; {_REFUSED}"
        raise LogbookError(f"sql: {message}") from None
    finally:
        cursor.close()


def _give_up_server_rights(raw: Any) -> None:
    """Take a role for this transaction that reads tables, but no files of the server.

    Raises LogbookError if the role of the session has such rights and cannot give them up.
    """
    import psycopg

    role, superuser, rights = raw.execute(_ROLE, [list(_SERVER_RIGHTS)]).fetchone()
    if not superuser and not rights:
        return
    try:
        raw.execute("SET LOCAL ROLE pg_read_all_data")
    except psycopg.Error as error:
        reason = "is a superuser" if superuser else f"is a member of {', '.join(rights)}"
        raise LogbookError(
            f"sql: refused: the role {role} {reason}, so a query could read files of the server"
            f" ({one_line(error)}); expected a role that only reads the tables"
        ) from None
