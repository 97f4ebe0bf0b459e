"""Removal of addresses and passwords from rows that older versions wrote.

Only cells that contain `@` or `password` are read, because a logbook may be large.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing

from sqlalchemy import JSON, Connection, Text, cast, or_, select, update

from seatrial.runner.database import engine as engines
from seatrial.runner.database.claims import clean
from seatrial.runner.database.engine import Address
from seatrial.runner.database.mask import command_without_address, without_address
from seatrial.runner.database.records import Problem
from seatrial.runner.database.tables import Base, Run, Sweep

_TABLES: tuple[type[Base], ...] = (Sweep, Run)


def stored_passwords(connection: Connection) -> list[Problem]:
    """List the cells that contain a password."""
    return [
        Problem(f"{table.__tablename__} {key}", f"a password is stored in {', '.join(cells)}")
        for table, key, cells in _rows_with_password(connection)
    ]


def scrub(connection: Connection) -> int:
    """Rewrite the rows that contain a password; returns their number."""
    rows = list(_rows_with_password(connection))
    for table, key, cells in rows:
        statement = update(table).where(table.__table__.c.id == key)
        connection.execute(statement.values(cells))
    return len(rows)


def reclaim(address: Address) -> None:
    """Make the database overwrite freed space: deleted text remains in its files until then."""
    if address.path is not None:
        with closing(sqlite3.connect(address.path, isolation_level=None)) as connection:
            connection.execute("VACUUM")
        engines.checkpoint(address.path)
        return
    engine = engines.maker(address).execution_options(isolation_level="AUTOCOMMIT")
    try:
        with engine.connect() as connection:
            for table in _TABLES:
                connection.exec_driver_sql(f"VACUUM FULL {table.__tablename__}")
    finally:
        engine.dispose()


def _rows_with_password(
    connection: Connection,
) -> Iterator[tuple[type[Base], int, dict[str, object]]]:
    """Yield each row with a password: its table, its id, and its corrected cells."""
    for table in _TABLES:
        columns = [column for column in table.__table__.c if isinstance(column.type, JSON | Text)]
        patterns = ("%@%", "%password%", "%PASSWORD%")
        suspect = [cast(column, Text).like(pattern) for column in columns for pattern in patterns]
        rows = connection.execute(select(table.__table__.c.id, *columns).where(or_(*suspect)))
        for key, *values in map(tuple, rows.all()):
            pairs = zip((column.name for column in columns), values, strict=True)
            cells = {
                name: _scrubbed(name, value)
                for name, value in pairs
                if value is not None and clean(value) != value
            }
            if cells:
                yield table, key, cells


def _scrubbed(name: str, value: object) -> object:
    if name == "overrides" and isinstance(value, list):
        return clean(without_address(value))
    if name == "command" and isinstance(value, str):
        return command_without_address(value)
    return clean(value)
