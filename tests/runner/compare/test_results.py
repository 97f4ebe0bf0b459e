"""What is asked of a logbook goes by its indexes: no table of figures is read from end to end."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event

from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.table import comparison
from seatrial.runner.database import LogbookWriter
from tests.runner.database.samples import make_results, make_start

ASKED: dict[str, Callable[[LogbookWriter], object]] = {
    "a table of a metric": lambda logbook: comparison(
        Queries(logbook), TableOptions(dof=["surge"], stage=["validation"])
    ),
    "a table of a coefficient": lambda logbook: comparison(
        Queries(logbook), TableOptions(coefficient=["term1"])
    ),
    "a table of some runs": lambda logbook: comparison(
        Queries(logbook), TableOptions(where="identifier=ls")
    ),
    "the metrics of a run": lambda logbook: logbook.metrics(2),
    "the diagnostics of a run": lambda logbook: logbook.diagnostics(2),
    "the run of a trial": lambda logbook: logbook.trials([f"{2:064x}"]),
    "how far a sweep is": lambda logbook: logbook.sweep_status(1),
    "the start of a trial": lambda logbook: logbook.begin_run(make_start(9), 1),
}
ONE_RUN = ("the run of a trial", "the start of a trial", "how far a sweep is")


@pytest.fixture
def filled(tmp_path: Path) -> Iterator[LogbookWriter]:
    with LogbookWriter.open(f"sqlite:///{tmp_path}/results.db", results_dir=tmp_path) as logbook:
        logbook.begin_sweep("sweep", "command", [], 3)
        for trial in range(3):
            run = logbook.begin_run(make_start(trial), 1).run_id
            logbook.finish_run(run, make_results())
        yield logbook


@contextmanager
def plans(logbook: LogbookWriter) -> Iterator[list[str]]:
    """The steps of SQLite's plans of every query in the block."""
    steps: list[str] = []

    def explain(_: Any, cursor: Any, statement: str, parameters: Any, *__: Any) -> None:
        if statement.startswith(("SELECT", "WITH", "UPDATE", "DELETE")):
            rows = cursor.connection.execute(f"EXPLAIN QUERY PLAN {statement}", parameters)
            steps.extend(row[3] for row in rows.fetchall())

    engines = (logbook._engine, logbook._writer)
    for engine in engines:
        event.listen(engine, "before_cursor_execute", explain)
    try:
        yield steps
    finally:
        for engine in engines:
            event.remove(engine, "before_cursor_execute", explain)


@pytest.mark.parametrize("asked", ASKED)
def test_no_query_reads_a_whole_table_of_figures(filled: LogbookWriter, asked: str) -> None:
    with plans(filled) as steps:
        ASKED[asked](filled)
    read = [step for step in steps if step.startswith("SCAN")]
    assert any(step.startswith("SEARCH") for step in steps), steps
    for table in ("metric", "coefficient", "diagnostic", "series"):
        assert not [step for step in read if f" {table}" in step], steps
    if asked in ONE_RUN:
        assert not [step for step in read if " run" in step], steps
