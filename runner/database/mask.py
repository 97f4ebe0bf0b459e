"""Masking of the passwords of database addresses in rows, messages, logs and output.

An address may be written in many forms: plain, with Hydra's escapes (`postgresql\\://me\\:secret@host`),
quoted by a shell or by Python, percent-encoded. `Mask` finds a password by its place in an address,
and finds every password that this process has read before in all of these forms.
"""

import logging
import re
import shlex
import sys
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any
from urllib.parse import quote, unquote

from seatrial.runner.database.terminal import visible

_STARS = "***"
# Bounded against quadratic matching time; a longer password is masked once it is known.
_IN_URL = re.compile(r"(?P<before>:\\*/\\*/[^\s:/@?#]{0,200}:)[^\s]{0,1000}@")
_OPTION = re.compile(
    r"(?P<before>\b(?:ssl|pg)?password(?:\\*=|\\*['\"]\s*:\s*)[\\'\"]*)[^\s&'\"]+", re.IGNORECASE
)
# The same places in an address without escapes, where a password may contain spaces.
_TYPED = (re.compile(r"://[^\s:/@?#]*:([^@]*)@"), re.compile(r"(?i)[?&](?:ssl)?password=([^&]*)"))
_ADDRESS = re.compile(r"[+~]*(?:[\w.]*\.)?database(?:\.url\b|=\s*\{|=.*://).*", re.DOTALL)


class Mask:
    """Replaces passwords by three stars; masking a text twice gives the same text."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[re.Pattern[str], str]] = {}

    def learn(self, text: str) -> None:
        """Remember the passwords of the addresses in `text`, with and without escapes."""
        for form in (text, re.sub(r"\\(.)", r"\1", text)):
            for pattern in _TYPED:
                for password in pattern.findall(form):
                    self._remember(password)

    def _remember(self, typed: str) -> None:
        plain = unquote(typed)
        for password in {typed, plain, quote(plain, safe=""), quote(plain, safe=" +")} - {""}:
            if password != _STARS and password not in self._known:
                self._known[password] = _finder(password)

    def __call__(self, text: str) -> str:
        """Return `text` with its passwords replaced."""
        for pattern, replacement in tuple(self._known.values()):
            text = pattern.sub(replacement, text)
        text = _IN_URL.sub(rf"\g<before>{_STARS}@", text)
        return _OPTION.sub(rf"\g<before>{_STARS}", text)


def _finder(password: str) -> tuple[re.Pattern[str], str]:
    """Return a pattern for a password with any quotes and escapes, and its replacement.

    A short password, a plain word or a number is masked within addresses only: masking the word
    everywhere would change results and reveal the password.
    """
    form = "".join(r"(?:'\"'\"'|\\*')" if c == "'" else rf"\\*{re.escape(c)}" for c in password)
    if len(password) < 5 or password.isalpha() or password.isdigit():
        return re.compile(rf":{form}(?=\\*@)"), f":{_STARS}"
    return re.compile(form), _STARS


_mask = Mask()
learn = _mask.learn


def without_passwords(text: str) -> str:
    """Return `text` with the passwords of addresses replaced by three stars."""
    return _mask(text)


def without_address(overrides: Iterable[str]) -> list[str]:
    """Return the overrides without the address of the logbook; `database=CHOICE` stays."""
    return [override for override in overrides if not _ADDRESS.match(override)]


def command_without_address(command: str) -> str:
    """Return a shell command line without the address of the logbook."""
    try:
        words = shlex.split(command)
    except ValueError:
        return without_passwords(command)
    remaining = without_address(words)
    return without_passwords(shlex.join(remaining) if remaining != words else command)


class _Masked:
    """A stream that masks the text written to it; other attributes are those of the stream.

    Control characters are written as escapes, except to `styled`: the same stream for a renderer
    of colours, which makes the text that it styles `visible` itself.
    """

    encoding = "utf-8"  # else click writes to the stream inside, past the mask

    def __init__(self, stream: Any, *, styled: bool = False) -> None:
        self._stream = stream
        self._styled = styled

    @property
    def styled(self) -> "_Masked":
        return _Masked(self._stream, styled=True)

    def write(self, text: str) -> int:
        shown = without_passwords(text)
        shown = shown if self._styled else visible(shown)
        try:
            self._stream.write(shown)
        except UnicodeEncodeError:  # a stream that is not UTF-8
            encoding = self._stream.encoding
            self._stream.write(shown.encode(encoding, "replace").decode(encoding))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def styled(stream: Any) -> Any:
    """Return the stream for a renderer of colours, which writes control characters."""
    return getattr(stream, "styled", stream)


@contextmanager
def masked_output(*, styled: bool = False) -> Iterator[None]:
    """Mask standard output and standard error in the block; tracebacks also after the block.

    Control characters are written as escapes, unless `styled`.
    """
    before: Any = sys.stdout, sys.stderr
    masked: Any = _Masked(sys.stdout, styled=styled), _Masked(sys.stderr, styled=styled)
    sys.excepthook = _show_masked
    sys.stdout, sys.stderr = masked
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _show_masked(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    lines = traceback.format_exception(kind, error, trace)
    sys.stderr.write(visible(without_passwords("".join(lines))))


class MaskedFormatter(logging.Formatter):
    """Formats the records of a log without passwords and control characters."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the text of a record."""
        return visible(without_passwords(super().format(record)))
