"""What other processes do to a logbook in the tests.

They are forked from a server that has imported everything once (and holds no connection). What
one has to say it writes to the file `said`; a failure leaves its traceback there.
"""

import multiprocessing
import resource
import time
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Results, Series
from tests.runner.database.samples import make_results, make_start

Say = Callable[[object], None]
_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload([__name__, "pyarrow.parquet", "sqlalchemy.dialects.postgresql"])


class Worker:
    """A process that works on the logbook at `url`."""

    def __init__(self, task: Callable[..., None], url: str, folder: Path, number: int) -> None:
        self._said = folder.parent / f"said-{number}-{time.monotonic_ns()}"
        self._said.touch()
        self.process = _FORKS.Process(target=_work, args=(task, url, folder, number, self._said))
        self.process.start()

    def said(self) -> list[str]:
        """The whole lines that it has written so far."""
        return self._said.read_text().rpartition("\n")[0].splitlines()

    def wait_until_it_speaks(self) -> None:
        until = time.monotonic() + 60
        while not self.said():
            assert time.monotonic() < until
            time.sleep(0.005)

    def kill(self) -> None:
        self.process.kill()
        self.process.join(60)

    def finish(self) -> None:
        """Wait for its end, which must be a good one."""
        self.process.join(240)
        assert self.process.exitcode == 0, "\n".join(self.said())


def _work(task: Callable[..., None], url: str, folder: Path, number: int, said: Path) -> None:
    with said.open("a", buffering=1) as file:
        try:
            with LogbookWriter.open(url, results_dir=folder) as logbook:
                task(logbook, number, lambda line: file.write(f"{line}\n"))
        except BaseException:
            traceback.print_exc(file=file)
            raise


def write_own(logbook: LogbookWriter, number: int, say: Say) -> None:
    """125 trials that nobody else does."""
    results = replace(make_results(), series=())
    for trial in range(number * 125, (number + 1) * 125):
        begun = logbook.begin_run(make_start(trial))
        assert begun.state == "new"
        logbook.finish_run(begun.run_id, results)


def write_shared(logbook: LogbookWriter, number: int, say: Say) -> None:
    """100 trials that every other worker tries as well, at the same time."""
    for trial in range(100):
        begun = logbook.begin_run(make_start(trial))
        if begun.state == "new":
            if trial % 2:
                time.sleep(0.002)
            logbook.finish_run(begun.run_id, Results(note=str(number)))


def write_until_killed(logbook: LogbookWriter, number: int, say: Say) -> None:
    """Trials with series, and what is finished is said."""
    for trial in range(number * 1000, (number + 1) * 1000):
        begun = logbook.begin_run(make_start(trial))
        if begun.state == "new":
            logbook.finish_run(begun.run_id, make_results())
            say(begun.run_id)


def write_until_full(logbook: LogbookWriter, number: int, say: Say) -> None:
    """Trials until a file cannot grow: the database for number 0, a series file for number 1."""
    limit = 200_000 if number == 0 else 2_000_000
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    results = make_results()
    if number == 1:
        long = {"t": np.random.default_rng(0).standard_normal(500_000)}  # 4 MB
        results = replace(results, series=[*results.series, Series("long", long, {"t": "s"})])
    for trial in range(4000):
        try:
            logbook.finish_run(logbook.begin_run(make_start(trial)).run_id, results)
        except LogbookError as error:
            say(error)
            return
