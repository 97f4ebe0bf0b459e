"""Expressions as statements of C, MATLAB and Python.

A language is a table: the spelling of each operation, of an entry of an argument, and of an
assignment. A new one is a new row; see `seatrial.models.symbols` for other uses of expressions.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from seatrial.models.symbols import ENTRY, evaluate

LONGEST_OPERAND = 60  # characters of an operand that is not assigned to a variable
ATOM, SIGN, PRODUCT, SUM, COMPARISON = range(5)  # how loosely the parts of a text are bound
OPERATORS = {
    "add": ("+", SUM), "subtract": ("-", SUM), "multiply": ("*", PRODUCT), "divide": ("/", PRODUCT),
    "less": ("<", COMPARISON), "less_equal": ("<=", COMPARISON),
    "greater": (">", COMPARISON), "greater_equal": (">=", COMPARISON),
}  # fmt: skip


class Text(NamedTuple):
    """An expression as text, and how loosely its parts are bound."""

    text: str
    binding: int = ATOM

    def within(self, binding: int) -> str:
        """The text as a part of another one."""
        return f"({self.text})" if self.binding > binding else self.text


class Language(NamedTuple):
    """How a language spells expressions."""

    functions: Mapping[str, str]  # with a name that differs from that in numpy
    where: str  # the format of a choice
    entry: str
    first: int  # index of the first entry
    variable: str  # the format of the definition of a variable
    assignment: str
    function: str = "{}"  # the format of the name of any other function


C = Language(
    {"absolute": "fabs", "arctan2": "atan2", "minimum": "fmin", "maximum": "fmax"},
    "({} ? {} : {})", "{}[{}]", 0, "const double {} = {};", "{} = {};",
)  # fmt: skip
MATLAB = Language(
    {"absolute": "abs", "arctan2": "atan2", "minimum": "min", "maximum": "max"},
    "where({}, {}, {})", "{}({})", 1, "{} = {};", "{} = {};",
)  # fmt: skip
PYTHON = Language({}, "np.where({}, {}, {})", "{}[{}]", 0, "{} = {}", "{} = {}", "np.{}")


def statements(language: Language, **outputs: Collection[Any]) -> list[str]:
    """Statements that write arrays: `outputs` are their symbols and numbers, by name.

    What is used several times, or is long, is assigned to a variable t1, t2, ... first.
    """
    lines: list[str] = []

    def apply(operation: str, operands: Sequence[Any], uses: int) -> Text:
        if operation == ENTRY:
            name, index = operands
            return Text(language.entry.format(name, index + language.first))
        found = _spelled(language, operation, [*map(_text, operands)])
        if uses == 1 and len(found.text) <= LONGEST_OPERAND:
            return found
        variable = f"t{len(lines) + 1}"
        lines.append(language.variable.format(variable, found.text))
        return Text(variable)

    values = evaluate([one for symbols in outputs.values() for one in symbols], apply)
    targets = [
        language.entry.format(name, i + language.first)
        for name, symbols in outputs.items()
        for i in range(len(symbols))
    ]
    return lines + [
        language.assignment.format(target, _text(value).text)
        for target, value in zip(targets, values, strict=True)
        if _text(value).text != target
    ]


def _text(value: Text | float) -> Text:
    """A number with every digit."""
    return value if isinstance(value, Text) else Text(repr(float(value)), SIGN * (value < 0.0))


def _spelled(language: Language, operation: str, operands: Sequence[Text]) -> Text:
    """An operation on texts; products and sums are read from the left, as they were computed."""
    if operation == "negative":
        return Text(f"-{operands[0].within(ATOM)}", SIGN)
    if operation == "where":
        return Text(language.where.format(*(operand.text for operand in operands)))
    if operation in OPERATORS:
        sign, binding = OPERATORS[operation]
        left, right = operands
        if binding == SUM and right.text.startswith("-") and right.binding < SUM:
            sign, right = "-" if sign == "+" else "+", Text(right.text[1:], right.binding)
        tighter = ATOM if right.text.startswith("-") else binding - 1
        return Text(f"{left.within(binding)} {sign} {right.within(tighter)}", binding)
    name = language.functions.get(operation, language.function.format(operation))
    return Text(f"{name}({', '.join(operand.text for operand in operands)})")
