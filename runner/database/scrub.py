"""Addresses and their passwords in rows that older versions wrote: found, and removed.

Only cells that hold `@` or `password` are read, so that a large logbook is not read whole.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from typing import Any

from sqlalchemy import JSON, Connection, Text, cast, or_, select, update

from seatrial.runner.database import engine as engines
from seatrial.runner.database.claims import clean
from seatrial.runner.database.engine import Address
from seatrial.runner.database.mask import command_without_address, without_address
from seatrial.runner.database.records import Problem
from seatrial.runner.database.tables import Base, Run, Sweep

_TABLES: tuple[type[Base], ...] = (Sweep, Run)


def stored_passwords(connection: Connection) -> list[Problem]:
    """The cells that hold a password."""
    return [
        Problem(f"{table.__tablename__} {key}", f"a password is stored in {', '.join(cells)}")
        for table, key, cells in _found(connection)
    ]


def scrub(connection: Connection) -> int:
    """Rewrite the rows that hold a password as they would be stored today; how many there were."""
    found = list(_found(connection))
    for table, key, cells in found:
        statement = update(table).where(table.__table__.c.id == key)
        connection.execute(statement.values(cells))
    return len(found)


def reclaim(address: Address) -> None:
    """Have the database overwrite what it has freed: deleted text stays in its files until then."""
    if address.path is not None:
        with closing(sqlite3.connect(address.path, isolation_level=None)) as plain:
            plain.execute("VACUUM")
        engines.checkpoint(address.path)
        return
    engine = engines.maker(address).execution_options(isolation_level="AUTOCOMMIT")
    try:
        with engine.connect() as connection:
            for table in _TABLES:
                connection.exec_driver_sql(f"VACUUM FULL {table.__tablename__}")
    finally:
        engine.dispose()


def _found(connection: Connection) -> Iterator[tuple[type[Base], int, dict[str, Any]]]:
    """Each row with a password: its table, its id, and its cells as they should be."""
    for table in _TABLES:
        columns = [one for one in table.__table__.c if isinstance(one.type, JSON | Text)]
        signs = ("%@%", "%password%", "%PASSWORD%")
        suspect = [cast(one, Text).like(sign) for one in columns for sign in signs]
        rows = connection.execute(select(table.__table__.c.id, *columns).where(or_(*suspect)))
        for key, *values in map(tuple, rows.all()):
            named = zip((one.name for one in columns), values, strict=True)
            cells = {
                name: _scrubbed(name, value)
                for name, value in named
                if value is not None and clean(value) != value
            }
            if cells:
                yield table, key, cells


def _scrubbed(name: str, value: Any) -> Any:
    if name == "overrides":
        return clean(without_address(value))
    return command_without_address(value) if name == "command" else clean(value)
