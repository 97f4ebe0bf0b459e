"""Logbooks with many runs in them, filled by one insert a table."""

import sqlite3
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

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


def value(run: Any, k: Any) -> Any:
    """The k-th figure of a run, so that a mean over runs can be told."""
    return 1.0 * (run % 7 + k)


def fill(folder: Path, runs: int) -> Path:
    """A logbook of so many finished runs with 30 metrics each, in every combination."""
    url, file = f"sqlite:///{folder}/results.db", folder / "results.db"
    with LogbookWriter.open(url, results_dir=folder) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    numbers = range(1, runs + 1)
    combinations = len(IDENTIFIERS) * len(DISTURBANCES)
    with closing(sqlite3.connect(file)) as connection:
        pattern = pd.read_sql("SELECT * FROM run", connection, dtype=object)
        for table in ("metric", "coefficient", "diagnostic", "series", "run"):
            connection.execute(f"DELETE FROM {table}")
        rows = pattern.loc[[0] * runs].assign(
            id=numbers,
            fingerprint=[f"{run:064x}" for run in numbers],
            experiment=[f"{run % combinations:064x}" for run in numbers],  # what seeds share
            seed=[run // combinations for run in numbers],
            identifier=[identifier_of(run) for run in numbers],
            disturbance=[disturbance_of(run) for run in numbers],
        )
        rows.to_sql("run", connection, if_exists="append", index=False)
        one = pd.DataFrame([asdict(metric) for metric in make_results().metrics])
        metrics = pd.DataFrame({"run_id": numbers}).merge(one.reset_index(), how="cross")
        metrics["value"] = value(metrics["run_id"], metrics.pop("index"))
        metrics.to_sql("metric", connection, if_exists="append", index=False, chunksize=100_000)
        connection.commit()
    return file
