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

import operator as op
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches
from typing import Any

import numpy as np
import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.database.tables import Reuse, RunRow, Utc

Value = str | float | int | bool | tuple["Value", ...] | None  # a tuple: of `in`
Compared = Callable[[str, str, Value], Any]  # name, operator, value: what &, | and ~ combine
Expression = sa.ColumnElement[object]
ORDERINGS: dict[str, Callable[[Any, Any], Any]] = {
    "<": op.lt, "<=": op.le, ">": op.gt, ">=": op.ge,
}  # fmt: skip
MOST_NESTED = 100  # parentheses within each other, and negations
KEYWORDS = ("and", "or", "not", "in")
CONSTANTS: dict[str, Value] = {"true": True, "false": False, "null": None}
NOT_COMPARABLE = ("config", "overrides", "versions", "traceback")
QUOTED = re.compile(r"""\s*('(?:[^']|'')*'|"(?:[^"]|"")*")""")
OPERATOR = re.compile(r"\s*(<=|>=|!=|<>|==|=|<|>)")
WORD = re.compile(r"\s*([A-Za-z0-9_.+\-:/]+)")
OPEN, CLOSE, COMMA, END = (re.compile(rf"\s*({mark})") for mark in (r"\(", r"\)", ",", "$"))
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
    reader = _Reader(text, compare)
    meaning = reader.condition()
    reader.need(END)
    return meaning


class _Reader:
    """Reads a text by recursive descent, from `at` on; each rule returns its meaning."""

    def __init__(self, text: str, compare: Compared) -> None:
        self.text, self.compare = text, compare
        self.at = self.depth = 0

    def condition(self) -> Any:
        meaning = self.conjunction()
        while self.keyword("or"):
            meaning = meaning | self.conjunction()
        return meaning

    def conjunction(self) -> Any:
        meaning = self.negation()
        while self.keyword("and"):
            meaning = meaning & self.negation()
        return meaning

    def negation(self) -> Any:
        self.depth += 1
        if self.depth > MOST_NESTED + 1:
            raise ConfigurationError(
                f"--where: got more than {MOST_NESTED} parentheses and negations within each other"
            )
        if self.keyword("not"):
            meaning = ~self.negation()
        elif self.take(OPEN):
            meaning = self.condition()
            self.need(CLOSE)
        else:
            meaning = self.comparison()
        self.depth -= 1
        return meaning

    def comparison(self) -> Any:
        name = self.word()
        if not NAME.fullmatch(name):
            raise self.refused(len(name))
        negated = self.keyword("not")
        if self.keyword("in"):
            self.need(OPEN)
            values = [self.value()]
            while self.take(COMMA):
                values.append(self.value())
            self.need(CLOSE)
            among = self.compare(name, "in", tuple(values))
            return ~among if negated else among
        sign = self.need(OPERATOR) if not negated else self.need(END)  # `not` goes before `in`
        sign = {"==": "=", "<>": "!="}.get(sign, sign)
        value = self.value()
        if sign in ORDERINGS and (value is None or isinstance(value, bool)):
            raise ConfigurationError(
                f"--where: {name} {sign} {str(value).lower()} has no meaning; use = or !="
            )
        return self.compare(name, sign, value)

    def value(self) -> Value:
        """A quoted text, or what an unquoted word looks like."""
        if quoted := self.take(QUOTED):
            return quoted[1:-1].replace(2 * quoted[0], quoted[0])
        return bare_value(self.word())

    def word(self) -> str:
        word = self.need(WORD)
        if word.lower() in KEYWORDS:
            raise self.refused(len(word))
        return word

    def keyword(self, name: str) -> bool:
        match = WORD.match(self.text, self.at)
        held = match is not None and match[1].lower() == name
        if held and match is not None:
            self.at = match.end()
        return held

    def take(self, pattern: re.Pattern[str]) -> str | None:
        match = pattern.match(self.text, self.at)
        if match is None:
            return None
        self.at = match.end()
        return match[1]

    def need(self, pattern: re.Pattern[str]) -> str:
        found = self.take(pattern)
        if found is None:
            raise self.refused()
        return found

    def refused(self, back: int = 0) -> ConfigurationError:
        """The error for what follows, or for the last `back` characters and what follows."""
        rest = self.text[self.at - back :].strip()
        place = len(self.text.rstrip()) - len(rest) + 1
        return ConfigurationError(
            f"--where: cannot read {repr(rest[:20]) if rest else 'the end'} at character {place};"
            ' expected comparisons such as "seed<10 and identifier=ls"'
        )


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
    try:
        return bool(ORDERINGS[operator](own, value))
    except TypeError:  # a text and a number, or no value
        return False


def bare_value(word: str) -> Value:
    """Return the value of an unquoted word: a constant, a number, or the text itself."""
    if word.lower() in CONSTANTS:
        return CONSTANTS[word.lower()]
    if _INTEGER.fullmatch(word):
        return int(word)
    return float(word) if _NUMBER.fullmatch(word) else word


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
            clauses.append(RunRow.id == condition.run)
        return clauses

    def _compare(self, name: str, operator: str, value: Value) -> sa.ColumnElement[bool]:
        """Compare a column, or a key as the type of the value: one of another type is unequal."""
        self.check(name, "--where")
        column = self.columns.get(name)
        if isinstance(value, tuple) and column is not None:
            # one IN expression: thousands of nested comparisons are too deep for SQL
            plain = [_for_column(name, column, each) for each in value if each is not None]
            among = sa.func.coalesce(column.in_(plain), sa.false()) if plain else sa.false()
            return among | column.is_(None) if None in value else among
        if isinstance(value, tuple):
            return sa.or_(*(self._compare(name, "=", each) for each in dict.fromkeys(value)))
        if column is not None:
            return _operate(column, operator, _for_column(name, column, value))
        if isinstance(value, int | float) and not isinstance(value, bool):
            return _operate(self._key_number(name), operator, float(value))
        if isinstance(value, bool):
            value = str(value).lower()
        return _operate(self._key_text(name), operator, value)

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
    kind = column.type
    if value is None:
        return None
    if isinstance(kind, sa.Boolean):
        expected, fits = "true or false", isinstance(value, bool)
    elif isinstance(kind, sa.Integer | sa.Float):
        expected, fits = "a number", isinstance(value, int | float) and not isinstance(value, bool)
    elif isinstance(kind, Utc):
        expected, fits = "a date such as 2026-01-31 or 2026-01-31T12:00", False
        with suppress(ValueError):
            moment = datetime.fromisoformat(str(value))
            return moment.replace(tzinfo=moment.tzinfo or UTC).astimezone(UTC)
    else:
        return str(value).lower() if isinstance(value, bool) else str(value)
    if not fits:
        raise ConfigurationError(f"--where: {name} is compared with {expected}, got {value!r}")
    if isinstance(value, float) or (isinstance(value, int) and abs(value) >= 2**31):
        return sa.literal(float(value), sa.Double())  # whatever the column can hold
    return value
