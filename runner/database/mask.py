"""Hides passwords of database addresses in every text that leaves: rows, messages, logs, output.

An address is typed in many forms: as it is, with Hydra's escapes (`postgresql\\://me\\:secret@host`),
quoted by a shell or by Python, percent-encoded. `Mask` finds a password by its place in an address,
and knows those that this process has met, in all of these forms.
"""

import re
import shlex
import sys
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import quote, unquote

_STARS = "***"
# Bounded, so that text made to be slow is not: a longer password is hidden once it is known.
_IN_URL = re.compile(r"(?P<before>:\\*/\\*/[^\s:/@?#]{0,200}:)[^\s]{0,1000}@")
_OPTION = re.compile(
    r"(?P<before>\b(?:ssl|pg)?password(?:\\*=|\\*['\"]\s*:\s*)[\\'\"]*)[^\s&'\"]+", re.IGNORECASE
)
# The same places in an address as it is meant, without escapes: there a password may hold spaces.
_TYPED = (re.compile(r"://[^\s:/@?#]*:([^@]*)@"), re.compile(r"(?i)[?&](?:ssl)?password=([^&]*)"))
_ADDRESS = re.compile(r"[+~]*(?:[\w.]*\.)?database(?:\.url\b|=\s*\{|=.*://).*", re.DOTALL)


class Mask:
    """Replaces passwords by three stars; calling it twice changes nothing more."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[re.Pattern[str], str]] = {}

    def learn(self, text: str) -> None:
        """Remember the password of the address in `text`, with its escapes or without."""
        for form in (text, re.sub(r"\\(.)", r"\1", text)):
            for place in _TYPED:
                for typed in place.findall(form):
                    self._remember(typed)

    def _remember(self, typed: str) -> None:
        plain = unquote(typed)
        for password in {typed, plain, quote(plain, safe=""), quote(plain, safe=" +")} - {""}:
            if password != _STARS and password not in self._known:
                self._known[password] = _finder(password)

    def __call__(self, text: str) -> str:
        """`text` with the passwords in it replaced."""
        for finder, shown in tuple(self._known.values()):
            text = finder.sub(shown, text)
        text = _IN_URL.sub(rf"\g<before>{_STARS}@", text)
        return _OPTION.sub(rf"\g<before>{_STARS}", text)


def _finder(password: str) -> tuple[re.Pattern[str], str]:
    """What finds a password, whatever quotes and escapes it, and what to write in its place.

    One that is a plain word or a number is hidden within addresses only: to hide the word wherever
    it stands would spoil results and point to it.
    """
    form = "".join(r"(?:'\"'\"'|\\*')" if c == "'" else rf"\\*{re.escape(c)}" for c in password)
    if len(password) < 5 or password.isalpha() or password.isdigit():
        return re.compile(rf":{form}(?=\\*@)"), f":{_STARS}"
    return re.compile(form), _STARS


_mask = Mask()
learn = _mask.learn


def without_passwords(text: str) -> str:
    """`text` with the passwords of addresses in it replaced by three stars."""
    return _mask(text)


def without_address(overrides: Iterable[str]) -> list[str]:
    """The overrides without those that say where the logbook is; `database=CHOICE` stays."""
    return [one for one in overrides if not _ADDRESS.match(one)]


def command_without_address(command: str) -> str:
    """A command line, as a shell reads it, without the words that say where the logbook is."""
    try:
        words = shlex.split(command)
    except ValueError:
        return without_passwords(command)
    kept = without_address(words)
    return without_passwords(shlex.join(kept) if kept != words else command)


class _Masked:
    """A stream that masks what is written to it, and is the stream in everything else."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        self._stream.write(without_passwords(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def masked_output() -> Iterator[None]:
    """Mask standard output and standard error while the block runs, and tracebacks ever after."""
    before: Any = sys.stdout, sys.stderr
    masked: Any = _Masked(sys.stdout), _Masked(sys.stderr)
    sys.excepthook = _show_masked
    sys.stdout, sys.stderr = masked
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _show_masked(kind: type[BaseException], error: BaseException, trace: Any) -> None:
    lines = traceback.format_exception(kind, error, trace)
    sys.stderr.write(without_passwords("".join(lines)))
