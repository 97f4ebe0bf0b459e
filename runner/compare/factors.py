"""The names that --where, --rows and --columns accept, and the SQL expression of each.

A name is a column of table `run` (identifier, seed, status, ...) or a dotted key of the
configuration (plant.scale, identifier.force). Names are looked up before any SQL is built, and
values are bound as parameters, so text from the command line never becomes SQL.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from difflib import get_close_matches
from typing import Any

import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.where import (
    NAME,
    ORDERINGS,
    Among,
    Comparison,
    Condition,
    Joined,
    Not,
    OfSweeps,
    Value,
)
from seatrial.runner.database.tables import Reuse, RunRow, Utc

NOT_COMPARABLE = ("config", "overrides", "versions", "traceback")
Expression = sa.ColumnElement[object]


class ColumnNames:
    """Columns and configuration keys of one database.

    `columns` are the SQL expressions of the plain names; `config` is the JSON column;
    `keys` are the dotted keys of at least one run.
    """

    def __init__(
        self,
        columns: Mapping[str, Expression],
        config: Expression,
        keys: Iterable[str],
        sqlite: bool,
    ) -> None:
        self.columns = {n: c for n, c in columns.items() if n not in NOT_COMPARABLE}
        self.config = config
        self.keys = frozenset(key for key in keys if NAME.fullmatch(key))
        self.sqlite = sqlite

    def check(self, name: str, option: str) -> None:
        """Raise ConfigurationError for an unknown name; the message lists similar names.

        `option` is the command-line option that the message begins with.
        """
        if name in self.columns or name in self.keys:
            return
        known = list(dict.fromkeys([*self.columns, *sorted(self.keys)]))
        similar = get_close_matches(name, known, n=3, cutoff=0.6)
        expected = (
            " or ".join(similar) if similar else f"one of {', '.join(self.columns)} or a dotted"
        )
        raise ConfigurationError(
            f"{option}: {name!r} is not known; expected {expected}"
            + ("" if similar else " name of the configuration")
        )

    def text(self, name: str) -> Expression:
        """Return the value of a checked name as text, as shown in rows and columns."""
        if name in self.columns:
            return self.columns[name]
        return self._key_text(name)

    def clause(self, condition: Condition) -> sa.ColumnElement[bool]:
        """Return the SQL of a condition.

        Raises ConfigurationError for an unknown name or a value of a wrong type.
        """
        match condition:
            case Comparison():
                return self._compare(condition.name, condition.operator, condition.value)
            case Among():
                return self._among(condition.name, condition.values)
            case Not():
                return sa.not_(self.clause(condition.condition))
            case Joined():
                parts = [self.clause(part) for part in condition.conditions]
                return sa.and_(*parts) if condition.by == "and" else sa.or_(*parts)
            case OfSweeps(numbers=numbers):
                own = sa.select(RunRow.id).where(RunRow.sweep_id.in_(numbers))
                reused = sa.select(Reuse.run_id).where(Reuse.sweep_id.in_(numbers))
                return RunRow.id.in_(own.union(reused))

    def _among(self, name: str, values: Sequence[Value]) -> sa.ColumnElement[bool]:
        """Return one IN expression; thousands of nested comparisons are too deep for SQL."""
        self.check(name, "--where")
        if name in self.columns:
            column = self.columns[name]
            plain = [_for_column(name, column, value) for value in values if value is not None]
            parts: list[sa.ColumnElement[bool]] = []
            parts += [sa.func.coalesce(column.in_(plain), sa.false())] if plain else []
            parts += [column.is_(None)] if None in values else []
            return sa.or_(*parts)
        return sa.or_(*(self._compare_key(name, "=", value) for value in dict.fromkeys(values)))

    def _compare(self, name: str, operator: str, value: Value) -> sa.ColumnElement[bool]:
        self.check(name, "--where")
        if name in self.columns:
            column = self.columns[name]
            return _operate(column, operator, _for_column(name, column, value))
        return self._compare_key(name, operator, value)

    def _compare_key(self, key: str, operator: str, value: Value) -> sa.ColumnElement[bool]:
        """Compare a key as the type of the value; a value of another type is unequal."""
        if value is None:
            text = self._key_text(key)
            return text.is_(None) if operator == "=" else text.is_not(None)
        if isinstance(value, bool):
            return _operate(self._key_text(key), operator, str(value).lower())
        if isinstance(value, str):
            return _operate(self._key_text(key), operator, value)
        return _operate(self._key_number(key), operator, float(value))

    def _key_text(self, key: str) -> Expression:
        path = tuple(key.split("."))
        text: Expression = self.config[path].as_string()
        if not self.sqlite:
            return text
        kind = sa.func.json_type(self.config, "$." + ".".join(f'"{part}"' for part in path))
        # SQLite extracts true as 1
        return sa.case((kind == "true", "true"), (kind == "false", "false"), else_=text)

    def _key_number(self, key: str) -> Expression:
        path = tuple(key.split("."))
        if self.sqlite:
            kind = sa.func.json_type(self.config, "$." + ".".join(f'"{part}"' for part in path))
            is_number: sa.ColumnElement[bool] = kind.in_(("integer", "real"))
        else:
            is_number = sa.func.json_typeof(self.config[path]) == "number"
        return sa.case((is_number, self.config[path].as_float()), else_=None)


def _operate(left: Expression, operator: str, right: Any) -> sa.ColumnElement[bool]:
    """Return `left operator right`; a missing value is unequal to any other value, not NULL."""
    if operator == "=":
        return left.is_not_distinct_from(right)
    if operator == "!=":
        return left.is_distinct_from(right)
    return sa.func.coalesce(ORDERINGS[operator](left, right), sa.false())


def _for_column(name: str, column: Expression, value: Value) -> Value | datetime | Expression:
    """Return the value in the type of the column; raises ConfigurationError for another type."""
    if value is None:
        return None
    kind = column.type
    if isinstance(kind, sa.Boolean):
        if isinstance(value, bool):
            return value
        raise _mismatch(name, "true or false", value)
    if isinstance(kind, Utc):
        return _moment(name, value)
    if isinstance(kind, sa.Integer | sa.Float):
        if isinstance(value, int | float) and not isinstance(value, bool):
            return _number(kind, value)
        raise _mismatch(name, "a number", value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def _number(kind: sa.types.TypeEngine[object], value: float) -> float | Expression:
    """Return an integer that the column can hold, and any other number as a double.

    A database refuses an integer beyond the range of its column instead of comparing it.
    """
    bits = 63 if isinstance(kind, sa.BigInteger) else 31
    if isinstance(value, int) and -(2**bits) <= value < 2**bits:
        return value
    try:
        return sa.literal(float(value), sa.Double())
    except OverflowError:
        return sa.literal(math.copysign(math.inf, value), sa.Double())


def _moment(name: str, value: Value) -> datetime:
    try:
        moment = datetime.fromisoformat(str(value))
    except ValueError:
        raise _mismatch(name, "a date such as 2026-01-31 or 2026-01-31T12:00", value) from None
    try:
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except OverflowError:  # in the first or the last hours of the calendar
        return moment.replace(tzinfo=UTC)


def _mismatch(name: str, expected: str, value: Value) -> ConfigurationError:
    return ConfigurationError(f"--where: {name} is compared with {expected}, got {value!r}")


def flat(config: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Return a nested configuration as one level with dotted names.

    `prefix` stands before every name.
    """
    values: dict[str, object] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            values |= flat(value, f"{prefix}{key}.")
        else:
            values[f"{prefix}{key}"] = value
    return values
