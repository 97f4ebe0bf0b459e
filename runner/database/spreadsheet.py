"""Text cells of CSV files that a spreadsheet must not compute.

Spreadsheets take a cell that begins with =, +, -, @, a tab or a carriage return as a formula, which
may start programs or send the sheet to an address. A quote mark before it makes it text.
"""

import re
from typing import TypeVar

T = TypeVar("T")
_FORMULA = re.compile(r"[=+\-@\t\r\uff1d\uff0b\uff0d\uff20]")  # also the wide forms
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-](?:inf|nan)", re.ASCII)


def guarded(value: T) -> T | str:
    """Return a text that a spreadsheet would compute with a quote mark; others as they are."""
    if isinstance(value, str) and _FORMULA.match(value) and not _NUMBER.fullmatch(value):
        return f"'{value}"
    return value
