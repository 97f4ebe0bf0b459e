"""Text that is safe to print: no control characters, and messages of a bounded length.

Names, messages and tracebacks are stored as they were given, so a logbook may contain sequences
that move the cursor of a terminal, hide text or change its order. They are printed as escapes.
"""

import re
from collections.abc import Iterable, Iterator
from typing import TypeVar

ECHOED = 200  # characters that a message repeats of one text
_LINE = 4000  # characters of a message
# C0 without tab and newline, DEL, C1, marks and overrides of the direction, separators of lines,
# and lone surrogates (bytes of the command line or of a file that are not UTF-8).
_HIDDEN = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
_QUOTED = re.compile(r"(?<!\w)(?:'(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\")")
_WORD = re.compile(rf"\S{{{ECHOED + 1},}}")
T = TypeVar("T")
_FORMULA = re.compile(r"[=+\-@\t\r\uff1d\uff0b\uff0d\uff20]")  # also the wide forms
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-](?:inf|nan)", re.ASCII)


def visible(text: str) -> str:
    """Return `text` with control characters as escapes such as ``\\x1b``; tab and newline stay."""
    return _HIDDEN.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def shortened(text: str) -> str:
    """Return `text`, with the middle replaced by its length beyond ECHOED characters."""
    if len(text) <= ECHOED:
        return text
    return f"{text[:90]}… ({len(text)} characters) …{text[-60:]}"


def error_line(message: str, given: Iterable[str] = ()) -> str:
    """Return a message on one line that repeats at most ECHOED characters of any long text.

    `given` are the arguments of the command line; quoted texts and long words are found without
    them. Passwords are to be masked before: a part of one could not be recognised.
    """
    line = _flat(message)
    for text in sorted(set(_forms(given)), key=len, reverse=True):
        line = line.replace(text, shortened(text))
    line = _QUOTED.sub(lambda match: shortened(match[0]), line)
    line = _WORD.sub(lambda match: shortened(match[0]), line)
    return line if len(line) <= _LINE else f"{line[: _LINE - 1]}…"


def _forms(given: Iterable[str]) -> Iterator[str]:
    """Yield the long texts of the arguments and of their values, as messages show them."""
    for argument in given:
        for text in (argument, argument.partition("=")[2]):
            for form in (_flat(text), _flat(repr(text)[1:-1])):
                if len(form) > ECHOED:
                    yield form


def _flat(text: str) -> str:
    return visible(" ".join(text.split()))


def guarded(value: T) -> T | str:
    """Return a text that a spreadsheet would compute with a quote mark; others as they are.

    Spreadsheets take a cell that begins with =, +, -, @, a tab or a carriage return as a formula,
    which may start programs or send the sheet to an address.
    """
    if isinstance(value, str) and _FORMULA.match(value) and not _NUMBER.fullmatch(value):
        return f"'{value}"
    return value
