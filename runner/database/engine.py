"""Connections: one writer at a time on SQLite, and readers that cannot write.

Every writer's transaction on SQLite starts with BEGIN IMMEDIATE: a deferred one that reads before
it writes fails with "database is locked" as soon as another process has written in between, and
no timeout helps. Readers have an engine of their own with plain BEGIN, on a connection that is
opened read-only.
"""

import json
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine import URL, make_url
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

# Database URLs: what may be asked for, and how they are shown without their password.


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
        """How it is named to people: the file, or the URL without its password."""
        return str(self.path or display_url(self.url.set(drivername="postgresql")))


def parse(url: str | URL) -> Address:
    """The address that `url` names; LogbookError where it names none."""
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
        learn(url.render_as_string(hide_password=False))
        return url
    learn(str(url))
    parsed = make_url(url)
    if parsed.get_backend_name() == "sqlite" and "?" in url:  # SQLAlchemy drops "?x" silently
        _refuse_sqlite(url)
    return parsed


def file_url(path: Path) -> str:
    """The URL of a SQLite file, whatever its name holds; no more is escaped than must be."""
    escaped = str(path).replace("%", "%25").replace("?", "%3F")
    return f"sqlite:///{escaped}"


def _refuse_sqlite(url: str | URL) -> NoReturn:
    raise LogbookError(
        f"database.url: got {display_url(url)}; expected sqlite:///FILE"
        " (a file of its own, without options; % and ? in its name are %25 and %3F)"
    )


def _sqlite_file(url: URL) -> Path:
    if url.host or url.query or not url.database or url.database == ":memory:":
        _refuse_sqlite(url)
    return Path(url.database).absolute()


def display_url(url: str | URL) -> str:
    """`url` with every password replaced by three stars."""
    if isinstance(url, URL):
        return without_passwords(url.render_as_string(hide_password=True))
    learn(str(url))
    return without_passwords(str(url))


BUSY_TIMEOUT_S = 30.0
CONNECT_TIMEOUT_S = 10
_to_json = partial(json.dumps, allow_nan=False, ensure_ascii=False)


def writer(address: Address) -> Engine:
    """An engine whose every transaction may write; a file that has gone is not made anew."""
    return _writer(address, "mode=rw", foreign_keys=True)


def maker(address: Address) -> Engine:
    """A writer that makes a missing file, and rebuilds tables: foreign keys are not enforced."""
    return _writer(address, "mode=rwc", foreign_keys=False)


def _writer(address: Address, option: str, *, foreign_keys: bool) -> Engine:
    if address.path is None:
        return _postgresql(address, read_only=False)
    connect = partial(_open_to_write, address.path, option, foreign_keys=foreign_keys)
    return _sqlite(connect, "BEGIN IMMEDIATE")


def reader(address: Address) -> Engine:
    """An engine that the database itself keeps from writing."""
    if address.path is None:
        return _postgresql(address, read_only=True)
    return _sqlite(partial(open_to_read, address.path), "BEGIN")


@contextmanager
def explained(address: Address) -> Iterator[None]:
    """Turn what the database complains about into one LogbookError line.

    What can only be a mistake of the caller (a row that breaks a constraint, SQL that does not
    parse) stays as it is.
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
    """The first line of what the database said, without passwords."""
    said = str(error.orig if isinstance(error, DBAPIError) else error).strip()
    first = without_passwords(said.splitlines()[0]) if said else type(error).__name__
    return first.replace("unable to open database file", "cannot open the database file")


def _sqlite(connect: Any, begin: str) -> Engine:
    engine = create_engine(
        "sqlite://", creator=connect, poolclass=QueuePool, json_serializer=_to_json
    )

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        connection.exec_driver_sql(begin)

    return engine


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
    """Write-ahead log; the change itself does not heed the busy timeout, so it is repeated."""
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
    """Move what is in the write-ahead log into the file, so that a copy of the file is whole.

    Closing the last connection does so by itself, but a reader may still be open; where one is in
    the middle of a query, or another process writes, the log is left to them.
    """
    with closing(sqlite3.connect(path, timeout=1.0, isolation_level=None)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()


def open_to_read(path: Path) -> sqlite3.Connection:
    """A connection that cannot write, also where the folder cannot be written."""
    try:
        return _open_read_only(path, "mode=ro")
    except sqlite3.OperationalError:
        # A reader of a WAL file makes a file beside it. Where it may not, and no log is waiting
        # to be read, nobody can be writing either, and the file can be taken as it stands.
        log = path.with_name(path.name + "-wal")
        if os.access(path.parent, os.W_OK) or (log.exists() and log.stat().st_size > 0):
            raise
        return _open_read_only(path, "immutable=1")


def _open_read_only(path: Path, option: str) -> sqlite3.Connection:
    connection = _open_uri(path, option)
    try:
        connection.execute("PRAGMA query_only = ON")
        with closing(connection.execute("SELECT count(*) FROM sqlite_master")) as rows:
            rows.fetchone()  # the file is opened only now
    except BaseException:
        connection.close()
        raise
    return connection


def _open_uri(path: Path, option: str) -> sqlite3.Connection:
    # isolation_level None: Python's own BEGIN would come too late, and deferred.
    return sqlite3.connect(
        f"file:{quote(str(path))}?{option}",
        uri=True,
        timeout=BUSY_TIMEOUT_S,
        isolation_level=None,
        check_same_thread=False,
    )


def _postgresql(address: Address, *, read_only: bool) -> Engine:
    try:
        import psycopg  # noqa: F401 - an extra, and slow to import
    except ImportError as error:
        raise LogbookError(
            f"{address}: PostgreSQL needs the package psycopg: pip install 'seatrial[postgresql]'"
        ) from error
    # Compiling a query takes longer than answering any of ours.
    options = {} if "options" in address.url.query else {"options": "-c jit=off"}
    engine = create_engine(
        address.url,
        pool_pre_ping=True,
        json_serializer=_to_json,
        connect_args={
            "connect_timeout": CONNECT_TIMEOUT_S,
            "application_name": "seatrial",
            **options,
        },
        execution_options={"postgresql_readonly": True} if read_only else {},
    )
    wait_for_server(engine)
    return engine
