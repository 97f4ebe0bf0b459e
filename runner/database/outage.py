"""A PostgreSQL server that goes away for a while: waited for, and what it broke off is repeated.

Only a server that has been reached is waited for: a wrong address is told at once. One that does
not come back in time is not waited for again, until it has been reached.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from sqlalchemy import URL, Engine, event
from sqlalchemy.exc import DBAPIError

from seatrial.models.errors import LogbookError
from seatrial.runner.database.mask import without_passwords

PATIENCE_S = 60.0
FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 2.0
_worth_waiting: dict[URL, bool] = {}  # with the password: a wrong one never reaches anything
T = TypeVar("T")


def expect(url: URL) -> None:
    """Wait for the server at `url` from the first: another process has reached it."""
    _worth_waiting.setdefault(url, True)


def hurry(url: URL) -> None:
    """Do not wait for the server at `url` until it has been reached again."""
    _worth_waiting[url] = False


def repeated(task: Callable[[], T]) -> T:
    """What `task` gives, which is repeated where the server goes away in the middle of it.

    The task must find out whether it has been done already: a commit may be lost on its way back.
    """
    for wait_s in _waits():
        try:
            return task()
        except DBAPIError as error:
            if not error.connection_invalidated:
                raise
        time.sleep(wait_s)
    return task()


def wait_for_server(engine: Engine) -> None:
    """Let `engine` wait where the server cannot be connected to, if it has been before.

    A connection is made when it is needed, so that whoever needs one waits.
    """

    @event.listens_for(engine, "do_connect")
    def _connect(dialect: Any, record: Any, args: list[Any], options: dict[str, Any]) -> Any:
        connection = _connected(lambda: dialect.connect(*args, **options), engine.url)
        _worth_waiting[engine.url] = True
        return connection


def _connected(connect: Callable[[], T], url: URL) -> T:
    import psycopg

    for wait_s in _waits():
        try:
            return connect()
        except psycopg.OperationalError as error:
            if not _worth_waiting.get(url):
                raise
            said = without_passwords(str(error).strip().partition("\n")[0])
        time.sleep(wait_s)
    _worth_waiting[url] = False
    shown = url.set(drivername="postgresql").render_as_string(hide_password=True)
    raise LogbookError(
        f"{without_passwords(shown)}: {said}; the server did not come back in {PATIENCE_S:.0f} s"
    )


def _waits() -> Iterator[float]:
    """Longer and longer waits [s], until patience has run out."""
    until = time.monotonic() + PATIENCE_S
    wait_s = FIRST_WAIT_S
    while (left_s := until - time.monotonic()) > 0.0:
        yield min(wait_s, left_s)
        wait_s = min(2.0 * wait_s, LONGEST_WAIT_S)
