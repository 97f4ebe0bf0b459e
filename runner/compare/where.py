"""Conditions on runs: the language of --where, and its meaning.

    condition   := conjunction ("or" conjunction)*
    conjunction := negation ("and" negation)*
    negation    := "not" negation | "(" condition ")" | comparison
    comparison  := NAME ("=" | "==" | "!=" | "<>" | "<" | "<=" | ">" | ">=") VALUE
                 | NAME ["not"] "in" "(" VALUE ("," VALUE)* ")"
    VALUE       := number | 'text' | "text" | bare_word | true | false | null

A NAME is a column of table `run` (identifier, seed, status, ...) or a dotted key of the
configuration (plant.scale, identifier.force). SQL reads the levels of the names, and pandas says
where a comparison of them holds (`met`): text from the command line never becomes SQL.
"""

import ast
import json
import operator as op
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.database.tables import Utc

Value = str | float | None  # true and false are texts
Compared = Callable[[str, str, Sequence[Value]], Any]  # name, operator, values
ORDERINGS: dict[str, Callable[[Any, Any], Any]] = {
    "<": op.lt, "<=": op.le, ">": op.gt, ">=": op.ge,
}  # fmt: skip
OF_JSON = (bool, list, dict)
WORDS: dict[str, Value] = {"true": "true", "false": "false", "null": None}  # in any case
_INTEGER = re.compile(r"[+-]?\d{1,18}", re.ASCII)
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
VALUE = r"""'(?:[^']|'')*'|"(?:[^"]|"")*"|[A-Za-z0-9_.+\-:/]+"""
NAME = re.compile(r"[A-Za-z_]\w*(?:\.\w+)*", re.ASCII)
TOKEN = re.compile(
    rf"""\s*(?:(?P<name>{NAME.pattern})(?:\s*(?P<sign><>|[<>!=]=|[<>=])\s*(?P<value>{VALUE})
    |\s+(?P<no>not\s+)?in\s*\(\s*(?P<values>(?:{VALUE})(?:\s*,\s*(?:{VALUE}))*)\s*\))
    |(?P<joint>and\b|or\b|not\b|[()]))""",
    re.VERBOSE | re.IGNORECASE | re.ASCII,
)


@dataclass(frozen=True)
class Condition:
    """What selects runs: sweeps (own or reused runs), numbers, and the text that gave these."""

    text: str | None = None
    sweeps: tuple[int, ...] = ()  # empty: any
    runs: tuple[int, ...] | None = None  # None: any


EVERY_RUN = Condition()


def parse(text: str, compare: Compared) -> Any:
    """Return the meaning of a text: that of its comparisons, combined by `&`, `|` and `~`.

    `compare` gives the meaning of `name operator values`, of which `in` takes any number and an
    ordering one. Python reads the text, with a number in place of every comparison. Raises
    ConfigurationError if the text breaks the grammar above.
    """
    text, held, words, place = text.rstrip(), list[Any](), list[str](), 0

    def refused(start: int) -> ConfigurationError:
        rest = text[start:].strip()
        return ConfigurationError(
            f"--where: cannot read {repr(rest[:20]) if rest else 'the end'} at character"
            f" {len(text) - len(rest) + 1}; expected comparisons such as"
            ' "seed<10 and identifier=ls"'
        )

    def meaning(node: ast.expr) -> Any:
        match node:
            case ast.BoolOp(op=joint, values=parts):
                both = op.and_ if isinstance(joint, ast.And) else op.or_
                return reduce(both, map(meaning, parts))
            case ast.UnaryOp(op=ast.Not(), operand=part):
                return ~meaning(part)
            case ast.Constant(value=int(number)):
                return held[number]
        raise refused(0)

    while place < len(text):
        token = TOKEN.match(text, place)
        if token is None:
            raise refused(place)
        words.append(token["joint"] or str(len(held)))
        if not token["joint"]:
            sign = token["sign"]
            values = [*map(value_of, re.findall(VALUE, token["value"] or token["values"]))]
            if sign in ORDERINGS and values == [None]:
                raise refused(place)
            met = compare(token["name"], sign if sign in ORDERINGS else "in", values)
            held.append(~met if token["no"] or sign in ("!=", "<>") else met)
        place = token.end()
    try:
        return meaning(ast.parse(" ".join(words).lower(), mode="eval").body)
    except (SyntaxError, MemoryError, RecursionError):
        raise refused(0) from None


def value_of(word: str) -> Value:
    """Return a quoted text, or what an unquoted word looks like."""
    if word[0] in "'\"":
        return word[1:-1].replace(2 * word[0], word[0])
    if _INTEGER.fullmatch(word):
        return int(word)
    return float(word) if _NUMBER.fullmatch(word) else WORDS.get(word.lower(), word)


def compared(text: str) -> dict[str, list[Value]]:
    """Return the names of a condition, in order, each with the values that it is compared with."""
    found = dict[str, list[Value]]()

    def compare(name: str, _: str, values: Sequence[Value]) -> np.bool_:
        found[name] = [*found.get(name, ()), *values]
        return np.True_

    parse(text, compare)
    return found


def met(text: str, levels: pd.DataFrame) -> "pd.Series[bool]":
    """Return where a condition holds of the levels of its names, a column each.

    A level is compared with a text as text, with a number as what it looks like. One of another
    kind is unequal, and so is a missing level to any value but null.
    """

    def compare(name: str, operator: str, values: Sequence[Value]) -> "pd.Series[bool]":
        own = levels[name]
        texts = own.astype(object).map(as_text, na_action="ignore").astype(object)
        numbers = pd.to_numeric(texts, errors="coerce")
        if operator in ORDERINGS:
            known = (texts if isinstance(values[0], str) else numbers).dropna()
            return ORDERINGS[operator](known, values[0]).reindex(own.index, fill_value=False)
        among = texts.isin([value for value in values if isinstance(value, str)])
        among |= numbers.isin([value for value in values if not isinstance(value, str | None)])
        return among | own.isna() if None in values else among

    held: pd.Series[bool] = parse(text, compare)
    return held


def as_text(level: object) -> str:
    """Return a level as text, as it is shown in rows and columns.

    What is of JSON is JSON, and a time is its ISO text in UTC.
    """
    if isinstance(level, datetime):
        return level.isoformat()
    return json.dumps(level, separators=(",", ":")) if isinstance(level, OF_JSON) else str(level)


def expected_of(column: sa.ColumnElement[Any] | None, value: Value) -> str | None:
    """Return what a column is compared with, if the value is none of these."""
    kind = None if column is None or value is None else column.type
    if isinstance(kind, sa.Boolean) and value not in ("true", "false"):
        return "true or false"
    if isinstance(kind, sa.Integer | sa.Float) and isinstance(value, str):
        return "a number"
    if isinstance(kind, Utc) and not re.match(r"\d{4}-\d\d", str(value)):
        return "a date such as 2026-01-31 or 2026-01-31T12:00"
    return None
