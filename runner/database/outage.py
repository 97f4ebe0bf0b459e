"""Outages of a PostgreSQL server: wait for it, and repeat interrupted transactions.

The program waits only for a server that it has reached before, so a wrong address is reported at
once. After a timeout it does not wait again until the server has been reached.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from sqlalchemy import URL, Dialect, Engine, ExceptionContext, event
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.pool import ConnectionPoolEntry

from seatrial.models.errors import LogbookError
from seatrial.runner.database.mask import without_passwords

PATIENCE_S = 60.0
FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 2.0
SHUTDOWN_STATES = ("57P01", "57P02", "57P03")  # by an administrator, by a crash, while starting
_worth_waiting: dict[URL, bool] = {}  # by URL with password: a wrong password is a different URL
_given_up: set[URL] = set()  # servers that did not come back in time
T = TypeVar("T")


def expect(url: URL) -> None:
    """Wait for the server at `url` from now on: another process has reached it."""
    _worth_waiting.setdefault(url, True)


def hurry(url: URL) -> None:
    """Do not wait for the server at `url` until it has been reached again."""
    _worth_waiting[url] = False


def repeated(task: Callable[[], T]) -> T:
    """Run `task`, and repeat it if the connection to the server is lost meanwhile.

    The task must check whether it is already done: the reply to a commit may be lost.
    """
    for wait_s in _waits():
        try:
            return task()
        except DBAPIError as error:
            if not (error.connection_invalidated or is_loss(error)):
                raise
        time.sleep(wait_s)
    return task()


def is_loss(error: DBAPIError) -> bool:
    """Whether the connection to the server is lost.

    Its farewell can be read before the connection is seen to be closed. An operational error of
    psycopg without a state is one of the connection: what the server refuses has a state.
    """
    state = getattr(error.orig, "sqlstate", "")  # SQLite's errors have none
    if state is None:
        return isinstance(error, OperationalError)
    return state in SHUTDOWN_STATES or state.startswith("08")


def wait_for_server(engine: Engine) -> None:
    """Make `engine` wait for its server if it was reached before.

    Connections are made on demand, so only the thread that needs one waits.
    """

    @event.listens_for(engine, "do_connect")
    def _connect(
        dialect: Dialect,
        record: ConnectionPoolEntry,
        args: Sequence[object],
        options: Mapping[str, object],
    ) -> DBAPIConnection:
        refusal = dialect.loaded_dbapi.OperationalError
        connection = _connected(lambda: dialect.connect(*args, **options), engine.url, refusal)
        _worth_waiting[engine.url] = True
        _given_up.discard(engine.url)
        return connection

    @event.listens_for(engine, "handle_error")
    def _lost(context: ExceptionContext) -> None:
        error = context.sqlalchemy_exception
        if isinstance(error, DBAPIError) and is_loss(error):
            context.is_disconnect = True


def _connected(connect: Callable[[], T], url: URL, refusal: type[Exception]) -> T:
    for wait_s in _waits():
        try:
            return connect()
        except refusal as error:
            message = without_passwords(str(error).strip().partition("\n")[0])
            if url in _given_up:  # by another thread, or for another connection
                break
            if not _worth_waiting.get(url):
                raise
        time.sleep(wait_s)
    _worth_waiting[url] = False
    _given_up.add(url)
    shown = url.set(drivername="postgresql").render_as_string(hide_password=True)
    raise LogbookError(
        f"{without_passwords(shown)}: {message}; the server did not come back in {PATIENCE_S:.0f} s"
    )


def _waits() -> Iterator[float]:
    """Yield increasing waits [s], PATIENCE_S in total."""
    until = time.monotonic() + PATIENCE_S
    wait_s = FIRST_WAIT_S
    while (left_s := until - time.monotonic()) > 0.0:
        yield min(wait_s, left_s)
        wait_s = min(2.0 * wait_s, LONGEST_WAIT_S)
