"""`show RUN` prints what the run stored of its measured file."""

import json
from pathlib import Path

import pytest

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.compare.__main__ import run
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Results
from tests.runner.database.samples import make_start

NAMES = ("count", "mean", "std", "median", "minimum", "maximum")


@pytest.fixture
def database(tmp_path: Path) -> str:
    values = {
        "surge_vel": (7961, 0.04, 0.11, 0.02, -0.31, 0.27),
        "force_x": (7961, 3, 9, 2, -30, 29),
    }
    found = [
        Diagnostic(f"statistic_{name}", "all", float(value), i=i, label=column)
        for i, (column, figures) in enumerate(values.items())
        for name, value in zip(NAMES, figures, strict=True)
    ]
    url = f"sqlite:///{tmp_path}/results.db"
    with LogbookWriter.open(url, results_dir=tmp_path) as logbook:
        begun = logbook.begin_run(make_start(1))
        logbook.finish_run(begun.run_id, Results((), (), found, ()))
        begun = logbook.begin_run(make_start(2))
        logbook.finish_run(begun.run_id, Results((), (), (), ()))
    return url


def test_columns_keep_the_order_of_the_file(database: str, capsys) -> None:
    """A simulated run has none."""
    assert run(["show", "1", "--database", database, "--format", "json"]) == 0
    tables = json.loads(capsys.readouterr().out)
    (rows,) = (table for table in tables if table and "median" in table[0])
    assert [row["column"] for row in rows] == ["surge_vel", "force_x"]
    assert rows[0] == {
        "column": "surge_vel", "N": 7961, "mean": 0.04, "std": 0.11, "median": 0.02, "min": -0.31,
        "max": 0.27,
    }  # fmt: skip
    assert run(["show", "2", "--database", database]) == 0
    assert "as measured" not in capsys.readouterr().out
