"""A sweep as a program of its own on a logbook of its own, and what must hold of that logbook."""

import os
import secrets
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.database import Logbook
from tests.runner import postgres as postgresql
from tests.runner.postgres import Postgres
from tests.runner.programs import METRICS, ROOT, belonging_to

LONGEST_S = 300.0
POSTGRES = "PostgreSQL"
SQLITE = "SQLite"


@dataclass
class Program:
    """A running command whose output goes to files: a pipe would outlive it in its children."""

    process: "subprocess.Popen[bytes]"
    files: tuple[Path, Path]
    token: str  # in the environment of the command and of all that it starts

    def family(self) -> list[int]:
        """The processes that are alive, the command's own and those it has started."""
        return belonging_to(self.token)

    def send(self, number: int) -> None:
        """Send a signal to the command alone."""
        if self.process.poll() is None:
            self.process.send_signal(number)

    def send_all(self, number: int) -> None:
        """Send a signal to the command and all it has started."""
        for pid in self.family():
            with suppress(ProcessLookupError):
                os.kill(pid, number)

    def ended(self, longest_s: float = LONGEST_S) -> tuple[int, str, str]:
        """Exit code, standard output and standard error, once it has ended; else it is killed."""
        try:
            code = self.process.wait(longest_s)
        except subprocess.TimeoutExpired:
            self.send_all(signal.SIGKILL)
            self.process.wait()
            raise AssertionError(f"it did not end in {longest_s:.0f} s") from None
        out, err = (file.read_text("utf-8", "replace") for file in self.files)
        return code, out, err


@dataclass
class Stage:
    """A folder, a logbook and the sweep that fills it."""

    folder: Path
    overrides: tuple[str, ...]
    trials: int
    url: str
    variables: dict[str, str] = field(default_factory=dict)
    _started: int = 0

    def start(self, *arguments: str) -> Program:
        """Start `python ARGUMENTS`."""
        self._started += 1
        name = f"{self._started}-{secrets.token_hex(4)}"
        files = self.folder / f"{name}.out", self.folder / f"{name}.err"
        token = f"SEATRIAL_ABUSE={secrets.token_hex(16)}"
        key, _, value = token.partition("=")
        environment = {**os.environ, "PYTHONPATH": str(ROOT), **self.variables, key: value}
        environment.pop("HYDRA_FULL_ERROR", None)
        with files[0].open("wb") as out, files[1].open("wb") as err:
            process = subprocess.Popen(
                [sys.executable, *arguments],
                cwd=self.folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )
        return Program(process, files, token)

    def sweep(self) -> Program:
        """Start the sweep."""
        return self.start("-m", "runner", "-m", *self.overrides)

    def compare(self, *arguments: str) -> Program:
        """Start a command of the comparison."""
        return self.start("-m", "runner.compare", *arguments, "--database", self.url)

    @contextmanager
    def logbook(self) -> Iterator[Logbook | None]:
        """The logbook, or None while there is none that can be read."""
        try:
            logbook = Logbook.read(self.url, results_dir=self.folder / "results")
        except LogbookError:
            yield None
            return
        with logbook:
            yield logbook

    def statuses(self) -> Counter[str]:
        """How many runs have each status."""
        with self.logbook() as logbook:
            return Counter(run.status for run in logbook.runs()) if logbook else Counter()

    def has_begun(self, program: Program) -> bool:
        """Whether a sweep of this program is in the logbook."""
        with self.logbook() as logbook:
            if logbook is None:
                return False
            query = f"SELECT count(*) FROM sweep WHERE pid = {program.process.pid}"
            return logbook.sql(query).rows != [(0,)]

    def check(self, before: frozenset[str] = frozenset()) -> frozenset[str]:
        """Nothing finished is lost, doubled or damaged; answers what is finished now."""
        with self.logbook() as logbook:
            if logbook is None:
                assert not before, "the logbook cannot be read any more"
                return before
            problems = logbook.verify().problems
            assert problems == [], f"verify: {problems}"
            runs = logbook.runs()
            broken = [run.run_id for run in runs if (run.status == "finished") != (run.metrics > 0)]
        finished = Counter(run.fingerprint for run in runs if run.status == "finished")
        assert not broken, f"runs {broken} are finished without metrics, or the reverse"
        assert not before - finished.keys(), (
            f"{len(before - finished.keys())} finished runs are lost"
        )
        assert all(n == 1 for n in finished.values()), f"finished more than once: {finished}"
        return frozenset(finished)

    def complete(self, expected: list[tuple[object, ...]] | None = None) -> str:
        """The same command finishes what is left, and all is as it would have been."""
        code, out, err = self.sweep().ended()
        assert code == 0, f"exit code {code}: {out[-300:]!r} {err[-300:]!r}"
        assert f"{self.trials} finished" in out, out[-300:]
        assert len(self.check()) == self.trials, "verify is clean, but trials are not finished"
        with self.logbook() as logbook:
            assert logbook is not None
            leftovers = logbook.verify().leftovers
            assert leftovers == [], f"left over: {leftovers}"
            results = measured(logbook)
        assert expected is None or results == expected, "the metrics are not those of a calm sweep"
        return out


def measured(logbook: Logbook) -> list[tuple[object, ...]]:
    """Every metric of the finished runs, in an order of its own."""
    finished = METRICS.replace(" ORDER BY", " WHERE status = 'finished' ORDER BY")
    return sorted((tuple(row) for row in logbook.sql(finished).rows), key=repr)


def quiet(err: str) -> None:
    """Assert that what a command said on standard error is no traceback."""
    before, traceback, after = err.partition("Traceback (most recent call last)")
    assert not traceback, f"traceback after {before[-200:]!r}: {after[:1500]!r}"


def wait(condition: Callable[[], object], what: str, longest_s: float = LONGEST_S) -> None:
    """Wait until a condition holds."""
    until = time.monotonic() + longest_s
    while not condition():
        assert time.monotonic() < until, f"{what}: not in {longest_s:.0f} s"
        time.sleep(0.05)


class Databases:
    """Makes stages on SQLite and on a PostgreSQL server, where there is one."""

    def __init__(self, folder: Path, server: Postgres | None, reason: str) -> None:
        self.server, self.reason = server, reason
        self._folder, self._made = folder, 0

    @property
    def kinds(self) -> Iterable[str]:
        """The databases that are here."""
        return (SQLITE, POSTGRES) if self.server else (SQLITE,)

    def stage(self, kind: str, overrides: tuple[str, ...], trials: int) -> Stage:
        """A stage with an empty folder and an empty database."""
        self._made += 1
        folder = self._folder / f"stage-{self._made}"
        folder.mkdir()
        if kind == SQLITE:
            return Stage(folder, overrides, trials, f"sqlite:///{folder}/results/results.db")
        assert self.server is not None
        url = self.server.new_database()
        options = (*overrides, "database=postgresql")
        return Stage(folder, options, trials, url, {"SEATRIAL_DATABASE": url})


@contextmanager
def databases(folder: Path) -> Iterator[Databases]:
    """Databases below a folder; the server is stopped afterwards."""
    serving = postgresql.served(folder)
    try:
        server, reason = next(serving), ""
    except pytest.skip.Exception as skip:
        server, reason = None, str(skip)
    try:
        yield Databases(folder, server, reason)
    finally:
        if server is not None:
            with suppress(StopIteration):
                next(serving)
