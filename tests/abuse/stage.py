"""A sweep as a program of its own on a logbook of its own, and what must hold of that logbook."""

import os
import secrets
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter
from tests.runner.programs import METRICS, ROOT, belonging_to, wait

LONGEST_S = 300.0


@dataclass
class Program:
    """A running command whose output goes to files: a pipe would outlive it in its children."""

    process: "subprocess.Popen[bytes]"
    files: tuple[Path, Path]
    token: str  # in the environment of the command and of all that it starts

    def family(self) -> list[int]:
        """The processes that are alive, the command's own and those it has started."""
        return belonging_to(self.token)

    def send_all(self, number: int) -> None:
        """Send a signal to the command and all it has started."""
        for pid in self.family():
            with suppress(ProcessLookupError):
                os.kill(pid, number)

    def ended(self) -> tuple[int, str, str]:
        """Exit code, standard output and standard error without a traceback, once it has ended."""
        try:
            code = self.process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            self.send_all(signal.SIGKILL)
            self.process.wait()
            raise AssertionError(f"it did not end in {LONGEST_S:.0f} s") from None
        out, err = (file.read_text("utf-8", "replace") for file in self.files)
        assert "Traceback (most recent call last)" not in err, err[-2000:]
        return code, out, err


@dataclass
class Stage:
    """A folder, a logbook and the sweep that fills it."""

    folder: Path
    overrides: tuple[str, ...]
    trials: int
    server: str | None = None  # address of an empty database; None: a file
    _started: int = field(default=0, init=False)

    def sweep(self) -> Program:
        """Start the sweep."""
        database = ("database=postgresql",) if self.server else ()
        return self.start("-m", "runner", "-m", *self.overrides, *database)

    def start(self, *arguments: str) -> Program:
        """Start `python ARGUMENTS`."""
        self._started += 1
        files = self.folder / f"{self._started}.out", self.folder / f"{self._started}.err"
        token = secrets.token_hex(16)
        own = {"PYTHONPATH": str(ROOT), "SEATRIAL_ABUSE": token}
        if self.server:
            own["SEATRIAL_DATABASE"] = self.server
        with files[0].open("wb") as out, files[1].open("wb") as err:
            process = subprocess.Popen(
                [sys.executable, *arguments], cwd=self.folder, env=os.environ | own,
                stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True,
            )  # fmt: skip
        return Program(process, files, f"SEATRIAL_ABUSE={token}")

    @contextmanager
    def logbook(self) -> Iterator[LogbookWriter | None]:
        """The logbook, or None while there is none that can be read."""
        url = self.server or f"sqlite:///{self.folder}/results/results.db"
        try:
            logbook = LogbookWriter.read(url, results_dir=self.folder / "results")
        except LogbookError:
            yield None
            return
        with logbook:
            yield logbook

    def await_sweep(self, program: Program) -> None:
        """Wait until a sweep of this program is in the logbook, or the program has ended."""
        query = f"SELECT count(*) FROM sweep WHERE pid = {program.process.pid}"

        def has_begun() -> bool:
            with self.logbook() as logbook:
                return logbook is not None and logbook.sql(query).rows != [(0,)]

        wait(lambda: program.process.poll() is not None or has_begun(), LONGEST_S)

    def check(self, before: frozenset[str] = frozenset()) -> frozenset[str]:
        """Nothing finished is lost, doubled or damaged; returns what is finished now."""
        with self.logbook() as logbook:
            if logbook is None:
                assert not before, "the logbook cannot be read any more"
                return before
            assert logbook.verify().problems == []
            runs = logbook.runs()
        broken = [run.run_id for run in runs if (run.status == "finished") != (run.metrics > 0)]
        assert not broken, f"runs {broken} are finished without metrics, or the reverse"
        finished = Counter(run.fingerprint for run in runs if run.status == "finished")
        assert not before - finished.keys(), "finished runs are lost"
        assert all(n == 1 for n in finished.values()), f"finished more than once: {finished}"
        return frozenset(finished)

    def complete(self) -> list[tuple[object, ...]]:
        """The same command finishes what is left; returns every metric, in an order of its own."""
        before = self.check()
        code, out, err = self.sweep().ended()
        assert code == 0, (out, err)
        already = f" ({len(before)} already in the logbook)" if before else ""
        assert f"{self.trials} finished{already}" in out, (out, before)
        assert len(self.check(before)) == self.trials
        with self.logbook() as logbook:
            assert logbook is not None
            assert logbook.verify().problems == []
            finished = METRICS.replace(" ORDER BY", " WHERE status = 'finished' ORDER BY")
            return sorted((tuple(row) for row in logbook.sql(finished).rows), key=repr)
