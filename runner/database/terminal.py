"""Messages that are safe to print: a line of bounded length without control characters."""

import re
from collections.abc import Iterable

from seatrial.models.errors import ConfigurationError

_LINE = 1000  # characters of a message
# C0 without tab and newline, DEL, C1, overrides of the direction, and lone surrogates.
_HIDDEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_PASSWORD = re.compile(
    r"postgres[\w+]*://(?:[^:/?@]*:[^@]+@|[^?]*\?(?:.*&)?(?:ssl)?password=)", re.IGNORECASE
)


def visible(text: str) -> str:
    r"""Return `text` with control characters as escapes such as ``\x1b``; tab and newline stay."""
    return _HIDDEN.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def error_line(message: str) -> str:
    """Return a message on one line; the middle of a long one is left out."""
    line = visible(" ".join(message.split()))
    return line if len(line) <= _LINE else f"{line[: _LINE // 2]} … {line[-_LINE // 3 :]}"


def refuse_passwords(texts: Iterable[str]) -> None:
    r"""Raise ConfigurationError if a text, such as an override, holds a password.

    Options are stored with the results, printed and shown in lists of processes. An address may
    have Hydra's escapes: `database.url=postgresql\://me\:secret@host/name`.
    """
    if any(_PASSWORD.search(text.replace("\\", "")) for text in texts):
        raise ConfigurationError(
            "the address of the database holds a password, which must not be an option: use"
            " SEATRIAL_DATABASE, PGPASSWORD or ~/.pgpass"
        )
