"""Database URLs: what may be asked for, and how they are shown without their password."""

import re
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from models.errors import LogbookError

_PASSWORD_IN_URL = re.compile(r"(?P<user>\b[\w+.-]+://[^\s:/@?#]*:)[^\s/?#]*@")
_PASSWORD_OPTION = re.compile(r"(?P<name>\b(?:ssl)?password=)[^\s&'\"]+", re.IGNORECASE)


@dataclass(frozen=True)
class Address:
    """Where a logbook is: a SQLite file (`path`) or a PostgreSQL database (`path` is None)."""

    url: URL
    path: Path | None

    @property
    def sqlite(self) -> bool:
        """Whether this is SQLite rather than PostgreSQL."""
        return self.path is not None

    def __str__(self) -> str:
        """How it is named to people: the file, or the URL without its password."""
        return str(self.path or display_url(self.url.set(drivername="postgresql")))


def parse(url: str) -> Address:
    """The address that `url` names; LogbookError where it names none."""
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError, TypeError):
        raise LogbookError(
            f"database.url is not a database URL: got {without_passwords(str(url))!r};"
            " expected sqlite:///FILE or postgresql://USER@HOST/NAME"
        ) from None
    dialect = parsed.get_backend_name()
    if dialect == "sqlite":
        return Address(parsed, _sqlite_file(parsed))
    if dialect in ("postgresql", "postgres"):
        return Address(parsed.set(drivername="postgresql+psycopg"), None)
    raise LogbookError(
        f"database.url: unknown database dialect {dialect!r} in {display_url(parsed)};"
        " expected sqlite or postgresql"
    )


def _sqlite_file(url: URL) -> Path:
    if url.host or url.query or not url.database or url.database == ":memory:":
        raise LogbookError(
            f"database.url: got {display_url(url)}; expected sqlite:///FILE"
            " (a file of its own, without options)"
        )
    return Path(url.database).absolute()


def display_url(url: str | URL) -> str:
    """`url` with every password replaced by three stars."""
    if isinstance(url, str):
        try:
            url = make_url(url)
        except (ArgumentError, ValueError, TypeError):
            return without_passwords(str(url))
    return without_passwords(url.render_as_string(hide_password=True))


def without_passwords(text: str) -> str:
    """`text` with the passwords of the URLs in it replaced by three stars."""
    return _PASSWORD_OPTION.sub(r"\g<name>***", _PASSWORD_IN_URL.sub(r"\g<user>***@", text))
