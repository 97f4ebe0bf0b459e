"""Rows of a query whose cells have the types that their columns declare.

SQLite stores any value in any column, so a damaged file can hold text where a number is declared.
Such a cell is an error where it is read, so that no result is computed from it.
"""

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from typing import Any, TypeVarTuple

from sqlalchemy import JSON, ColumnClause, Connection, DateTime, Float, Integer, Row, Select, String

from seatrial.runner.database.tables import Utc

Columns = TypeVarTuple("Columns")
_PYTHON_TYPES: Sequence[tuple[type[Any], set[type]]] = (
    (JSON, set()),
    (Utc, {datetime}),
    (DateTime, {datetime}),
    (Integer, {int}),
    (Float, {float, int}),
    (String, {str}),
)
_LISTS = ("overrides", "tags", "drawn")  # JSON columns that hold lists; the others hold objects


class DamagedCellError(ValueError):
    """A cell that does not hold what its column declares."""


def read(
    connection: Connection, statement: Select[*Columns], at_once: int | None = None
) -> Iterator[Sequence[Row[*Columns]]]:
    """Yield all rows of a query, or batches of them.

    Args:
        connection: An open connection.
        statement: The query; its columns are checked, expressions are not.
        at_once: Rows in a batch; by default one batch holds all.

    Raises:
        DamagedCellError: A cell does not have the type of its column.
    """
    options = {} if at_once is None else {"yield_per": at_once}
    result = connection.execute(statement.execution_options(**options))
    try:
        for rows in [result.all()] if at_once is None else result.partitions():
            for place, column in enumerate(statement.selected_columns):
                if isinstance(column, ColumnClause):
                    _check(column, (row[place] for row in rows))
            yield rows
    except (ValueError, TypeError, RecursionError) as error:  # of the conversion of a cell
        raise DamagedCellError(f"damaged: a cell cannot be read: {error}") from error


def _check(column: ColumnClause[Any], values: Iterable[object]) -> None:
    for declared, expected in _PYTHON_TYPES:
        if isinstance(column.type, declared):
            allowed = {*expected, type(None)}  # NULL also of an outer join
            if declared is JSON:
                allowed = {list if column.name in _LISTS else dict}
                allowed |= {type(None)} if getattr(column, "nullable", True) else set()
            if wrong := set(map(type, values)) - allowed:
                got = ", ".join(sorted(kind.__name__ for kind in wrong))
                raise ValueError(f"column {column.name} holds {got}")
            return
