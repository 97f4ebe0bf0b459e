"""Creation of the tables of a logbook, and the check that this version can use them.

There is one schema. The table `seatrial_version` holds its number, and a logbook of another schema
is refused: the version of seatrial that wrote it exports it.
"""

import json
import os
from contextlib import suppress
from enum import Enum

from sqlalchemy import Connection
from sqlalchemy.exc import SQLAlchemyError

from seatrial.models.errors import LogbookError
from seatrial.runner.database import engine as engines
from seatrial.runner.database import views
from seatrial.runner.database.engine import ENVIRONMENT, Address
from seatrial.runner.database.outage import repeated
from seatrial.runner.database.tables import Base

VERSION_TABLE = "seatrial_version"
SCHEMA = "0005"
_LOCK = 0x5EA721A1  # key of PostgreSQL's advisory lock, the same in every version
_NAMES = {
    "sqlite": "SELECT name FROM sqlite_master WHERE type IN ('table', 'view')"
    " AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\'",
    "postgresql": "SELECT relname FROM pg_class WHERE relkind IN ('r', 'p', 'v', 'm', 'f')"
    " AND relnamespace = current_schema()::regnamespace",
}
_NEWEST = "SELECT CAST(versions AS TEXT), git_commit FROM run ORDER BY id DESC LIMIT 1"


class SchemaState(Enum):
    """The state of a database that is empty or a logbook of this schema."""

    EMPTY = "empty"
    OTHER_VIEWS = "other views"  # of another catalogue of metrics; a writer renews them
    CURRENT = "current"


def prepare(address: Address, *, create: bool) -> None:
    """Create the logbook at `address` if there is none, and renew its views if they are others.

    Args:
        address: Where the logbook is or will be.
        create: Whether a missing logbook is created.

    Raises:
        LogbookError: The database belongs to another program, has another schema, is damaged or
            cannot be reached; or it is missing and is not to be created. Nothing was changed.
    """
    state = inspect(address)
    if state is SchemaState.CURRENT:
        return
    if state is SchemaState.EMPTY:
        if not create:
            raise _missing(address)
        if address.path is not None:
            try:
                address.path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                reason = f"cannot create the folder: {error.strerror}"
                raise LogbookError(f"{address}: {reason}") from error
    engine = engines.writer(address, create=True)
    try:
        with engines.explained(address), engine.begin() as connection:
            if address.path is None:
                connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK})")
            state = _condition(connection, address)  # another process may have been faster
            if state is SchemaState.EMPTY:
                Base.metadata.create_all(connection, checkfirst=False)
                connection.exec_driver_sql(f"CREATE TABLE {VERSION_TABLE} (version_num TEXT)")
                connection.exec_driver_sql(f"INSERT INTO {VERSION_TABLE} VALUES ('{SCHEMA}')")
            if state is not SchemaState.CURRENT:
                views.renew(connection)
    finally:
        engine.dispose()


def require_current(address: Address) -> None:
    """Raise LogbookError unless a logbook of this schema can be read at `address`."""
    if inspect(address) is SchemaState.EMPTY:
        raise _missing(address)


def inspect(address: Address) -> SchemaState:
    """Return the state of the database at `address`; raises LogbookError if it cannot be used."""
    if address.path is not None:
        try:
            if not address.path.exists():
                return SchemaState.EMPTY
            if not address.path.is_file():
                raise LogbookError(f"{address}: got a folder, expected a SQLite file")
            if not address.path.stat().st_size:
                return SchemaState.EMPTY
        except OSError as error:  # a name that is too long, a folder that cannot be read
            raise LogbookError(f"{address}: cannot be opened: {error.strerror}") from error
    engine = engines.reader(address)

    def state() -> SchemaState:
        with engine.connect() as connection:
            return _condition(connection, address)

    try:
        with engines.explained(address):
            return repeated(address, state)
    finally:
        engine.dispose()


def _condition(connection: Connection, address: Address) -> SchemaState:
    query = connection.exec_driver_sql
    dialect = connection.dialect.name
    names = set(query(_NAMES[dialect]).scalars())
    if not names:
        return SchemaState.EMPTY
    if VERSION_TABLE not in names:
        raise LogbookError(
            f"{address}: not a seatrial logbook (it holds {', '.join(sorted(names)[:5])});"
            " expected one, or an empty database; nothing was changed"
        )
    numbers = list(query(f"SELECT version_num FROM {VERSION_TABLE}").scalars())
    if numbers != [SCHEMA]:
        raise LogbookError(
            f"{address}: written by seatrial {_writer(connection)} with schema"
            f" {', '.join(map(str, numbers)) or 'unknown'}, expected schema {SCHEMA}: install that"
            " version and run its 'seatrial-results export'"
        )
    if not set(views.NAMES) <= names:
        return SchemaState.OTHER_VIEWS
    current = query("SELECT digest FROM view_version").scalar() == views.digest(dialect)
    return SchemaState.CURRENT if current else SchemaState.OTHER_VIEWS


def _writer(connection: Connection) -> str:
    """Return the version of seatrial that wrote the newest run of a logbook of any schema."""
    with suppress(SQLAlchemyError, ValueError, AttributeError):
        row = connection.exec_driver_sql(_NEWEST).one_or_none()
        if row is not None:
            version = json.loads(row[0]).get("seatrial", "of an unknown version")
            return f"{version} (commit {row[1][:12]})" if row[1] else str(version)
    return "of an unknown version"


def _missing(address: Address) -> LogbookError:
    other = f", or --database {ENVIRONMENT}" if os.environ.get(ENVIRONMENT) else ""
    return LogbookError(f"{address}: there is no logbook; expected one created by a run{other}")
