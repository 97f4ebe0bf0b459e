"""Connections to the database: one writer at a time on SQLite, and read-only readers.

Every write transaction on SQLite starts with BEGIN IMMEDIATE: a deferred transaction that reads
before it writes fails with "database is locked" if another process has written in between, and no
timeout prevents this. Readers have their own engine with plain BEGIN, on a read-only connection.
"""

import json
import os
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NoReturn
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import (
    ArgumentError,
    DataError,
    DBAPIError,
    IntegrityError,
    NotSupportedError,
    ProgrammingError,
)
from sqlalchemy.pool import QueuePool

from seatrial.models.errors import LogbookError
from seatrial.runner.database.mask import learn, without_passwords
from seatrial.runner.database.outage import wait_for_server

# Database URLs: parsing, and display without passwords.


@dataclass(frozen=True)
class Address:
    """Where a logbook is: a SQLite file (`path`) or a PostgreSQL database (`path` is None)."""

    url: URL
    path: Path | None

    @property
    def sqlite(self) -> bool:
        """Whether this is SQLite rather than PostgreSQL."""
        return self.path is not None

    def __str__(self) -> str:
        """The file, or the URL without its password, for messages."""
        return str(self.path or display_url(self.url.set(drivername="postgresql")))


def parse(url: str | URL) -> Address:
    """Parse a database URL; raises LogbookError if it is invalid."""
    try:
        parsed = _parsed(url)
    except (ArgumentError, ValueError, TypeError):
        raise LogbookError(
            f"database.url is not a database URL: got {without_passwords(str(url))!r};"
            " expected sqlite:///FILE or postgresql://USER@HOST/NAME"
        ) from None
    dialect = parsed.get_backend_name()
    if dialect == "sqlite":
        return Address(parsed, _sqlite_file(parsed))
    if dialect in ("postgresql", "postgres"):
        return Address(parsed.set(drivername="postgresql+psycopg"), None)
    raise LogbookError(
        f"database.url: unknown database dialect {dialect!r} in {display_url(parsed)};"
        " expected sqlite or postgresql"
    )


def _parsed(url: str | URL) -> URL:
    if isinstance(url, URL):
        if url.password:
            learn(url.render_as_string(hide_password=False))
        return url
    learn(str(url))
    parsed = make_url(url)
    if parsed.get_backend_name() == "sqlite" and "?" in url:  # SQLAlchemy drops "?x" silently
        _refuse_sqlite(url)
    return parsed


def file_url(path: Path) -> str:
    """Return the URL of a SQLite file; only % and ? in its path are escaped."""
    escaped = str(path).replace("%", "%25").replace("?", "%3F")
    return f"sqlite:///{escaped}"


def _refuse_sqlite(url: str | URL) -> NoReturn:
    raise LogbookError(
        f"database.url: got {display_url(url)}; expected sqlite:///FILE"
        " (a file without options; write % and ? in its name as %25 and %3F)"
    )


def _sqlite_file(url: URL) -> Path:
    if url.host or url.query or not url.database or url.database == ":memory:":
        _refuse_sqlite(url)
    return Path(url.database).absolute()


def display_url(url: str | URL) -> str:
    """Return `url` with every password replaced by three stars."""
    if isinstance(url, URL):
        return without_passwords(url.render_as_string(hide_password=True))
    learn(str(url))
    return without_passwords(str(url))


BUSY_TIMEOUT_S = 30.0
CONNECT_TIMEOUT_S = 10
_to_json = partial(json.dumps, allow_nan=False, ensure_ascii=False)


def writer(address: Address) -> Engine:
    """Create an engine for writing; it does not create a missing file."""
    return _writer(address, "mode=rw", foreign_keys=True)


def maker(address: Address) -> Engine:
    """Create an engine that creates a missing file and may rebuild tables: no foreign keys."""
    return _writer(address, "mode=rwc", foreign_keys=False)


def _writer(address: Address, option: str, *, foreign_keys: bool) -> Engine:
    if address.path is None:
        return _postgresql(address, read_only=False)
    connect = partial(_open_to_write, address.path, option, foreign_keys=foreign_keys)
    return _sqlite(connect, "BEGIN IMMEDIATE")


def reader(address: Address) -> Engine:
    """Create an engine whose connections the database itself makes read-only."""
    if address.path is None:
        return _postgresql(address, read_only=True)
    return _sqlite(partial(open_to_read, address.path), "BEGIN")


@contextmanager
def explained(address: Address) -> Iterator[None]:
    """Convert errors of the database to a LogbookError of one line.

    Errors that only a mistake of the caller can cause (a violated constraint, invalid SQL) are not
    converted.
    """
    try:
        yield
    except (DataError, IntegrityError, NotSupportedError):
        raise
    except ProgrammingError as error:
        if "permission denied" not in str(error.orig):
            raise
        raise LogbookError(f"{address}: {one_line(error)}") from error
    except (DBAPIError, sqlite3.Error) as error:
        raise LogbookError(f"{address}: {one_line(error)}") from error


def one_line(error: Exception) -> str:
    """Return the first line of a database error, without passwords."""
    message = str(error.orig if isinstance(error, DBAPIError) else error).strip()
    first = without_passwords(message.splitlines()[0]) if message else type(error).__name__
    return first.replace("unable to open database file", "cannot open the database file")


def _sqlite(connect: Callable[[], sqlite3.Connection], begin: str) -> Engine:
    engine = create_engine(
        "sqlite://", creator=connect, poolclass=QueuePool, json_serializer=_to_json
    )

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        connection.exec_driver_sql(begin)

    _release_locks(engine)
    return engine


def _release_locks(engine: Engine) -> None:
    """Let `engine.dispose` end the transactions that are still open.

    Ctrl-C within a transaction can leave a connection that nobody returns to the pool, or a SQLite
    connection that is closed under a statement and keeps its lock until the statement is collected;
    a session that goes on would wait for it.
    """
    opened: set[DBAPIConnection] = set()

    def end_transaction(connection: DBAPIConnection) -> None:
        with suppress(engine.dialect.loaded_dbapi.Error):  # the server is gone
            connection.rollback()

    @event.listens_for(engine, "connect")
    def _opened(connection: DBAPIConnection, _: object) -> None:
        opened.add(connection)

    @event.listens_for(engine, "close")
    def _closed(connection: DBAPIConnection, _: object) -> None:
        opened.discard(connection)
        end_transaction(connection)

    @event.listens_for(engine, "engine_disposed")
    def _disposed(_: Engine) -> None:
        for connection in opened:
            end_transaction(connection)


def _open_to_write(path: Path, option: str, *, foreign_keys: bool) -> sqlite3.Connection:
    connection = _open_uri(path, option)
    try:
        _use_wal(connection, path)
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute(f"PRAGMA foreign_keys = {'ON' if foreign_keys else 'OFF'}")
    except BaseException:
        connection.close()
        raise
    return connection


def _use_wal(connection: sqlite3.Connection, path: Path) -> None:
    """Enable the write-ahead log; repeated, because this ignores the busy timeout."""
    deadline = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
            break
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > deadline:
                raise
            time.sleep(0.01)
    if mode != "wal":
        raise LogbookError(
            f"{path}: this file system cannot hold a SQLite logbook (journal mode {mode!r},"
            " expected 'wal'); use a local disk, or PostgreSQL"
        )


def checkpoint(path: Path) -> None:
    """Move the write-ahead log into the file, so that a copy of the file is complete.

    Closing the last connection does the same, but a reader may still be open. If a query is running
    or another process writes, the log remains.
    """
    with closing(sqlite3.connect(path, timeout=1.0, isolation_level=None)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()


def open_to_read(path: Path) -> sqlite3.Connection:
    """Open a read-only connection, also if the folder cannot be written."""
    try:
        return _open_read_only(path, "mode=ro")
    except sqlite3.OperationalError:
        # A reader of a WAL file creates a file beside it. If the folder is read-only and there is
        # no log, no process can be writing, and the file may be opened as immutable.
        log = path.with_name(path.name + "-wal")
        if os.access(path.parent, os.W_OK) or (log.exists() and log.stat().st_size > 0):
            raise
        return _open_read_only(path, "immutable=1")


def _open_read_only(path: Path, option: str) -> sqlite3.Connection:
    connection = _open_uri(path, option)
    try:
        connection.execute("PRAGMA query_only = ON")
        with closing(connection.execute("SELECT count(*) FROM sqlite_master")) as rows:
            rows.fetchone()  # SQLite opens the file at the first query
    except BaseException:
        connection.close()
        raise
    return connection


def _open_uri(path: Path, option: str) -> sqlite3.Connection:
    # isolation_level None: the BEGIN of the sqlite3 module is too late, and deferred.
    return sqlite3.connect(
        f"file:{quote(os.fsencode(path))}?{option}",
        uri=True,
        timeout=BUSY_TIMEOUT_S,
        isolation_level=None,
        check_same_thread=False,
    )


def _postgresql(address: Address, *, read_only: bool) -> Engine:
    # JIT compilation takes longer than any query of this package.
    options = str(address.url.query.get("options", "-c jit=off"))
    if read_only:
        options += " -c default_transaction_read_only=on"
    try:
        engine = create_engine(
            address.url,
            pool_pre_ping=True,
            json_serializer=_to_json,
            connect_args={
                "connect_timeout": CONNECT_TIMEOUT_S,
                "application_name": "seatrial",
                "options": options,
            },
            execution_options={"postgresql_readonly": True} if read_only else {},
        )
    except ImportError as error:
        raise LogbookError(
            f"{address}: PostgreSQL needs the package psycopg: pip install 'seatrial[postgresql]'"
        ) from error
    wait_for_server(engine)
    _release_locks(engine)
    return engine
