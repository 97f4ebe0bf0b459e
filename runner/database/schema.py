"""Creation and upgrade of the database schema.

The table `seatrial_version` holds the revision; it is Alembic's version table under a name that no
other program uses. Checking an existing logbook takes one query; Alembic is imported only for an
upgrade.
"""

import logging
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from datetime import UTC, datetime
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine

from seatrial.models.errors import LogbookError
from seatrial.runner.database import engine as engines
from seatrial.runner.database import series_files as files
from seatrial.runner.database import views
from seatrial.runner.database.engine import Address
from seatrial.runner.database.outage import repeated
from seatrial.runner.database.tables import Base

VERSION_TABLE = "seatrial_version"
REVISIONS = ("0001", "0002", "0003")  # oldest first; a test keeps them equal to the migrations
HEAD = REVISIONS[-1]
_log = logging.getLogger(__name__)
_LOCK = 0x5EA721A1  # key of PostgreSQL's advisory lock, the same in every version
_MAKE_VERSION_TABLE = (
    f"CREATE TABLE {VERSION_TABLE} (version_num VARCHAR(32) NOT NULL,"
    f" CONSTRAINT {VERSION_TABLE}_pkc PRIMARY KEY (version_num))"
)
_NAMES = {
    "sqlite": "SELECT name FROM sqlite_master WHERE type IN ('table', 'view')"
    " AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\'",
    "postgresql": "SELECT relname FROM pg_class WHERE relkind IN ('r', 'p', 'v', 'm', 'f')"
    " AND relnamespace = current_schema()::regnamespace",
}


class Condition(Enum):
    """The state of a database; a newer one, or one of another program, is an error."""

    EMPTY = "empty"
    OLDER = "older"
    OTHER_VIEWS = "other views"
    CURRENT = "current"


def prepare(address: Address, *, create: bool, results_dir: Path | None = None) -> None:
    """Create or upgrade the logbook at `address`, so that it has the schema of this version.

    Raises LogbookError, and changes nothing, if the database belongs to another program, has a
    newer version, is damaged or cannot be reached; if it is missing and `create` is False; and if
    it is missing but `results_dir` holds series files.
    """
    state = inspect(address)
    if state is Condition.CURRENT:
        return
    if state is Condition.EMPTY and not create:
        raise _missing(address)
    if state is Condition.EMPTY and results_dir is not None:
        _require_no_series(address, results_dir)
    if address.path is not None:
        _make_folder(address.path)
    _bring_up_to_date(address)


def require_current(address: Address) -> None:
    """Raise LogbookError unless a logbook of this version can be read at `address`."""
    state = inspect(address)
    if state is Condition.EMPTY:
        raise _missing(address)
    if state is Condition.OLDER:
        raise LogbookError(
            f"{address}: of an older version of seatrial than this one (schema {HEAD});"
            " the next run upgrades it and keeps a backup"
        )


def inspect(address: Address) -> Condition:
    """Return the state of the database at `address`, over a read-only connection."""
    if address.path is not None and _is_absent(address.path):
        return Condition.EMPTY
    engine = engines.reader(address)
    try:
        with engines.explained(address):
            return repeated(partial(_condition, engine, address))
    finally:
        engine.dispose()


def _is_absent(path: Path) -> bool:
    """Return whether there is no file, or an empty one."""
    try:
        if not path.exists():
            return True
        if not path.is_file():
            raise LogbookError(f"{path}: got a folder, expected a SQLite file")
        return not path.stat().st_size
    except OSError as error:  # a name that is too long, a folder that cannot be read
        raise LogbookError(f"{path}: cannot be opened: {error.strerror}") from error


def _condition(engine: Engine, address: Address) -> Condition:
    with engine.connect() as connection:
        return condition(connection, address)


def condition(connection: Connection, address: Address) -> Condition:
    """Return the state of a database; raises LogbookError if this version cannot use it."""
    dialect = connection.dialect.name
    names = set(connection.exec_driver_sql(_NAMES[dialect]).scalars())
    if not names:
        return Condition.EMPTY
    if VERSION_TABLE not in names:
        listing = ", ".join(sorted(names)[:5])
        raise LogbookError(
            f"{address}: not a seatrial logbook (it holds {listing}); expected one, or an empty"
            " database; nothing was changed"
        )
    revisions = connection.exec_driver_sql(f"SELECT version_num FROM {VERSION_TABLE}").scalars()
    revision = _only(list(revisions), address)
    if revision not in REVISIONS:
        raise LogbookError(
            f"{address}: of a newer version of seatrial: got schema {revision}, this version"
            f" knows up to {HEAD}; update seatrial; nothing was changed"
        )
    if revision != HEAD:
        return Condition.OLDER
    if not set(views.NAMES) <= names:
        return Condition.OTHER_VIEWS
    digest = connection.exec_driver_sql("SELECT digest FROM view_version").scalar()
    return Condition.CURRENT if digest == views.digest(dialect) else Condition.OTHER_VIEWS


def _only(revisions: Sequence[Any], address: Address) -> Any:
    if len(revisions) != 1:
        listing = f" ({', '.join(map(str, revisions[:5]))})" if revisions else ""
        raise LogbookError(
            f"{address}: damaged: got {len(revisions)} rows{listing} in {VERSION_TABLE},"
            " expected 1; nothing was changed"
        )
    return revisions[0]


def _bring_up_to_date(address: Address) -> None:
    """Create or upgrade the schema and the views in one transaction, under a lock."""
    engine = engines.maker(address)
    try:
        with engines.explained(address), engine.begin() as connection:
            if not address.sqlite:
                connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK})")
            match condition(connection, address):
                case Condition.EMPTY:
                    create_all(connection)
                case Condition.OLDER:
                    _upgrade(connection, address)
                case Condition.OTHER_VIEWS:
                    views.drop(connection)
                    views.create(connection)
    finally:
        engine.dispose()


def create_all(connection: Connection) -> None:
    """Create the schema; the result equals that of all migrations."""
    Base.metadata.create_all(connection, checkfirst=False)
    connection.exec_driver_sql(_MAKE_VERSION_TABLE)
    connection.exec_driver_sql(f"INSERT INTO {VERSION_TABLE} VALUES ('{HEAD}')")
    views.create(connection)


def _upgrade(connection: Connection, address: Address) -> None:
    if address.path is not None:
        copy = _backup_name(connection, address.path)
        backup(address.path, copy)
        _log.info("%s: upgrading to schema %s; the backup is %s", address, HEAD, copy)
    views.drop(connection)
    migrate(connection, HEAD)
    if address.sqlite and (broken := connection.exec_driver_sql("PRAGMA foreign_key_check").all()):
        raise LogbookError(f"{address}: cannot be upgraded: {len(broken)} rows refer to no run")
    views.create(connection)


def migrate(connection: Connection, revision: str) -> None:
    """Run the migrations up to `revision` in the transaction of `connection`."""
    from alembic import command  # slow to import
    from alembic import config as alembic_config

    config = alembic_config.Config()
    config.set_main_option("script_location", str(Path(__file__).with_name("migrations")))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    command.upgrade(config, revision)


def _backup_name(connection: Connection, path: Path) -> Path:
    revision = connection.exec_driver_sql(f"SELECT version_num FROM {VERSION_TABLE}").scalar()
    moment = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    return path.with_name(f"{path.stem}-schema-{revision}-{moment}{path.suffix}")


def backup(path: Path, to: Path) -> None:
    """Copy the SQLite database at `path` to a new file `to`; others may read it meanwhile."""
    try:
        with (
            closing(engines.open_to_read(path)) as source,
            closing(sqlite3.connect(to, isolation_level=None)) as target,
        ):
            source.backup(target)
            target.execute("PRAGMA journal_mode = DELETE")  # one file, without a write-ahead log
    except BaseException:
        to.unlink(missing_ok=True)
        raise


def _make_folder(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogbookError(f"{path}: cannot create the folder: {error.strerror}") from error


def _require_no_series(address: Address, results_dir: Path) -> None:
    series = [path for path in files.listed(results_dir) if files.owner(path)]
    # Checked again: another process may have created the logbook and a run in between.
    if series and inspect(address) is Condition.EMPTY:
        raise LogbookError(
            f"{address}: there is no logbook here, but {results_dir / files.FOLDER} holds"
            f" {len(series)} series files of one; expected its database, or another results_dir;"
            " nothing was changed"
        )


def _missing(address: Address) -> LogbookError:
    return LogbookError(f"{address}: there is no logbook here; expected one that a run has created")
