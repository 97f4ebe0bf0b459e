"""Conditions on runs: the language of --where, its meaning, and its SQL.

    condition   := conjunction ("or" conjunction)*
    conjunction := negation ("and" negation)*
    negation    := "not" negation | "(" condition ")" | comparison
    comparison  := NAME ("=" | "==" | "!=" | "<>" | "<" | "<=" | ">" | ">=") VALUE
                 | NAME ["not"] "in" "(" VALUE ("," VALUE)* ")"
    VALUE       := number | 'text' | "text" | bare_word | true | false | null

A NAME is a column of table `run` (identifier, seed, status, ...) or a dotted key of the
configuration (plant.scale, identifier.force). Names are looked up before any SQL is built, and
values are bound as parameters, so text from the command line never becomes SQL. The grammar is that
of Python's comparisons, whose parser reads it, with `_` in place of every name and value.
"""

import ast
import operator as op
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches
from functools import reduce
from itertools import accumulate
from typing import Any

import numpy as np
import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.database.tables import Reuse, RunRow, Utc

Value = str | float | int | bool | tuple["Value", ...] | None  # a tuple: of `in`
Compared = Callable[[str, str, Value], Any]  # name, operator, value: what &, | and ~ combine
Expression = sa.ColumnElement[object]
OPERATORS = {ast.Eq: "=", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
ORDERINGS: dict[str, Callable[[Any, Any], Any]] = {
    "<": op.lt, "<=": op.le, ">": op.gt, ">=": op.ge,
}  # fmt: skip
MOST_NESTED = 100  # parentheses within each other, and negations
KEYWORDS = ("and", "or", "not", "in")
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
    tokens, source, position = dict[int, re.Match[str]](), "", 0
    while text[position:].strip():
        match = _TOKEN.match(text, position)
        if match is None:
            raise _refused(text, position)
        tokens[len(source)] = match
        source += f"{_as_python(match)} "
        position = match.end()
    marks = [match[0].strip().lower() for match in tokens.values()]
    open_marks = accumulate((mark == "(") - (mark == ")") for mark in marks)
    nested = max(open_marks, default=0) + marks.count("not")
    if nested > MOST_NESTED:
        raise ConfigurationError(
            f"--where: got {nested} parentheses and negations within each other, expected at most "
            f"{MOST_NESTED}"
        )
    try:
        tree = ast.parse(source, mode="eval").body
    except SyntaxError as error:
        before = [match for column, match in tokens.items() if column < (error.offset or 1)]
        at_end = (error.offset or 1) > len(source.rstrip()) or not before
        start = len(text) if at_end else before[-1].start(before[-1].lastgroup or 0)
        raise _refused(text, start) from None
    return _Meaning(text, tokens, compare).of(tree)


def _as_python(token: re.Match[str]) -> str:
    """Return what stands for a token in Python: itself, or `_` for a name or value."""
    if token["operator"]:
        return {"=": "==", "<>": "!="}.get(token["operator"], token["operator"])
    word = (token["word"] or "").lower()
    return token["mark"] or (word if word in KEYWORDS else "_")


def _refused(text: str, start: int) -> ConfigurationError:
    rest = text[start:].strip()
    return ConfigurationError(
        f"--where: cannot read {repr(rest[:20]) if rest else 'the end'} at character {start + 1};"
        ' expected comparisons such as "seed<10 and identifier=ls"'
    )


class _Meaning:
    """The meaning of a text that Python's parser has read; `tokens` are by their column in it."""

    def __init__(self, text: str, tokens: Mapping[int, re.Match[str]], compare: Compared) -> None:
        self.text, self.tokens, self.compare = text, tokens, compare

    def of(self, node: ast.expr) -> Any:
        """Return the meaning of a condition."""
        match node:
            case ast.BoolOp(op=joint, values=parts):
                return reduce(
                    op.and_ if isinstance(joint, ast.And) else op.or_, map(self.of, parts)
                )
            case ast.UnaryOp(operand=operand):
                return ~self.of(operand)
            case ast.Compare(left=ast.Name(), ops=[operator], comparators=[right]):
                name = self.tokens[node.col_offset]["word"] or ""
                if NAME.fullmatch(name):
                    return self.comparison(name, operator, right)
        raise self.refused(node)

    def comparison(self, name: str, operator: ast.cmpop, right: ast.expr) -> Any:
        """Return the meaning of `name operator right`."""
        if isinstance(operator, ast.In | ast.NotIn):
            several = right.elts if isinstance(right, ast.Tuple) else [right]
            before = [token for at, token in self.tokens.items() if at < right.col_offset][-1]
            if not several or (not isinstance(right, ast.Tuple) and before["mark"] != "("):
                raise self.refused(right)
            among = self.compare(name, "in", tuple(map(self.value, several)))
            return among if isinstance(operator, ast.In) else ~among
        sign, value = OPERATORS[type(operator)], self.value(right)
        if sign in ORDERINGS and (value is None or isinstance(value, bool)):
            raise ConfigurationError(
                f"--where: {name} {sign} {str(value).lower()} has no meaning; use = or !="
            )
        return self.compare(name, sign, value)

    def value(self, node: ast.expr) -> Value:
        """Return a value: a quoted text, or what an unquoted word looks like."""
        if not isinstance(node, ast.Name):
            raise self.refused(node)
        token = self.tokens[node.col_offset]
        quoted: str | None = token["text"]
        if quoted:
            return quoted[1:-1].replace(2 * quoted[0], quoted[0])
        return bare_value(token["word"])

    def refused(self, node: ast.expr) -> ConfigurationError:
        token = self.tokens[node.col_offset]
        return _refused(self.text, token.start(token.lastgroup or 0))


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
