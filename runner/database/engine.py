"""Connections to the database: one writer at a time on SQLite, and read-only readers.

Every write transaction on SQLite starts with BEGIN IMMEDIATE: a deferred transaction that reads
before it writes fails with "database is locked" if another process has written in between, and no
timeout prevents this. Readers have their own engine with plain BEGIN, on a read-only connection.
"""

import json
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
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
from tenacity import retry, retry_if_exception_message, stop_after_delay, wait_fixed

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.database.terminal import refuse_passwords

ENVIRONMENT = "SEATRIAL_DATABASE"  # variable with an address, which may hold a password


@dataclass(frozen=True)
class Address:
    """Where a logbook is: a SQLite file (`path`) or a PostgreSQL database (`path` is None)."""

    url: URL
    path: Path | None

    @property
    def dialect(self) -> str:
        """`sqlite` or `postgresql`."""
        return "postgresql" if self.path is None else "sqlite"

    def __str__(self) -> str:
        """The file, or the URL without its password, for messages."""
        return str(self.path or self.url.set(drivername="postgresql"))


def parse(url: str | URL) -> Address:
    """Parse the address of a logbook.

    Args:
        url: A URL; or ENVIRONMENT, for the address in this variable. Only there a password may be,
            so configurations, commands and messages hold the name of the variable instead.

    Raises:
        ConfigurationError: The URL is text with a password.
        LogbookError: It is no address of a SQLite file or of a PostgreSQL database.
    """
    where, got = "database.url", f" got {str(url)!r};"
    if url == ENVIRONMENT:
        where, got, url = ENVIRONMENT, "", os.environ.get(ENVIRONMENT, "")
        if not url:
            raise LogbookError(f"{where} is not set; expected postgresql://USER@HOST/NAME")
    elif isinstance(url, str):
        refuse_passwords([url])
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError, TypeError):
        raise LogbookError(
            f"{where} is not a database URL:{got}"
            " expected sqlite:///FILE or postgresql://USER@HOST/NAME"
        ) from None
    dialect = parsed.get_backend_name()
    if dialect == "sqlite":
        options = parsed.query or (isinstance(url, str) and "?" in url)  # make_url drops "?x"
        if parsed.host or options or parsed.database in (None, "", ":memory:"):
            raise LogbookError(
                f"{where}: got {url}; expected sqlite:///FILE"
                " (a file without options; write % and ? in its name as %25 and %3F)"
            )
        return Address(parsed, Path(parsed.database or "").absolute())
    if dialect not in ("postgresql", "postgres"):
        raise LogbookError(
            f"{where}: unknown database dialect {dialect!r} in {parsed};"
            " expected sqlite or postgresql"
        )
    if {"password", "sslpassword"} & set(parsed.query):
        raise LogbookError(f"{where}: got a password after '?', expected //USER:PASSWORD@HOST/NAME")
    return Address(parsed.set(drivername="postgresql+psycopg"), None)


def url_of(place: str | Path) -> str:
    """Return the address of a logbook that is given by its address, its file, or ENVIRONMENT.

    Raises ConfigurationError for anything that is neither text nor a path.
    """
    if not isinstance(place, str | Path):
        raise ConfigurationError(f"database: got {place!r}, expected a file or an address")
    text = str(place)
    return text if "://" in text or text == ENVIRONMENT else file_url(Path(text))


def file_url(path: Path) -> str:
    """Return the URL of a SQLite file; only % and ? in its path are escaped."""
    escaped = str(path).replace("%", "%25").replace("?", "%3F")
    return f"sqlite:///{escaped}"


def display_url(url: str) -> str:
    """Return an address as it was given; that in ENVIRONMENT without its password."""
    return str(parse(url)) if url == ENVIRONMENT else url


BUSY_TIMEOUT_S = 30.0
CONNECT_TIMEOUT_S = 10
_to_json = partial(json.dumps, allow_nan=False, ensure_ascii=False)


def writer(address: Address, *, create: bool = False) -> Engine:
    """Create an engine for writing; with `create` it creates a missing SQLite file."""
    if address.path is None:
        return _postgresql(address, read_only=False)
    return _sqlite(partial(_open_to_write, address.path, create), "BEGIN IMMEDIATE")


def reader(address: Address) -> Engine:
    """Create an engine whose connections the database itself makes read-only."""
    if address.path is None:
        return _postgresql(address, read_only=True)
    return _sqlite(partial(_open_to_read, address.path), "BEGIN")


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
    except (DBAPIError, sqlite3.Error) as error:
        if isinstance(error, ProgrammingError) and "permission denied" not in str(error.orig):
            raise
        raise LogbookError(f"{address}: {one_line(error)}") from error


def one_line(error: Exception) -> str:
    """Return the first line of a database error."""
    message = str(error.orig if isinstance(error, DBAPIError) else error).strip()
    first = message.splitlines()[0] if message else type(error).__name__
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

    def end_transaction(connection: DBAPIConnection, _: object = None) -> None:
        with suppress(engine.dialect.loaded_dbapi.Error):  # closed, or the server is gone
            connection.rollback()

    event.listen(engine, "connect", lambda connection, _: opened.add(connection))
    event.listen(engine, "close", end_transaction)
    event.listen(engine, "close", lambda connection, _: opened.discard(connection))
    event.listen(engine, "engine_disposed", lambda _: [*map(end_transaction, opened)])


def _open_to_write(path: Path, create: bool) -> sqlite3.Connection:
    connection = _open(path, "mode=rwc" if create else "mode=rw")
    try:
        _use_wal(connection, path)
    except BaseException:
        connection.close()
        raise
    connection.execute("PRAGMA synchronous = NORMAL")
    connection.execute("PRAGMA foreign_keys = ON")
    return connection


@retry(
    retry=retry_if_exception_message(match=".*locked"),
    wait=wait_fixed(0.01),
    stop=stop_after_delay(BUSY_TIMEOUT_S),
    reraise=True,
)
def _use_wal(connection: sqlite3.Connection, path: Path) -> None:
    """Enable the write-ahead log; repeated, because this ignores the busy timeout."""
    (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
    if mode != "wal":
        raise LogbookError(
            f"{path}: this file system cannot hold a SQLite logbook (journal mode {mode!r},"
            " expected 'wal'); use a local disk, or PostgreSQL"
        )


def checkpoint(path: Path) -> None:
    """Move the write-ahead log into the file, so that a copy of the file alone is complete.

    Closing the last connection does the same, but a reader may still be open.
    """
    with closing(sqlite3.connect(path, timeout=1.0, isolation_level=None)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()


def _open_to_read(path: Path) -> sqlite3.Connection:
    """Open a read-only connection, also if the folder cannot be written."""
    # A reader of a WAL file creates a file beside it. If the folder is read-only and the log is
    # empty, no process is writing, and the file may be opened as immutable.
    log = path.with_name(path.name + "-wal")
    has_log = log.exists() and log.stat().st_size > 0
    is_sealed = not has_log and not os.access(path.parent, os.W_OK)
    connection = _open(path, "immutable=1" if is_sealed else "mode=ro")
    connection.execute("PRAGMA query_only = ON")
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)  # ATTACH would create a file
    return connection


def _open(path: Path, option: str) -> sqlite3.Connection:
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
    _release_locks(engine)
    return engine
