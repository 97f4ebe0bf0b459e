"""Cells that do not hold what their column declares.

SQLite stores any value in any column, and any program may write to a logbook. A damaged cell is an
error where it is read, so that no result is computed from it; `damaged_cells` lists all of them.
"""

import json
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any, TypeVarTuple

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    ColumnElement,
    Connection,
    CursorResult,
    Float,
    Integer,
    Row,
    Table,
)

from seatrial.models.errors import LogbookError
from seatrial.runner.database.records import Problem
from seatrial.runner.database.tables import Base, Run, Utc
from seatrial.runner.database.terminal import shortened

UNREADABLE = (ValueError, TypeError, RecursionError)  # of the conversion of a cell
_LISTED = 20  # damaged cells of one column
_LISTS = ("overrides", "tags", "drawn")


Columns = TypeVarTuple("Columns")


class DamagedCellError(LogbookError):
    """A cell that does not hold what its column declares."""


def read(
    columns: Iterable[ColumnElement[object]], result: CursorResult[*Columns]
) -> Sequence[Row[*Columns]]:
    """Return the rows of a result; raises DamagedCellError unless all cells have their types."""
    try:
        rows = result.all()
    except UNREADABLE as error:
        raise DamagedCellError(str(error)) from error
    if rows:
        for column, values in zip(columns, zip(*rows, strict=True), strict=True):
            _check(column, values)
    return rows


def _check(column: ColumnElement[object], values: Sequence[object]) -> None:
    declared = _declared(column)
    if declared is None:
        return
    kinds = set(map(type, values))
    if declared.nullable:
        kinds.discard(type(None))
    if not kinds <= _python_types(declared):
        got = ", ".join(sorted(kind.__name__ for kind in kinds - _python_types(declared)))
        raise DamagedCellError(f"{declared.name}: got {got}")


def _declared(column: ColumnElement[object]) -> Any:
    """Return the column of a table that a column of a query shows; None for an expression.

    The columns of the view `run_overview` have the names of those of `run`.
    """
    table = getattr(column, "table", None)
    if isinstance(column, Column):
        return column
    return (
        Run.__table__.c.get(column.name) if getattr(table, "name", "") == "run_overview" else None
    )


def _python_types(column: Column[object]) -> set[type]:
    if isinstance(column.type, JSON):
        return {list} if column.name in _LISTS else {dict}
    if isinstance(column.type, Utc):
        return {datetime}
    if isinstance(column.type, Boolean):
        return {bool, int}
    if isinstance(column.type, Integer):
        return {int}
    return {float, int} if isinstance(column.type, Float) else {str}


def damaged_cells(connection: Connection) -> Iterator[Problem]:
    """List the damaged cells of every table, at most _LISTED of each column."""
    raw = connection.connection.dbapi_connection
    if isinstance(raw, sqlite3.Connection):
        raw.create_function("is_sound", 2, _is_sound, deterministic=True)
        condition = _unsound
    else:
        condition = _misshapen  # PostgreSQL checks all else
    for table in Base.metadata.sorted_tables:
        for column in table.columns:
            if unsound := condition(column):
                yield from _damaged(connection, table, column, unsound)


def _damaged(
    connection: Connection, table: Table, column: Column[object], unsound: str
) -> Iterator[Problem]:
    keys = [key.name for key in table.primary_key]
    value = f"CAST({column.name} AS {'BLOB' if connection.dialect.name == 'sqlite' else 'TEXT'})"
    rows = connection.exec_driver_sql(
        f"SELECT {', '.join(keys)}, {value} FROM {table.name} WHERE {unsound} LIMIT {_LISTED + 1}"
    ).all()
    for *key, content in map(tuple, rows[:_LISTED]):
        place = f"{table.name} {' '.join(map(str, key))}, {column.name}"
        yield Problem(place, f"got {_shown(content)}, expected {_expected(column)}")
    if len(rows) > _LISTED:
        yield Problem(f"{table.name}, {column.name}", "and more cells like these")


def _shown(content: object) -> str:
    if isinstance(content, bytes):
        content = content[:10_000].decode("utf-8", "backslashreplace")
    return "nothing" if content is None else shortened(repr(content))


def _expected(column: Column[object]) -> str:
    if isinstance(column.type, JSON):
        return "a JSON list" if column.name in _LISTS else "a JSON object"
    if isinstance(column.type, Utc):
        return "a time"
    if isinstance(column.type, Boolean):
        return "0 or 1"
    if isinstance(column.type, Integer):
        return "an integer"
    return "a number" if isinstance(column.type, Float) else "text in UTF-8"


def _unsound(column: Column[object]) -> str:
    """Return SQL for SQLite that finds the damaged cells of a column."""
    name, kind = column.name, column.type
    if isinstance(kind, Boolean):
        unsound = f"typeof({name}) <> 'integer' OR {name} NOT IN (0, 1)"
    elif isinstance(kind, Integer):
        unsound = f"typeof({name}) <> 'integer'"
    elif isinstance(kind, Float):
        unsound = f"typeof({name}) NOT IN ('real', 'integer')"
    else:
        form = "text"
        if isinstance(kind, JSON):
            form = "list" if name in _LISTS else "dict"
        elif isinstance(kind, Utc):
            form = "time"
        unsound = f"typeof({name}) <> 'text' OR NOT is_sound('{form}', CAST({name} AS BLOB))"
    present = f"{name} IS NOT NULL AND ({unsound})"
    return present if column.nullable else f"{name} IS NULL OR {present}"


def _misshapen(column: Column[object]) -> str:
    """Return SQL for PostgreSQL that finds JSON of another shape, and infinite times."""
    if isinstance(column.type, Utc):
        return f"NOT isfinite({column.name})"
    if not isinstance(column.type, JSON):
        return ""
    return f"json_typeof({column.name}) <> '{'array' if column.name in _LISTS else 'object'}'"


def _is_sound(form: str, content: bytes) -> bool:
    try:
        text = content.decode()
        match form:
            case "time":
                datetime.fromisoformat(text)
            case "list" | "dict":
                return type(json.loads(text)).__name__ == form
    except UNREADABLE:
        return False
    return True
