"""The language of --where: comparisons of known names with values, joined by and, or, not.

    condition   := conjunction ("or" conjunction)*
    conjunction := negation ("and" negation)*
    negation    := "not" negation | "(" condition ")" | comparison
    comparison  := NAME ("=" | "==" | "!=" | "<>" | "<" | "<=" | ">" | ">=") VALUE
                 | NAME ["not"] "in" "(" VALUE ("," VALUE)* ")"
    VALUE       := number | 'text' | "text" | bare_word | true | false | null

Parsing gives a tree of plain objects. Only two parts of it reach SQL: names that are in the list of
known names, and values, which are bound as parameters (see `factors`).
"""

import operator as op
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from seatrial.models.errors import ConfigurationError

Value = str | float | int | bool | None
OPERATORS = {
    "=": "=",
    "==": "=",
    "!=": "!=",
    "<>": "!=",
    "<": "<",
    "<=": "<=",
    ">": ">",
    ">=": ">=",
}
ORDERINGS: dict[str, Callable[[Any, Any], bool]] = {
    "<": op.lt, "<=": op.le, ">": op.gt, ">=": op.ge,
}  # fmt: skip
MAX_DEPTH = 50
KEYWORDS = {"and", "or", "not", "in"}
CONSTANTS: dict[str, Value] = {"true": True, "false": False, "null": None}
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
class Comparison:
    """Compares one name with one value."""

    name: str
    operator: str  # one of OPERATORS' values
    value: Value


@dataclass(frozen=True)
class Among:
    """Tests whether the value of a name is in a list."""

    name: str
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Not:
    """Negates a condition."""

    condition: "Condition"


@dataclass(frozen=True)
class Joined:
    """Joins conditions: all ("and") or at least one ("or") must hold."""

    by: str
    conditions: tuple["Condition", ...]


@dataclass(frozen=True)
class OfSweeps:
    """Tests whether a run belongs to one of the sweeps, as its own or as one that it reused."""

    numbers: tuple[int, ...]


Condition = Comparison | Among | Not | Joined | OfSweeps


@dataclass(frozen=True)
class Token:
    """A token of the text; `kind` is text, operator, mark, word or end."""

    kind: str
    text: str
    position: int


def meets(condition: Condition, level: Callable[[str], str | None], sweep: int) -> bool | None:
    """Return whether a trial meets a condition; None if a name in it is not known of the trial.

    `level` gives the level of a name, as text, or None; `sweep` is the number of its sweep.
    """
    match condition:
        case OfSweeps(numbers=numbers):
            return sweep in numbers
        case Not(condition=inner):
            known = meets(inner, level, sweep)
            return None if known is None else not known
        case Joined(by=by, conditions=parts):
            each = [meets(part, level, sweep) for part in parts]
            decides = by == "or"  # one part that is true decides `or`, one that is false `and`
            return decides if decides in each else None if None in each else not decides
        case Among(name=name, values=values):
            own = level(name)
            return None if own is None else bare_value(own) in values
        case Comparison(name=name, operator=operator, value=value):
            own = level(name)
            return None if own is None else _compared(bare_value(own), operator, value)


def _compared(own: Value, operator: str, value: Value) -> bool:
    """Compare two values; numbers by size, and values of different types are unequal."""
    if operator in ("=", "!="):
        return (own == value) == (operator == "=")
    numbers = isinstance(own, int | float) and isinstance(value, int | float)
    if not (numbers or (isinstance(own, str) and isinstance(value, str))):
        return False
    return bool(ORDERINGS[operator](own, value))


def parse(text: str) -> Condition:
    """Return the condition of a text; raises ConfigurationError if it breaks the grammar above."""
    return _Parser(text).parse()


def tokens(text: str) -> list[Token]:
    """Split a condition into tokens; the last one is of kind `end`."""
    pieces: list[Token] = []
    position = 0
    while text[position:].strip():
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            rest = text[position:].strip()
            raise ConfigurationError(
                f"--where: cannot read {rest[:20]!r}; expected comparisons such as"
                ' "seed<10 and identifier=ls"'
            )
        pieces.append(Token(match.lastgroup, match[match.lastgroup], match.start(match.lastgroup)))
        position = match.end()
    return [*pieces, Token("end", "", len(text))]


class _Parser:
    """Recursive descent over the tokens, one method for each rule of the grammar."""

    def __init__(self, text: str) -> None:
        self.tokens = tokens(text)
        self.at = 0
        self.depth = 0

    def parse(self) -> Condition:
        condition = self.disjunction()
        if self.now.kind != "end":
            raise self.unexpected("and, or, or the end")
        return condition

    def disjunction(self) -> Condition:
        return self.joined("or", self.conjunction)

    def conjunction(self) -> Condition:
        return self.joined("and", self.negation)

    def joined(self, word: str, part: Callable[[], Condition]) -> Condition:
        parts: list[Condition] = [part()]
        while self.take_word(word):
            parts.append(part())
        return parts[0] if len(parts) == 1 else Joined(word, tuple(parts))

    def negation(self) -> Condition:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise ConfigurationError(f"--where: nested deeper than {MAX_DEPTH} levels")
        condition = self.negated_or_nested()
        self.depth -= 1
        return condition

    def negated_or_nested(self) -> Condition:
        if self.take_word("not"):
            return Not(self.negation())
        if self.take_mark("("):
            condition = self.disjunction()
            self.need_mark(")")
            return condition
        return self.comparison()

    def comparison(self) -> Condition:
        name = self.name()
        if self.take_word("not"):
            if not self.take_word("in"):
                raise self.unexpected("in")
            return Not(Among(name, self.values()))
        if self.take_word("in"):
            return Among(name, self.values())
        if self.now.kind != "operator":
            raise self.unexpected("one of = != < <= > >= in")
        operator = OPERATORS[self.take().text]
        value = self.value()
        if operator not in ("=", "!=") and (value is None or isinstance(value, bool)):
            raise ConfigurationError(
                f"--where: {name} {operator} {str(value).lower()} has no meaning; use = or !="
            )
        return Comparison(name, operator, value)

    def name(self) -> str:
        token = self.now
        known_word = token.text.lower() in KEYWORDS
        if token.kind != "word" or known_word or not NAME.fullmatch(token.text):
            raise self.unexpected("a column or a dotted name of the configuration")
        return self.take().text

    def values(self) -> tuple[Value, ...]:
        self.need_mark("(")
        values = [self.value()]
        while self.take_mark(","):
            values.append(self.value())
        self.need_mark(")")
        return tuple(values)

    def value(self) -> Value:
        token = self.now
        if token.kind == "text":
            quote = token.text[0]
            return self.take().text[1:-1].replace(2 * quote, quote)
        if token.kind != "word" or token.text.lower() in KEYWORDS:
            raise self.unexpected("a value")
        return bare_value(self.take().text)

    @property
    def now(self) -> Token:
        return self.tokens[self.at]

    def take(self) -> Token:
        token = self.now
        self.at += 1
        return token

    def take_word(self, word: str) -> bool:
        matches = self.now.kind == "word" and self.now.text.lower() == word
        self.at += matches
        return matches

    def take_mark(self, mark: str) -> bool:
        matches = self.now.kind == "mark" and self.now.text == mark
        self.at += matches
        return matches

    def need_mark(self, mark: str) -> None:
        if not self.take_mark(mark):
            raise self.unexpected(repr(mark))

    def unexpected(self, expected: str) -> ConfigurationError:
        got = repr(self.now.text) if self.now.kind != "end" else "the end"
        return ConfigurationError(
            f"--where: expected {expected}, got {got} at character {self.now.position + 1}"
        )


def bare_value(word: str) -> Value:
    """Return the value of an unquoted word: a constant, a number, or the text itself."""
    if word.lower() in CONSTANTS:
        return CONSTANTS[word.lower()]
    if _INTEGER.fullmatch(word):
        return int(word)
    return float(word) if _NUMBER.fullmatch(word) else word
