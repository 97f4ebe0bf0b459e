"""The names that --where, --rows and --columns accept, and the SQL that each stands for.

A name is a column of table `run` (identifier, seed, status, ...) or a dotted key of the
configuration (plant.scale, identifier.force). It is looked up before any SQL is built, and values
are bound as parameters: text from the command line never becomes SQL.
"""

import operator as op
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from difflib import get_close_matches
from typing import Any

import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.where import NAME, Among, Comparison, Condition, Joined, Not, Value
from seatrial.runner.database.tables import Utc

NOT_COMPARABLE = ("config", "overrides", "versions", "traceback")
_ORDERINGS = {"<": op.lt, "<=": op.le, ">": op.gt, ">=": op.ge}
Expression = sa.ColumnElement[Any]


class Names:
    """Columns and configuration keys of one database.

    `columns` are the SQL expressions of the plain names; `config` is the JSON column;
    `keys` are the dotted keys that at least one run has.
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
        """Raises ConfigurationError, with the nearest known names, for an unknown one."""
        if name in self.columns or name in self.keys:
            return
        known = list(dict.fromkeys([*self.columns, *sorted(self.keys)]))
        near = get_close_matches(name, known, n=3, cutoff=0.6)
        expected = " or ".join(near) if near else f"one of {', '.join(self.columns)} or a dotted"
        raise ConfigurationError(
            f"{option}: {name!r} is not known; expected {expected}"
            + ("" if near else " name of the configuration")
        )

    def text(self, name: str) -> Expression:
        """The value of a checked name as text: what a table shows as row or column."""
        if name in self.columns:
            return self.columns[name]
        return self._key_text(name)

    def clause(self, condition: Condition) -> sa.ColumnElement[bool]:
        """The SQL of a condition; raises ConfigurationError for an unknown name or a wrong type."""
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

    def _among(self, name: str, values: Sequence[Value]) -> sa.ColumnElement[bool]:
        """One IN for the plain values: thousands of them, as of a sweep, are no deep expression."""
        self.check(name, "--where")
        if name in self.columns:
            column = self.columns[name]
            plain = [_for_column(name, column, value) for value in values if value is not None]
            found: list[sa.ColumnElement[bool]] = []
            found += [sa.func.coalesce(column.in_(plain), sa.false())] if plain else []
            found += [column.is_(None)] if None in values else []
            return sa.or_(*found)
        return sa.or_(*(self._compare_key(name, "=", value) for value in dict.fromkeys(values)))

    def _compare(self, name: str, operator: str, value: Value) -> sa.ColumnElement[bool]:
        self.check(name, "--where")
        if name in self.columns:
            column = self.columns[name]
            return _operate(column, operator, _for_column(name, column, value))
        return self._compare_key(name, operator, value)

    def _compare_key(self, key: str, operator: str, value: Value) -> sa.ColumnElement[bool]:
        """A key is compared as the type of the value; runs where it has another type differ."""
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
    """`left operator right`; a missing value is unequal to any other, and never NULL's unknown."""
    if operator == "=":
        return left.is_not_distinct_from(right)
    if operator == "!=":
        return left.is_distinct_from(right)
    return sa.func.coalesce(_ORDERINGS[operator](left, right), sa.false())


def _for_column(name: str, column: Expression, value: Value) -> Value | datetime:
    """The value in the column's own type; raises ConfigurationError where it has another."""
    if value is None:
        return None
    wanted = column.type
    if isinstance(wanted, sa.Boolean):
        if isinstance(value, bool):
            return value
        raise _mismatch(name, "true or false", value)
    if isinstance(wanted, Utc):
        return _moment(name, value)
    if isinstance(wanted, sa.Integer | sa.Float):
        if isinstance(value, int | float) and not isinstance(value, bool):
            return value
        raise _mismatch(name, "a number", value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def _moment(name: str, value: Value) -> datetime:
    try:
        moment = datetime.fromisoformat(str(value))
    except ValueError:
        raise _mismatch(name, "a date such as 2026-01-31 or 2026-01-31T12:00", value) from None
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def _mismatch(name: str, expected: str, value: Value) -> ConfigurationError:
    return ConfigurationError(f"--where: {name} is compared with {expected}, got {value!r}")


def flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A nested configuration with dotted names."""
    found: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found
