"""What is asked of a logbook goes by its indexes: no table of figures is read from end to end."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

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


def test_no_query_reads_a_whole_table_of_figures(logbook: LogbookWriter) -> None:
    logbook.begin_sweep("sweep", "command", [], 3)
    for trial in range(3):
        logbook.finish_run(logbook.begin_run(make_start(trial), 1).run_id, make_results())
    for name, ask in ASKED.items():
        with plans(logbook) as steps:
            ask(logbook)
        read = [step for step in steps if step.startswith("SCAN")]
        assert any(step.startswith("SEARCH") for step in steps), (name, steps)
        tables = ["metric", "coefficient", "diagnostic", "series"]
        for table in [*tables, *(["run"] if name in ONE_RUN else [])]:
            assert not [step for step in read if f" {table}" in step], (name, steps)
