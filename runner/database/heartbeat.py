"""The sign of life of the runs of this process: a thread that touches their rows every 5 s."""

import logging
from threading import Event, Lock, Thread

from sqlalchemy import Engine, update
from sqlalchemy.exc import SQLAlchemyError

from models.errors import LogbookError
from runner.database import liveness
from runner.database.engine import one_line
from runner.database.tables import Run

_log = logging.getLogger(__name__)


class Heartbeat:
    """Touches the rows of the watched runs; starts with the first of them."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._runs: set[int] = set()
        self._lock = Lock()
        self._stopped = Event()
        self._thread: Thread | None = None

    def watch(self, run_id: int) -> None:
        """Keep the row of a run fresh from now on."""
        with self._lock:
            self._runs.add(run_id)
            if self._thread is None:
                self._thread = Thread(target=self._beat, name="heartbeat", daemon=True)
                self._thread.start()

    def forget(self, run_id: int) -> None:
        """Leave the row of a run alone from now on."""
        with self._lock:
            self._runs.discard(run_id)

    def stop(self) -> None:
        """End the thread, once a beat that is under way is done."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _beat(self) -> None:
        while not self._stopped.wait(liveness.HEARTBEAT_S):
            with self._lock:
                runs = sorted(self._runs)
            if runs:
                self._touch(runs)

    def _touch(self, runs: list[int]) -> None:
        try:
            with self._engine.begin() as connection:
                connection.execute(
                    update(Run)
                    .where(Run.id.in_(runs), Run.status == "running")
                    .values(heartbeat_at=liveness.database_now())
                )
        except (SQLAlchemyError, LogbookError) as error:
            # The next beat may pass; if none does, the run counts as interrupted.
            _log.warning("no heartbeat for runs %s: %s", runs, one_line(error))
