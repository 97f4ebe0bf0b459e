"""Conditions on runs: the language of --where, and its meaning.

    condition   := conjunction ("or" conjunction)*
    conjunction := negation ("and" negation)*
    negation    := "not" negation | "(" condition ")" | comparison
    comparison  := NAME ("=" | "==" | "!=" | "<>" | "<" | "<=" | ">" | ">=") VALUE
                 | NAME ["not"] "in" "(" VALUE ("," VALUE)* ")"
    VALUE       := number | 'text' | "text" | bare_word | true | false | null

A NAME is a column of table `run` (identifier, seed, status, ...) or a dotted key of the
configuration (plant.scale, identifier.force). SQL reads the levels of the names, and a comparison
holds or does not hold of a level (`holds`): text from the command line never becomes SQL.
"""

import ast
import operator as op
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.database.tables import Utc

Value = str | float | int | bool | tuple["Value", ...] | None  # a tuple: of `in`
Compared = Callable[[str, str, Value], Any]  # name, operator, value: what &, | and ~ combine
Expression = sa.ColumnElement[object]
ORDERINGS: dict[str, Callable[[Any, Any], Any]] = {
    "<": op.lt, "<=": op.le, ">": op.gt, ">=": op.ge,
}  # fmt: skip
OPERATORS: dict[type[ast.cmpop], str] = {
    ast.Eq: "=", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
    ast.In: "in", ast.NotIn: "in",
}  # fmt: skip
CONSTANTS: dict[str, Value] = {"true": True, "false": False, "null": None}
NOT_COMPARABLE = ("config", "overrides", "versions", "traceback")
# Tokens of a condition, and those that mean something in Python.
TOKEN = re.compile(
    r"""(?P<name>'(?:[^']|'')*'|"(?:[^"]|"")*"|[A-Za-z0-9_.+\-:/]+)|<=|>=|!=|<>|==|\S"""
)
PYTHON = {"=": "==", "<>": "!=", **{own: own for own in ("==", "!=", "<", "<=", ">", ">=")}}
PYTHON |= {own: own for own in ("and", "or", "not", "in", "(", ")", ",")}
NAME = re.compile(r"[A-Za-z_]\w*(\.\w+)*", re.ASCII)
_INTEGER = re.compile(r"[+-]?\d{1,18}", re.ASCII)
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class Condition:
    """What selects runs: sweeps (own or reused runs), numbers, and the text that gave these."""

    text: str | None = None
    sweeps: tuple[int, ...] = ()  # empty: any
    runs: tuple[int, ...] | None = None  # None: any


EVERY_RUN = Condition()


def parse(text: str, compare: Compared) -> Any:
    """Return the meaning of a text: that of its comparisons, combined by `&`, `|` and `~`.

    `compare` gives the meaning of `name operator value`; the operator `in` takes a tuple. Python
    reads the text, each token on a line of its own, and a zero in place of every name and value.
    Raises ConfigurationError if the text breaks the grammar above.
    """
    tokens = [*TOKEN.finditer(text)]

    def refused(number: int) -> ConfigurationError:
        place = tokens[number].start() if number < len(tokens) else len(text.rstrip())
        rest = text[place:].strip()
        return ConfigurationError(
            f"--where: cannot read {repr(rest[:20]) if rest else 'the end'} at character"
            f' {place + 1}; expected comparisons such as "seed<10 and identifier=ls"'
        )

    def value(node: ast.expr) -> Value:
        """A quoted text, or what an unquoted word looks like."""
        if not isinstance(node, ast.Constant):
            raise refused(node.lineno - 1)
        token = tokens[node.lineno - 1][0]
        quoted = token[0] in "'\""
        return token[1:-1].replace(2 * token[0], token[0]) if quoted else bare_value(token)

    def meaning(node: ast.expr) -> Any:
        match node:
            case ast.BoolOp(op=joined, values=parts):
                both = op.and_ if isinstance(joined, ast.And) else op.or_
                return reduce(both, map(meaning, parts))
            case ast.UnaryOp(op=ast.Not(), operand=part):
                return ~meaning(part)
            case ast.Compare(left=ast.Constant() as left, ops=[sign], comparators=[right]):
                name, operator = tokens[left.lineno - 1][0], OPERATORS[type(sign)]
                if not NAME.fullmatch(name):
                    raise refused(left.lineno - 1)
                if operator == "in":
                    each = right.elts if isinstance(right, ast.Tuple) else [right]
                    among = compare(name, operator, tuple(map(value, each or [right])))
                    return ~among if isinstance(sign, ast.NotIn) else among
                other = value(right)
                if operator in ORDERINGS and (other is None or isinstance(other, bool)):
                    told = f"{name} {operator} {str(other).lower()}"
                    raise ConfigurationError(f"--where: {told} has no meaning; use = or !=")
                return compare(name, operator, other)
        raise refused(node.lineno - 1)

    lines = [PYTHON.get(token[0].lower(), "0") for token in tokens]
    for number, token in enumerate(tokens):
        if lines[number] == "0" and token["name"] is None:
            raise refused(number)
    try:
        return meaning(ast.parse("\\\n".join(lines), mode="eval").body)
    except SyntaxError as error:
        if "too many nested" not in str(error):
            raise refused((error.lineno or 1) - 1) from None
    except (MemoryError, RecursionError):
        pass
    raise ConfigurationError("--where: got too many parentheses and negations within each other")


def compared(text: str) -> dict[str, None]:
    """Return the names of a condition, in their order."""
    names = dict[str, None]()
    parse(text, lambda name, *_: np.bool_(names.setdefault(name) is None))
    return names


def met(text: str, levels: pd.DataFrame) -> "pd.Series[bool]":
    """Return where a condition holds of the levels of its names, a column each."""
    held: pd.Series[bool] = parse(
        text, lambda name, *told: levels[name].map(lambda own: holds(own, *told)).astype(bool)
    )
    return held


def holds(level: object, operator: str, value: Value) -> bool:
    """Return whether a comparison of a level holds, as text or as what the text looks like.

    A value of another type is unequal, and so is a missing level to any but null.
    """
    if operator == "in":
        return isinstance(value, tuple) and any(holds(level, "=", each) for each in value)
    own: object = None if level is None else str(level)
    other: object = value
    if isinstance(level, datetime):
        own, other = level, as_date(value)
    elif level is not None and not isinstance(value, str):
        own = bare_value(str(level))
    if operator in ("=", "!="):
        same = own == other and isinstance(own, bool) == isinstance(other, bool)
        return same == (operator == "=")
    try:
        return bool(ORDERINGS[operator](own, other))
    except TypeError:  # a text and a number, or no value
        return False


def as_date(value: Value) -> datetime | None:
    """Return the time that a text says, UTC if it names no zone; ValueError if it says none."""
    if value is None:
        return None
    moment = datetime.fromisoformat(str(value))
    return moment.replace(tzinfo=moment.tzinfo or UTC)


def bare_value(word: str) -> Value:
    """Return the value of an unquoted word: a constant, a number, or the text itself."""
    if word.lower() in CONSTANTS:
        return CONSTANTS[word.lower()]
    if _INTEGER.fullmatch(word):
        return int(word)
    return float(word) if _NUMBER.fullmatch(word) else word


class ColumnNames:
    """Columns and configuration keys of one database.

    `columns` are the SQL expressions of the plain names; `config` is the JSON column;
    `keys` are the dotted keys of at least one run.
    """

    def __init__(
        self, columns: Mapping[str, Expression], config: Expression, keys: Iterable[str],
        sqlite: bool,
    ) -> None:  # fmt: skip
        self.columns = {n: c for n, c in columns.items() if n not in NOT_COMPARABLE}
        self.config = config
        self.keys = frozenset(key for key in keys if NAME.fullmatch(key))
        self.sqlite = sqlite

    def check(self, name: str, option: str) -> None:
        """Raise ConfigurationError for an unknown name; the message lists similar names.

        `option` is the command-line option that the message begins with.
        """
        if name not in self.columns and name not in self.keys:
            known = dict.fromkeys([*self.columns, *sorted(self.keys)])
            expected = meant(name, known, 3) or (
                f"expected one of {', '.join(self.columns)} or a dotted name of the configuration"
            )
            raise ConfigurationError(f"{option}: {name!r} is not known; {expected.rstrip()}")

    def checked(self, text: str) -> list[str]:
        """Return the names of a condition.

        Raises ConfigurationError for an unknown name or a value of a wrong type.
        """

        def compare(name: str, operator: str, value: Value) -> np.bool_:
            self.check(name, "--where")
            kind = self.columns[name].type if name in self.columns else None
            for each in value if isinstance(value, tuple) else (value,):
                if expected := _expected(kind, each):
                    told = f"{name} is compared with {expected}, got {each!r}"
                    raise ConfigurationError(f"--where: {told}")
            return np.True_

        parse(text, compare)
        return [*compared(text)]

    def text(self, name: str) -> Expression:
        """Return the value of a checked name as text, as shown in rows and columns."""
        if name in self.columns:
            return self.columns[name]
        path = tuple(name.split("."))
        text: Expression = self.config[path].as_string()
        if not self.sqlite:
            return text
        # SQLite extracts true as 1
        kind = sa.func.json_type(self.config, "$." + ".".join(f'"{part}"' for part in path))
        return sa.case((kind == "true", "true"), (kind == "false", "false"), else_=text)


def _expected(kind: object, value: Value) -> str | None:
    """Return what a column of a type is compared with, if the value is none of these."""
    if value is None:
        return None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(kind, sa.Boolean) and not isinstance(value, bool):
        return "true or false"
    if isinstance(kind, sa.Integer | sa.Float) and not is_number:
        return "a number"
    try:
        as_date(value if isinstance(kind, Utc) else None)
    except ValueError:
        return "a date such as 2026-01-31 or 2026-01-31T12:00"
    return None
