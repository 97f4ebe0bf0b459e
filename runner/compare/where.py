"""Conditions on runs: the language of --where, its meaning, and its SQL.

    condition   := conjunction ("or" conjunction)*
    conjunction := negation ("and" negation)*
    negation    := "not" negation | "(" condition ")" | comparison
    comparison  := NAME ("=" | "==" | "!=" | "<>" | "<" | "<=" | ">" | ">=") VALUE
                 | NAME ["not"] "in" "(" VALUE ("," VALUE)* ")"
    VALUE       := number | 'text' | "text" | bare_word | true | false | null

A NAME is a column of table `run` (identifier, seed, status, ...) or a dotted key of the
configuration (plant.scale, identifier.force). Names are looked up before any SQL is built, and
values are bound as parameters, so text from the command line never becomes SQL.
"""

import math
import operator as op
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches
from functools import reduce
from typing import Any

import numpy as np
import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.database.tables import Reuse, RunRow, Utc

Value = str | float | int | bool | tuple["Value", ...] | None  # a tuple: of `in`
Compared = Callable[[str, str, Value], Any]  # name, operator, value: what &, | and ~ combine
Expression = sa.ColumnElement[object]
OPERATORS = {
    **{"=": "=", "==": "=", "!=": "!=", "<>": "!="},
    **{"<": "<", "<=": "<=", ">": ">", ">=": ">="},
}
ORDERINGS: dict[str, Callable[[Any, Any], Any]] = {
    "<": op.lt, "<=": op.le, ">": op.gt, ">=": op.ge,
}  # fmt: skip
MAX_DEPTH = 50
KEYWORDS = {"and", "or", "not", "in"}
CONSTANTS: dict[str, Value] = {"true": True, "false": False, "null": None}
NOT_COMPARABLE = ("config", "overrides", "versions", "traceback")
_TOKEN = re.compile(
    r"""\s*(?:
        (?P<text>'(?:[^']|'')*'|"(?:[^"]|"")*")
      | (?P<operator><=|>=|!=|<>|==|=|<|>)
      | (?P<mark>[(),])
      | (?P<word>[A-Za-z0-9_.+\-:/]+)
    )""",
    re.VERBOSE,
)
NAME = re.compile(r"[A-Za-z_]\w*(\.\w+)*", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d{1,18}", re.ASCII)
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class Condition:
    """What selects runs: the text of --where, sweeps (own or reused runs), and one run."""

    text: str | None = None
    sweeps: tuple[int, ...] = ()  # empty: any
    run: int | None = None


EVERY_RUN = Condition()


def parse(text: str, compare: Compared) -> Any:
    """Return the meaning of a text: that of its comparisons, combined by `&`, `|` and `~`.

    `compare` gives the meaning of `name operator value`; the operator `in` takes a tuple. Raises
    ConfigurationError if the text breaks the grammar above.
    """
    return _Parser(text, compare).parse()


def names_in(text: str | None) -> set[str]:
    """Return the names that a condition compares."""
    names: set[str] = set()

    def compare(name: str, operator: str, value: Value) -> np.bool_:
        names.add(name)
        return np.True_

    if text:
        parse(text, compare)
    return names


def holds(own: Value, operator: str, value: Value) -> bool:
    """Return whether a comparison holds; values of different types are unequal."""
    if operator == "in":
        return isinstance(value, tuple) and own in value
    if operator in ("=", "!="):
        return (own == value) == (operator == "=")
    numbers = isinstance(own, int | float) and isinstance(value, int | float)
    if not (numbers or (isinstance(own, str) and isinstance(value, str))):
        return False
    return bool(ORDERINGS[operator](own, value))


def bare_value(word: str) -> Value:
    """Return the value of an unquoted word: a constant, a number, or the text itself."""
    if word.lower() in CONSTANTS:
        return CONSTANTS[word.lower()]
    if _INTEGER.fullmatch(word):
        return int(word)
    return float(word) if _NUMBER.fullmatch(word) else word


def _tokens(text: str) -> list[tuple[str, str, int]]:
    """Return kind (text, operator, mark, word, end), text and position of every token."""
    pieces: list[tuple[str, str, int]] = []
    position = 0
    while text[position:].strip():
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            rest = text[position:].strip()
            raise ConfigurationError(
                f"--where: cannot read {rest[:20]!r}; expected comparisons such as"
                ' "seed<10 and identifier=ls"'
            )
        kind = match.lastgroup
        pieces.append((kind, match[kind], match.start(kind)))
        position = match.end()
    return [*pieces, ("end", "", len(text))]


class _Parser:
    """Recursive descent over the tokens, one method for each rule of the grammar."""

    def __init__(self, text: str, compare: Compared) -> None:
        self.tokens = _tokens(text)
        self.compare = compare
        self.at = 0
        self.depth = 0

    def parse(self) -> Any:
        meaning = self.disjunction()
        if self.kind != "end":
            raise self.unexpected("and, or, or the end")
        return meaning

    def disjunction(self) -> Any:
        return self.joined("or", self.conjunction, op.or_)

    def conjunction(self) -> Any:
        return self.joined("and", self.negation, op.and_)

    def joined(self, word: str, part: Callable[[], Any], by: Callable[[Any, Any], Any]) -> Any:
        parts = [part()]
        while self.take("word", word):
            parts.append(part())
        return reduce(by, parts)

    def negation(self) -> Any:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise ConfigurationError(f"--where: nested deeper than {MAX_DEPTH} levels")
        if self.take("word", "not"):
            meaning = ~self.negation()
        elif self.take("mark", "("):
            meaning = self.disjunction()
            self.need(")")
        else:
            meaning = self.comparison()
        self.depth -= 1
        return meaning

    def comparison(self) -> Any:
        if self.kind != "word" or self.text.lower() in KEYWORDS or not NAME.fullmatch(self.text):
            raise self.unexpected("a column or a dotted name of the configuration")
        name = self.next()
        negated = self.take("word", "not")
        if self.take("word", "in"):
            meaning = self.compare(name, "in", self.values())
            return ~meaning if negated else meaning
        if negated or self.kind != "operator":
            raise self.unexpected("in" if negated else "one of = != < <= > >= in")
        operator = OPERATORS[self.next()]
        value = self.value()
        if operator not in ("=", "!=") and (value is None or isinstance(value, bool)):
            raise ConfigurationError(
                f"--where: {name} {operator} {str(value).lower()} has no meaning; use = or !="
            )
        return self.compare(name, operator, value)

    def values(self) -> tuple[Value, ...]:
        self.need("(")
        values = [self.value()]
        while self.take("mark", ","):
            values.append(self.value())
        self.need(")")
        return tuple(values)

    def value(self) -> Value:
        if self.kind == "text":
            quote = self.text[0]
            return self.next()[1:-1].replace(2 * quote, quote)
        if self.kind != "word" or self.text.lower() in KEYWORDS:
            raise self.unexpected("a value")
        return bare_value(self.next())

    @property
    def kind(self) -> str:
        return self.tokens[self.at][0]

    @property
    def text(self) -> str:
        return self.tokens[self.at][1]

    def next(self) -> str:
        """Return the text of this token and go to the next one."""
        self.at += 1
        return self.tokens[self.at - 1][1]

    def take(self, kind: str, text: str) -> bool:
        """Go to the next token if this one is of this kind and text; return whether it was."""
        matches = self.kind == kind and self.text.lower() == text
        self.at += matches
        return matches

    def need(self, mark: str) -> None:
        if not self.take("mark", mark):
            raise self.unexpected(repr(mark))

    def unexpected(self, expected: str) -> ConfigurationError:
        got = repr(self.text) if self.kind != "end" else "the end"
        return ConfigurationError(
            f"--where: expected {expected}, got {got} at character {self.tokens[self.at][2] + 1}"
        )


class ColumnNames:
    """Columns and configuration keys of one database, and the SQL of conditions on them.

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
        return self.columns[name] if name in self.columns else self._key_text(name)

    def clauses(self, condition: Condition) -> list[sa.ColumnElement[bool]]:
        """Return the SQL of a condition: all clauses must hold.

        Raises ConfigurationError for an unknown name or a value of a wrong type.
        """
        clauses: list[sa.ColumnElement[bool]] = []
        if condition.text:
            clauses.append(parse(condition.text, self._compare))
        if condition.sweeps:
            own = sa.select(RunRow.id).where(RunRow.sweep_id.in_(condition.sweeps))
            reused = sa.select(Reuse.run_id).where(Reuse.sweep_id.in_(condition.sweeps))
            clauses.append(RunRow.id.in_(own.union(reused)))
        if condition.run is not None:
            clauses.append(self._compare("id", "=", condition.run))
        return clauses

    def _compare(self, name: str, operator: str, value: Value) -> sa.ColumnElement[bool]:
        self.check(name, "--where")
        if isinstance(value, tuple):
            return self._among(name, value)
        if name in self.columns:
            column = self.columns[name]
            return _operate(column, operator, _for_column(name, column, value))
        return self._compare_key(name, operator, value)

    def _among(self, name: str, values: tuple[Value, ...]) -> sa.ColumnElement[bool]:
        """Return one IN expression; thousands of nested comparisons are too deep for SQL."""
        if name not in self.columns:
            return sa.or_(*(self._compare_key(name, "=", value) for value in dict.fromkeys(values)))
        column = self.columns[name]
        plain = [_for_column(name, column, value) for value in values if value is not None]
        parts: list[sa.ColumnElement[bool]] = []
        parts += [sa.func.coalesce(column.in_(plain), sa.false())] if plain else []
        parts += [column.is_(None)] if None in values else []
        return sa.or_(*parts)

    def _compare_key(self, key: str, operator: str, value: Value) -> sa.ColumnElement[bool]:
        """Compare a key as the type of the value; a value of another type is unequal."""
        text = self._key_text(key)
        if value is None:
            return text.is_(None) if operator == "=" else text.is_not(None)
        if isinstance(value, bool):
            return _operate(text, operator, str(value).lower())
        if isinstance(value, int | float):
            return _operate(self._key_number(key), operator, float(value))
        return _operate(text, operator, value)

    def _key_type(self, key: str) -> Expression:
        """Return the JSON type of a key as SQLite names it."""
        path = "$." + ".".join(f'"{part}"' for part in key.split("."))
        return sa.func.json_type(self.config, path)

    def _key_text(self, key: str) -> Expression:
        text: Expression = self.config[tuple(key.split("."))].as_string()
        if not self.sqlite:
            return text
        kind = self._key_type(key)  # SQLite extracts true as 1
        return sa.case((kind == "true", "true"), (kind == "false", "false"), else_=text)

    def _key_number(self, key: str) -> Expression:
        item = self.config[tuple(key.split("."))]
        if self.sqlite:
            is_number: sa.ColumnElement[bool] = self._key_type(key).in_(("integer", "real"))
        else:
            is_number = sa.func.json_typeof(item) == "number"
        return sa.case((is_number, item.as_float()), else_=None)


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
