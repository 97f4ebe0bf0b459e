"""The schema's life: made on the first start, upgraded with a backup, refused where it is not ours.

The revision stands in the table `seatrial_version` (Alembic's, under a name that no other program
uses). Whether an existing logbook is up to date is one query; Alembic is imported only to upgrade.
"""

import logging
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from enum import Enum
from functools import partial
from pathlib import Path

from sqlalchemy import Connection, Engine

from seatrial.models.errors import LogbookError
from seatrial.runner.database import engine as engines
from seatrial.runner.database import series_files as files
from seatrial.runner.database import views
from seatrial.runner.database.engine import Address
from seatrial.runner.database.outage import repeated
from seatrial.runner.database.tables import Base

VERSION_TABLE = "seatrial_version"
REVISIONS = ("0001", "0002")  # oldest first; a test keeps them equal to the migrations
HEAD = REVISIONS[-1]
_log = logging.getLogger(__name__)
_LOCK = 0x5EA721A1  # any number that all of us, and nobody else, use for PostgreSQL's advisory lock
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
    """What a database was found to be; one that is newer or not ours is an error instead."""

    EMPTY = "empty"
    OLDER = "older"
    OTHER_VIEWS = "other views"
    CURRENT = "current"


def prepare(address: Address, *, create: bool, results_dir: Path | None = None) -> None:
    """Make sure that a logbook of this version is at `address`: make it, or upgrade it.

    Raises LogbookError, and changes nothing, where the database is not ours, of a newer version,
    damaged or out of reach, where it is missing and not to be made, and where it is missing but
    its series, or another's, are in `results_dir`.
    """
    found = inspect(address)
    if found is Condition.CURRENT:
        return
    if found is Condition.EMPTY and not create:
        raise _missing(address)
    if found is Condition.EMPTY and results_dir is not None:
        _require_no_series(address, results_dir)
    if address.path is not None:
        _make_folder(address.path)
    _bring_up_to_date(address)


def require_current(address: Address) -> None:
    """Raise LogbookError unless a logbook of this version can be read at `address`."""
    found = inspect(address)
    if found is Condition.EMPTY:
        raise _missing(address)
    if found is Condition.OLDER:
        raise LogbookError(
            f"{address}: of an older version of seatrial than this one (schema {HEAD});"
            " the next run upgrades it, and keeps a backup"
        )


def inspect(address: Address) -> Condition:
    """What is at `address`, found out without any way to change it."""
    if address.path is not None:
        if not address.path.exists():
            return Condition.EMPTY
        if not address.path.is_file():
            raise LogbookError(f"{address}: got a folder, expected a SQLite file")
        if not address.path.stat().st_size:
            return Condition.EMPTY  # zero bytes are no logbook
    engine = engines.reader(address)
    try:
        with engines.explained(address):
            return repeated(partial(_condition, engine, address))
    finally:
        engine.dispose()


def _condition(engine: Engine, address: Address) -> Condition:
    with engine.connect() as connection:
        return condition(connection, address)


def condition(connection: Connection, address: Address) -> Condition:
    """What the database behind `connection` is; LogbookError where it is not for us."""
    dialect = connection.dialect.name
    names = set(connection.exec_driver_sql(_NAMES[dialect]).scalars())
    if not names:
        return Condition.EMPTY
    if VERSION_TABLE not in names:
        some = ", ".join(sorted(names)[:5])
        raise LogbookError(
            f"{address}: not a seatrial logbook (it holds {some}); expected one, or an empty"
            " database; nothing was changed"
        )
    revision = connection.exec_driver_sql(f"SELECT version_num FROM {VERSION_TABLE}").scalar()
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


def _bring_up_to_date(address: Address) -> None:
    """Create, upgrade or renew the views in one transaction, after a second look under its lock."""
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
    """The whole schema at once; equal to running every migration."""
    Base.metadata.create_all(connection, checkfirst=False)
    connection.exec_driver_sql(_MAKE_VERSION_TABLE)
    connection.exec_driver_sql(f"INSERT INTO {VERSION_TABLE} VALUES ('{HEAD}')")
    views.create(connection)


def _upgrade(connection: Connection, address: Address) -> None:
    if address.path is not None:
        copy = _backup_name(connection, address.path)
        backup(address.path, copy)
        _log.info("%s: upgrading to schema %s; as it was, it is in %s", address, HEAD, copy)
    views.drop(connection)
    migrate(connection, HEAD)
    if address.sqlite and (broken := connection.exec_driver_sql("PRAGMA foreign_key_check").all()):
        raise LogbookError(f"{address}: cannot be upgraded: {len(broken)} rows point to no run")
    views.create(connection)


def migrate(connection: Connection, revision: str) -> None:
    """Run the migrations up to `revision` in the transaction of `connection`."""
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).with_name("migrations")))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    command.upgrade(config, revision)


def _backup_name(connection: Connection, path: Path) -> Path:
    revision = connection.exec_driver_sql(f"SELECT version_num FROM {VERSION_TABLE}").scalar()
    moment = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    return path.with_name(f"{path.stem}-schema-{revision}-{moment}{path.suffix}")


def backup(path: Path, to: Path) -> None:
    """Copy the SQLite database at `path` to a new file `to`, whole, while others may read it."""
    try:
        with (
            closing(engines.open_to_read(path)) as source,
            closing(sqlite3.connect(to, isolation_level=None)) as target,
        ):
            source.backup(target)
            target.execute("PRAGMA journal_mode = DELETE")  # one file, without a log beside it
    except BaseException:
        to.unlink(missing_ok=True)
        raise


def _make_folder(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogbookError(f"{path}: cannot make the folder: {error.strerror}") from error


def _require_no_series(address: Address, results_dir: Path) -> None:
    others = [path for path in files.listed(results_dir) if files.owner(path)]
    # Looked at again, because another process may have made the logbook in between, and a run.
    if others and inspect(address) is Condition.EMPTY:
        raise LogbookError(
            f"{address}: there is no logbook here, but {results_dir / files.FOLDER} holds"
            f" {len(others)} series files of one; expected its database, or another results_dir;"
            " nothing was changed"
        )


def _missing(address: Address) -> LogbookError:
    return LogbookError(f"{address}: there is no logbook here; expected one that a run has made")
