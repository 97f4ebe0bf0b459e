"""A PostgreSQL server that is away for up to a minute: transactions are repeated until it is back.

Only a server that this program has reached before is waited for, so that a wrong address is
reported at once; after a minute in vain it is not waited for again until it has been reached.
"""

from collections.abc import Callable
from typing import TypeVar

from sqlalchemy import URL
from sqlalchemy.exc import DBAPIError, OperationalError
from tenacity import Retrying, retry_if_exception, stop_after_delay, wait_exponential

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import Address, one_line

PATIENCE_S = 60.0
WAITS = wait_exponential(multiplier=0.1, max=2.0)  # [s]
SHUTDOWN_STATES = ("57P01", "57P02", "57P03")  # by an administrator, by a crash, while starting
_reached: set[URL] = set()
T = TypeVar("T")


def expect(address: Address) -> None:
    """Wait for the server from now on: another process has reached it."""
    _reached.add(address.url)


def hurry(address: Address) -> None:
    """Do not wait for the server until it has been reached again; ends the waits of threads."""
    _reached.discard(address.url)


def repeated(address: Address, task: Callable[[], T]) -> T:
    """Run `task`, and repeat it while the server is away.

    Args:
        address: Where the logbook is; a task on SQLite runs once.
        task: A transaction. It must check whether it is already done, because the reply to a commit
            may be lost.

    Returns:
        What the task returns.

    Raises:
        LogbookError: The server did not come back in PATIENCE_S.
        DBAPIError: Any other error of the database.
    """
    if address.path is not None:
        return task()
    waits = Retrying(
        retry=retry_if_exception(is_outage),
        wait=WAITS,
        stop=stop_after_delay(PATIENCE_S) | (lambda _: address.url not in _reached),  # type: ignore[operator]
        reraise=True,
    )
    try:
        result = waits(task)
    except DBAPIError as error:
        if not is_outage(error) or address.url not in _reached:
            raise
        hurry(address)
        raise LogbookError(
            f"{address}: {one_line(error)}; the server did not come back in {PATIENCE_S:.0f} s"
        ) from error
    expect(address)
    return result


def is_outage(error: BaseException) -> bool:
    """Return whether an error means that the server is away.

    The server's last message can be read before the connection is seen to be closed. An operational
    error of psycopg without a state is one of the connection: what a server refuses has a state.
    """
    if not isinstance(error, DBAPIError):
        return False
    state = getattr(error.orig, "sqlstate", "")
    if state is None:
        return isinstance(error, OperationalError)
    return error.connection_invalidated or state in SHUTDOWN_STATES or state.startswith("08")
