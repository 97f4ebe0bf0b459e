"""Kills from outside in the middle of sweeps, until the same command has completed them."""

import random
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from os import kill
from pathlib import Path

from tests.abuse.ledger import Entry
from tests.abuse.stage import (
    POSTGRES,
    SQLITE,
    Databases,
    Program,
    Stage,
    databases,
    measured,
    quiet,
    wait,
)

SHORT = ("evaluation=none", "excitation.interval_s=120")
MANY = (*SHORT, "identifier=none,ls", "disturbance=calm,noise", "seed=range(0,6)")
FEW = (*SHORT, "identifier=ls", "disturbance=noise", "seed=range(0,3)")
LAUNCHERS = {
    "basic": (MANY, 24),
    "joblib": ((*MANY, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"), 24),
    # Each job is a process that starts by itself.
    "submitit_local": ((*FEW, "hydra/launcher=submitit_local"), 3),
}
KILLS = {"basic": 20, "joblib": 20, "submitit_local": 10}
PER_ROUND = 5
STOPS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
INTERRUPTED = "seatrial: interrupted: finished runs are kept, the same command runs the rest"


@dataclass(frozen=True)
class Calm:
    """What undisturbed sweeps take and give."""

    start_s: float
    each_s: float
    many: list[tuple[object, ...]]
    few: list[tuple[object, ...]]


def calm(bases: Databases, share: float) -> Calm:
    """Run the sweeps that are to be disturbed."""
    results: list[list[tuple[object, ...]]] = []
    times = []
    for overrides, trials in ((MANY, 24), (FEW, 3)) if share == 1.0 else ((MANY, 24),):
        stage = bases.stage(SQLITE, overrides, trials)
        began = time.monotonic()
        program = stage.sweep()
        wait(lambda p=program, s=stage: s.has_begun(p) or p.process.poll() is not None, "start")
        start = time.monotonic() - began
        code, _, err = program.ended()
        assert code == 0, err
        times.append((start, (time.monotonic() - began - start) / trials))
        with stage.logbook() as logbook:
            assert logbook is not None
            results.append(measured(logbook))
    return Calm(*times[0], results[0], results[-1])


def storm(folder: Path, seed: int, share: float = 1.0) -> list[Entry]:
    """Kill sweeps of each launcher on each database, three of them at a time."""
    with databases(folder) as bases:
        reference = calm(bases, share)
        tasks = [
            (launcher, kind, max(1, round(share * kills) - 1) if share < 1.0 else kills)
            for launcher, kills in KILLS.items()
            for kind in (SQLITE, POSTGRES)
        ]
        if share < 1.0:  # each job of submitit is a process that starts by itself
            tasks = [tasks[0], tasks[3]]

        def task(order: tuple[str, str, int]) -> Entry:
            launcher, kind, kills = order
            entry = Entry(f"{kills} kills: {launcher}, {kind}")
            if kind not in bases.kinds:
                entry.skipped = bases.reason
                return entry
            since = time.monotonic()
            chance = random.Random(f"{seed} {launcher} {kind}")
            _storm(entry, bases, reference, launcher, kind, kills, chance, seed)
            entry.seconds = time.monotonic() - since
            return entry

        with ThreadPoolExecutor(3) as pool:
            return list(pool.map(task, tasks))


def _storm(
    entry: Entry, bases: Databases, reference: Calm, launcher: str, kind: str, kills: int,
    chance: random.Random, seed: int,
) -> None:  # fmt: skip
    repeat = f"python -m tests.abuse storm --seed {seed}"
    overrides, trials = LAUNCHERS[launcher]
    expected = reference.many if trials == 24 else reference.few
    for blows in _rounds(kills):
        stage = bases.stage(kind, overrides, trials)
        finished: frozenset[str] = frozenset()
        for _ in range(blows):
            blow = chance.choices(BLOWS, WEIGHTS)[0]
            with entry.attempt(f"{launcher}, {kind}, {blow.__name__}", repeat):
                program = stage.sweep()
                try:
                    blow(stage, program, reference, chance)
                finally:
                    program.send_all(signal.SIGKILL)
                    program.process.wait()
                finished = stage.check(finished)
        with entry.attempt(f"{launcher}, {kind}, completion", repeat):
            finished = stage.check(finished)
            out = stage.complete(expected)
            known = (
                f"{trials} finished ({len(finished)} already" if finished else f"{trials} finished,"
            )
            assert known in out, f"expected {known!r} in {out[-300:]!r}"


def _rounds(kills: int) -> Iterator[int]:
    for first in range(0, kills, PER_ROUND):
        yield min(PER_ROUND, kills - first)


# How a sweep is killed. Each returns when the sweep and all it has started are gone.


def kill_at_start(stage: Stage, program: Program, reference: Calm, chance: random.Random) -> None:
    """SIGKILL to all processes before or while the logbook is opened."""
    time.sleep(chance.uniform(0.0, 1.2 * reference.start_s))
    program.send_all(signal.SIGKILL)


def kill_all(stage: Stage, program: Program, reference: Calm, chance: random.Random) -> None:
    """SIGKILL to all processes in the middle of runs."""
    _in_the_middle(stage, program, reference, chance)
    program.send_all(signal.SIGKILL)


def kill_parent(stage: Stage, program: Program, reference: Calm, chance: random.Random) -> None:
    """SIGKILL to the command alone; what it has started must end by itself."""
    _in_the_middle(stage, program, reference, chance)
    program.send(signal.SIGKILL)
    program.process.wait()
    wait(lambda: not program.family(), "processes outlive the command that started them", 90.0)


def kill_child(stage: Stage, program: Program, reference: Calm, chance: random.Random) -> None:
    """SIGKILL to one process that the command has started; the command must end in one line."""
    _in_the_middle(stage, program, reference, chance)
    others = [pid for pid in program.family() if pid != program.process.pid]
    if others:
        with suppress(ProcessLookupError):
            kill(chance.choice(others), signal.SIGKILL)
    code, out, err = program.ended()
    quiet(err)
    assert code in (0, 1), f"exit code {code}: {out[-300:]!r} {err[-300:]!r}"


def stop_parent(stage: Stage, program: Program, reference: Calm, chance: random.Random) -> None:
    """SIGTERM, SIGINT or SIGHUP to the command alone."""
    number = chance.choice(STOPS)
    _in_the_middle(stage, program, reference, chance)
    program.send(number)
    _stopped(program, number)


def stop_all(stage: Stage, program: Program, reference: Calm, chance: random.Random) -> None:
    """SIGTERM, SIGINT or SIGHUP to all processes at once, as a terminal does."""
    number = chance.choice(STOPS)
    _in_the_middle(stage, program, reference, chance)
    program.send_all(number)
    _stopped(program, number)


BLOWS = (kill_at_start, kill_all, kill_parent, kill_child, stop_parent, stop_all)
WEIGHTS = (20, 45, 10, 5, 12, 8)


def _in_the_middle(stage: Stage, program: Program, reference: Calm, chance: random.Random) -> None:
    wait(lambda: stage.has_begun(program) or program.process.poll() is not None, "a sweep")
    time.sleep(chance.uniform(0.0, 0.6 * reference.start_s + 5.0 * reference.each_s))


def _stopped(program: Program, number: signal.Signals) -> None:
    try:
        code, out, err = program.ended(60.0)
    except AssertionError as error:
        said = program.files[1].read_text("utf-8", "replace")[-500:]
        raise AssertionError(f"{number.name}: {error}: {said!r}") from None
    quiet(err)
    if "results: " in out:  # it was done before the signal came
        assert code in (0, 1, 128 + number, -number), f"exit code {code} after the summary"
    else:
        assert code == 128 + number, f"{number.name}: exit code {code}: {err[-300:]!r}"
        assert INTERRUPTED in err.splitlines()[-1:], f"{number.name}: said {err[-300:]!r}"
    wait(lambda: not program.family(), "processes outlive a command that was stopped", 90.0)
