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

import ast
import operator as op
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import reduce
from typing import Any

import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.database.tables import Reuse, RunRow, Utc

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
    """What selects runs: the text of --where, sweeps (own or reused runs), and one run."""

    text: str | None = None
    sweeps: tuple[int, ...] = ()  # empty: any
    run: int | None = None


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


def holds(level: object, operator: str, value: Value) -> bool:
    """Return whether a comparison of a level holds; values of different types are unequal."""
    own = bare_value(str(level))
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

    def text(self, name: str) -> Expression:
        """Return the value of a checked name as text, as shown in rows and columns."""
        if name in self.columns:
            return self.columns[name]
        text: Expression = self.config[tuple(name.split("."))].as_string()
        if not self.sqlite:
            return text
        kind = self._key_type(name)  # SQLite extracts true as 1
        return sa.case((kind == "true", "true"), (kind == "false", "false"), else_=text)

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
        """Compare a column, or a key as the type of the value: one of another type is unequal.

        A missing value is unequal to any other value, not NULL.
        """
        self.check(name, "--where")
        column = self.columns.get(name)
        if isinstance(value, tuple) and column is not None:
            # one IN expression: thousands of nested comparisons are too deep for SQL
            plain = [_for_column(name, column, each) for each in value if each is not None]
            among = sa.func.coalesce(column.in_(plain), sa.false()) if plain else sa.false()
            return among | column.is_(None) if None in value else among
        if isinstance(value, tuple):
            return sa.or_(*(self._compare(name, "=", each) for each in dict.fromkeys(value)))
        left, right = self.text(name), str(value).lower() if isinstance(value, bool) else value
        if column is not None:
            right = _for_column(name, column, value)
        elif isinstance(right, int | float):
            item = self.config[tuple(name.split("."))]
            numeric = self._key_type(name).in_(("integer", "real", "number"))
            left, right = sa.case((numeric, item.as_float()), else_=None), float(right)
        if operator == "=":
            return left.is_not_distinct_from(right)
        if operator == "!=":
            return left.is_distinct_from(right)
        return sa.func.coalesce(ORDERINGS[operator](left, right), sa.false())

    def _key_type(self, key: str) -> Expression:
        """Return the JSON type of a key, which SQLite and PostgreSQL name differently."""
        if not self.sqlite:
            return sa.func.json_typeof(self.config[tuple(key.split("."))])
        return sa.func.json_type(self.config, "$." + ".".join(f'"{k}"' for k in key.split(".")))


def _for_column(name: str, column: Expression, value: Value) -> Any:
    """Return the value in the type of the column; raises ConfigurationError for another type."""
    kind = column.type
    if value is None:
        return None
    if isinstance(kind, sa.Boolean):
        expected = "true or false"
        if isinstance(value, bool):
            return value
    elif isinstance(kind, sa.Integer | sa.Float):
        expected = "a number"
        if isinstance(value, int | float) and not isinstance(value, bool):
            whole = isinstance(value, int) and abs(value) < 2**31  # whatever the column can hold
            return value if whole else sa.literal(float(value), sa.Double())
    elif isinstance(kind, Utc):
        expected = "a date such as 2026-01-31 or 2026-01-31T12:00"
        with suppress(ValueError):
            moment = datetime.fromisoformat(str(value))
            return moment.replace(tzinfo=moment.tzinfo or UTC).astimezone(UTC)
    else:
        return str(value).lower() if isinstance(value, bool) else str(value)
    raise ConfigurationError(f"--where: {name} is compared with {expected}, got {value!r}")
