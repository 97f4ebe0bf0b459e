"""Logbooks with many runs in them, filled by one insert a table."""

import sqlite3
from contextlib import closing
from pathlib import Path

from seatrial.runner.database import LogbookWriter
from tests.runner.database.samples import make_results, make_start

IDENTIFIERS = ("dsr", "iv", "output_error", "ls", "none", "nsga2", "plsr", "ridge", "surface_plsr")
DISTURBANCES = ("calm", "noise", "constant")


def identifier_of(run: int) -> str:
    """The identifier of a run: the combinations come in turn."""
    return IDENTIFIERS[run % len(IDENTIFIERS)]


def disturbance_of(run: int) -> str:
    """The disturbance of a run."""
    return DISTURBANCES[run // len(IDENTIFIERS) % len(DISTURBANCES)]


def value(run: int, k: int) -> float:
    """The k-th figure of a run, so that a mean over runs can be told."""
    return float(run % 7 + k)


def fill(folder: Path, runs: int) -> Path:
    """A logbook of so many finished runs with 30 metrics each, in every combination."""
    url = f"sqlite:///{folder}/results.db"
    with LogbookWriter.open(url, results_dir=folder) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    file = folder / "results.db"
    metrics = list(make_results().metrics)
    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        connection.execute("PRAGMA synchronous = OFF")
        names, pattern = _row(connection, "run")
        places = {name: names.index(name) for name in ("id", "fingerprint", "experiment", "seed")}
        chosen = [names.index(name) for name in ("identifier", "disturbance")]
        connection.execute("BEGIN IMMEDIATE")
        for table in ("metric", "coefficient", "diagnostic", "series", "run"):
            connection.execute(f"DELETE FROM {table}")
        marks = ", ".join("?" * len(names))
        connection.executemany(
            f"INSERT INTO run ({', '.join(names)}) VALUES ({marks})",
            (_run(pattern, places, chosen, run) for run in range(1, runs + 1)),
        )
        connection.executemany(
            "INSERT INTO metric (run_id, stage, model, dof, name, value, unit)"
            " VALUES (?, ?, ?, ?, ?, ?, ?)",
            (
                (run, one.stage, one.model, one.dof, one.name, value(run, k), one.unit)
                for run in range(1, runs + 1)
                for k, one in enumerate(metrics)
            ),
        )
        connection.execute("COMMIT")
    return file


def _row(connection: sqlite3.Connection, table: str) -> tuple[list[str], list[object]]:
    cursor = connection.execute(f"SELECT * FROM {table}")
    return [column[0] for column in cursor.description], list(cursor.fetchone())


def _run(
    pattern: list[object], places: dict[str, int], chosen: list[int], run: int
) -> list[object]:
    row = list(pattern)
    row[places["id"]], row[places["fingerprint"]] = run, f"{run:064x}"
    combination = run % (len(IDENTIFIERS) * len(DISTURBANCES))
    row[places["experiment"]] = f"{combination:064x}"  # what its seeds have in common
    row[places["seed"]] = run // (len(IDENTIFIERS) * len(DISTURBANCES))
    row[chosen[0]], row[chosen[1]] = identifier_of(run), disturbance_of(run)
    return row
