"""Text and tables in Markdown in which nothing of the source is taken for mark-up."""

import re
from collections.abc import Sequence

_SPECIAL = {letter: f"&#{ord(letter)};" for letter in "&<>|*_{}[]\\`"}
_ESCAPED = str.maketrans(_SPECIAL)
_CODE = re.compile(r"`([^`]+)`")


def code(text: str) -> str:
    """A text as code; empty for an empty text."""
    return f"<code>{text.translate(_ESCAPED)}</code>" if text else ""


def prose(text: str) -> str:
    """A comment or docstring as plain text, on one line; what stands in backquotes is code."""
    pieces = _CODE.split(" ".join(text.split()))
    return "".join(
        code(piece) if i % 2 else piece.translate(_ESCAPED) for i, piece in enumerate(pieces)
    )


def table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of cells that are Markdown already; the empty string if there are no rows."""
    if not rows:
        return ""
    lines = [headers, ["---"] * len(headers), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
