"""Malformed inputs: drawn by Hypothesis, run in forks with limits, and judged by one law."""

import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from seatrial.models.errors import SeatrialError
from tests.abuse import inputs, isolated, stored
from tests.abuse.isolated import Answer, Order
from tests.abuse.ledger import Entry

# A run may fail by these; any other error was stored too, but is remarked on.
EXPECTED = {error.__name__ for error in SeatrialError.__subclasses__()}
KINDS = {  # of 500
    "options": ("option values", 160),
    "vessels": ("vessel files", 80),
    "recordings": ("recordings", 80),
    "arguments": ("arguments of seatrial-results", 110),
    "damage": ("damaged logbooks", 70),
}


def generate(strategy: st.SearchStrategy[Order], count: int, number: int) -> list[Order]:
    """Draw orders; equal seeds draw equal orders."""
    drawn: list[Order] = []

    @seed(number)
    @settings(
        max_examples=count,
        database=None,
        derandomize=False,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def collect(order: Order) -> None:
        drawn.append(order)

    collect()
    return drawn[:count]


def strategies(folder: Path) -> dict[str, Callable[[], st.SearchStrategy[Order]]]:
    """The strategy of each kind; those of logbooks copy the one in `folder`."""
    logbook = folder / "logbook"
    return {
        "options": inputs.options,
        "vessels": inputs.vessels,
        "recordings": inputs.recordings,
        "arguments": lambda: stored.arguments(logbook),
        "damage": lambda: stored.damaged(logbook),
    }


def malformed(
    kind: str, folder: Path, number: int, share: float = 1.0, only: Sequence[int] = ()
) -> Entry:
    """Try inputs of one kind; `only` are the numbers of the cases to be tried, else all."""
    what, count = KINDS[kind]
    entry = Entry(f"malformed: {what}")
    if not (folder / "logbook").exists():
        stored.make_logbook(folder / "logbook")
    untouched = stored.digest(folder / "logbook")
    orders = generate(strategies(folder)[kind](), count, number)
    cases = [(n, order) for n, order in enumerate(orders) if n in only or not only]
    cases = cases[: round(share * count)]
    own = folder / kind
    own.mkdir()
    errors: Counter[str] = Counter()
    for case, answer in isolated.run(cases, own):
        repeat = f"python -m tests.abuse {kind} --seed {number} --case {case}"
        with entry.attempt(f"{kind} {case} {_short(answer.order)}", repeat):
            entry_of = isolated.broken(answer)
            assert entry_of is None, entry_of
            if kind == "arguments" and answer.order.arguments[0] in stored.READING:
                assert stored.digest(answer.folder / "results") == untouched, "wrote to the logbook"
            if kind in ("options", "vessels", "recordings"):
                _check_logbook(answer, errors)
        if only:
            print(_shown(answer))
    for error, times in errors.most_common():
        entry.remark(f"{times} x stored as failed: {error}")
    return entry


def _short(order: Order) -> str:
    text = str(order)
    return text if len(text) < 300 else f"{text[:300]}..."


def _shown(answer: Answer) -> str:
    out, err = (text.decode("utf-8", "replace")[:3000] for text in (answer.out, answer.err))
    head = f"{answer.order}\ncode {answer.code} after {answer.seconds:.1f} s in {answer.folder}"
    return f"{head}\n{out!a}\n{err!a}"


def _check_logbook(answer: Answer, errors: Counter[str]) -> None:
    """What was stored is whole: finished runs have metrics, failed ones an error."""
    for name in answer.new:
        if not name.endswith("results.db"):
            continue
        with closing(sqlite3.connect(answer.folder / name)) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)], name
            metrics = "(SELECT count(*) FROM metric WHERE run_id = run.id)"
            query = f"SELECT status, error_type, error, {metrics} FROM run"
            for status, kind, error, stored_metrics in connection.execute(query):
                assert status in ("finished", "failed", "diverged"), f"a run is {status}"
                assert status != "finished" or stored_metrics, "a finished run has no metrics"
                if status == "failed" and kind not in EXPECTED:
                    errors[f"{kind}: {error[:120]} {_short(answer.order)}"] += 1
