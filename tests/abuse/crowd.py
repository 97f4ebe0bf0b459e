"""Many programs on one logbook, a server that leaves, and programs that are suspended."""

import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Thread

from tests.abuse.ledger import Entry
from tests.abuse.stage import POSTGRES, SQLITE, Databases, Program, Stage, databases, quiet, wait
from tests.abuse.storm import MANY, SHORT

READERS = (
    ("runs",),
    ("table", "--metric", "force_mse"),
    ("verify",),
    ("show", "1"),
    ("sql", "SELECT status, count(*) FROM run GROUP BY 1"),
    ("report", "--output", "report.html"),
    ("export", "exported"),
    ("retry",),
)
LONG = (*SHORT, "identifier=none", "excitation.interval_s=600", "seed=range(0,8)")
JOBLIB = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
AWAY_S = 5.0
TOO_LONG_S = 75.0  # beyond the patience of the programs, and the age of a heartbeat


def crowd(folder: Path, seed: int, share: float = 1.0) -> list[Entry]:
    """Eight writers of the same sweep and four readers at once, on each database."""
    writers, readers = (8, 4) if share == 1.0 else (3, 1)
    entries = []
    with databases(folder) as bases:
        for kind in (SQLITE, POSTGRES) if share == 1.0 else (SQLITE,):
            entry = Entry(f"{writers} writers and {readers} readers at once, {kind}")
            entries.append(entry)
            if kind not in bases.kinds:
                entry.skipped = bases.reason
                continue
            _crowd(entry, bases.stage(kind, MANY, 24), writers, readers, seed)
    return entries


def _crowd(entry: Entry, stage: Stage, writers: int, readers: int, seed: int) -> None:
    repeat = f"python -m tests.abuse crowd --seed {seed}"
    began = time.monotonic()
    programs = [stage.sweep() for _ in range(writers)]
    threads = [
        Thread(target=_read, args=(entry, stage, programs, random.Random(seed + n), n, repeat))
        for n in range(readers)
    ]
    for thread in threads:
        thread.start()
    for number, program in enumerate(programs):
        with entry.attempt(f"writer {number}", repeat):
            code, out, err = program.ended(2 * 300.0)
            quiet(err)
            assert code == 0, f"exit code {code}: {out[-300:]!r} {err[-300:]!r}"
    for thread in threads:
        thread.join()
    with entry.attempt("what they stored", repeat):
        assert len(stage.check()) == 24, stage.statuses()
        with stage.logbook() as logbook:
            assert logbook is not None
            attempts = Counter(run.attempt for run in logbook.runs())
        assert attempts == {1: 24}, f"attempts: {attempts}"
        stage.complete()
    entry.seconds = time.monotonic() - began


def _read(
    entry: Entry,
    stage: Stage,
    writers: list[Program],
    chance: random.Random,
    number: int,
    repeat: str,
) -> None:
    while any(program.process.poll() is None for program in writers):
        command = list(chance.choice(READERS))
        command = [word.replace("report.html", f"report-{number}.html") for word in command]
        command = [word.replace("exported", f"exported-{number}") for word in command]
        began = bool(stage.statuses())  # whether there is something to read
        with entry.attempt(f"reader: {' '.join(command)}", repeat):
            code, _, err = stage.compare(*command).ended()
            quiet(err)
            assert code == 0 or (not began and code == 2), f"exit code {code}: {err[-300:]!r}"
            assert code == 0 or err.count("\n") == 1, err


def outage(folder: Path, seed: int, share: float = 1.0) -> list[Entry]:
    """The server is stopped, or crashes, in the middle of sweeps; it comes back soon or late."""
    entry = Entry("PostgreSQL stopped and started in the middle")
    chance = random.Random(f"{seed} outage")
    repeat = f"python -m tests.abuse outage --seed {seed}"
    with databases(folder) as bases:
        if bases.server is None:
            entry.skipped = bases.reason
            return [entry]
        began = time.monotonic()
        for launcher in ((), JOBLIB):
            for how in (signal.SIGINT, signal.SIGQUIT) if share == 1.0 else (signal.SIGQUIT,):
                with entry.attempt(f"{how.name}, {launcher[:1]}", repeat):
                    _away(bases, (*LONG, *launcher), how, chance, AWAY_S)
        if share == 1.0:
            with entry.attempt("away for longer than the programs wait", repeat):
                _away(bases, LONG, signal.SIGINT, chance, TOO_LONG_S)
        entry.seconds = time.monotonic() - began
    return [entry]


def _away(
    bases: Databases, overrides: tuple[str, ...], how: int, chance: random.Random, seconds: float
) -> None:
    stage, server = bases.stage(POSTGRES, overrides, 8), bases.server
    assert server is not None
    program = stage.sweep()
    wait(lambda: stage.statuses()["finished"] or program.process.poll() is not None, "a run")
    time.sleep(chance.uniform(0.0, 2.0))
    server.process.send_signal(how)
    server.process.wait(60)
    try:
        if seconds > 60.0:
            code, _, err = program.ended()
            quiet(err)
            assert code in (1, 2), f"exit code {code} without a server: {err[-300:]!r}"
            assert "the server did not come back" in err.splitlines()[-1], err[-300:]
        else:
            time.sleep(seconds)
    finally:
        server.come_back()
    if seconds <= 60.0:
        code, out, err = program.ended()
        quiet(err)
        assert code == 0, f"exit code {code}: {out[-300:]!r} {err[-300:]!r}"
        assert "8 finished" in out, out
    stage.complete()


def suspended(folder: Path, seed: int, share: float = 1.0) -> list[Entry]:
    """A sweep is suspended at any moment; the same command beside it goes on, and it as well."""
    entry = Entry("suspended in the middle, another beside it")
    chance = random.Random(f"{seed} suspended")
    repeat = f"python -m tests.abuse suspended --seed {seed}"
    began = time.monotonic()
    with databases(folder) as bases:
        tries: list[tuple[str, Callable[[], None]]] = []
        for kind in bases.kinds:
            for launcher in ((), JOBLIB) if share == 1.0 else (JOBLIB,):
                many = round(2 * share) or int(kind == SQLITE)
                task = partial(_beside, chance=chance, apart_s=0.0)
                tries += [
                    (f"{kind} {launcher[:1]}", partial(_on, bases, kind, launcher, task))
                ] * many
            if share == 1.0:
                task = partial(_beside, chance=chance, apart_s=TOO_LONG_S)
                tries.append(
                    (f"{kind}, for {TOO_LONG_S:.0f} s", partial(_on, bases, kind, (), task))
                )

        def attempt(each: tuple[str, Callable[[], None]]) -> None:
            with entry.attempt(each[0], repeat):
                each[1]()

        tries.reverse()  # the long ones first
        with ThreadPoolExecutor(4) as pool:  # they wait more than they work
            list(pool.map(attempt, tries))
    entry.seconds = time.monotonic() - began
    return [entry]


def _on(
    bases: Databases, kind: str, launcher: tuple[str, ...], task: Callable[[Stage], None]
) -> None:
    task(bases.stage(kind, (*LONG, *launcher), 8))


def _beside(stage: Stage, chance: random.Random, apart_s: float) -> None:
    first = stage.sweep()
    wait(lambda: sum(stage.statuses().values()) or first.process.poll() is not None, "a run")
    time.sleep(chance.uniform(0.0, 3.0))
    first.send_all(signal.SIGSTOP)
    try:
        time.sleep(apart_s)  # its heartbeat may be stale now: its run is another's
        code, out, err = stage.sweep().ended()
        quiet(err)
        # A program that is suspended while it writes holds SQLite's lock.
        locked = code == 2 and "locked" in err and err.splitlines()[-1].startswith("seatrial: ")
        assert code == 0 or locked, f"exit code {code}: {out[-300:]!r} {err[-300:]!r}"
        before = stage.check()
    finally:
        first.send_all(signal.SIGCONT)
    code, out, err = first.ended()
    quiet(err)
    assert code in (0, 1), f"exit code {code} after its suspension: {out[-300:]!r} {err[-300:]!r}"
    stage.check(before)
    stage.complete()
