"""What goes into the logbook comes out of it."""

import math
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from sqlalchemy import delete

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter, series_files
from seatrial.runner.database.engine import BUSY_TIMEOUT_S
from seatrial.runner.database.tables import RunRow
from seatrial.runner.record.rows import Metric, Results, Series
from tests.runner.database.samples import make_results, make_start


def test_a_run_comes_back_as_it_was_stored(
    logbook: LogbookWriter, url: str, results_dir: Path
) -> None:
    results = make_results()
    begun = logbook.begin_run(make_start(7))
    assert begun.state == "new"
    logbook.finish_run(begun.run_id, results)

    with LogbookWriter.read(url, results_dir=results_dir) as reader:
        assert reader.metrics(begun.run_id) == results.metrics
        assert reader.coefficients(begun.run_id) == results.coefficients
        assert reader.diagnostics(begun.run_id) == results.diagnostics
        series = reader.series(begun.run_id, "recording")
        detail = reader.run(begun.run_id)
    assert series.units == results.series[0].units
    np.testing.assert_array_equal(series.columns["u"], results.series[0].columns["u"])
    assert detail.config == {"plant": {"scale": 0.5}, "seed": 7}
    assert detail.overrides == ["identifier=ls"]
    assert (detail.note, detail.git_dirty) == ("deployment skipped", False)
    summary = detail.summary
    assert (summary.status, summary.attempt, summary.seed) == ("finished", 1, 7)
    assert (summary.metrics, summary.coefficients, summary.series) == (30, 100, 1)
    assert abs(datetime.now(UTC) - summary.started_at) < timedelta(minutes=1)
    assert summary.duration_s is not None
    assert summary.duration_s >= 0.0


def test_series_of_a_run_share_a_file_and_keep_their_own_columns(
    logbook: LogbookWriter, results_dir: Path
) -> None:
    """Kinds of other lengths and units; NaN and infinity stay, and an empty kind is none."""
    t = np.arange(5.0)
    stored = [
        Series("recording", {"t": t, "u": np.array([1.0, math.nan, math.inf, -0.0, 5e-324])},
               {"t": "s", "u": "m/s"}),
        Series("prediction", {"t": t[:2], "x": t[2:4], "a.b": t[:4:2]},
               {"t": "s", "x": "m", "a.b": ""}),
        Series("waters", {"u": np.array([3, 4, 5])}, {"u": "km"}),
        Series("plan", {"x": t[:0]}, {"x": "m"}),
    ]  # fmt: skip
    run = logbook.begin_run(make_start()).run_id
    logbook.finish_run(run, Results(series=stored))
    assert len(list((results_dir / "series").iterdir())) == 1
    for expected in stored:
        found = logbook.series(run, expected.kind)
        assert (found.units, found.columns.keys()) == (expected.units, expected.columns.keys())
        for name, column in expected.columns.items():
            np.testing.assert_array_equal(found.columns[name], column)
    verified = logbook.verify()
    assert (verified.series, verified.problems, verified.leftovers) == (1, [], [])


def test_series_of_earlier_versions_are_read(logbook: LogbookWriter, results_dir: Path) -> None:
    """They have each kind in a group of rows of its own."""
    t = np.arange(5.0)
    stored = [Series("one", {"t": t}, {"t": "s"}), Series("two", {"t": t[:2]}, {"t": "s"})]
    run = logbook.begin_run(make_start()).run_id
    logbook.finish_run(run, Results(series=stored))
    (file,) = (results_dir / "series").iterdir()
    whole = parquet.read_table(file)
    with parquet.ParquetWriter(file, whole.schema) as writer:
        for part in (whole[:5], whole[5:]):
            writer.write_table(part)
    for expected, row in zip(stored, logbook.series_files(run), strict=True):
        row.sha256 = sha256(file.read_bytes()).hexdigest()
        found = series_files.read(results_dir, row)
        np.testing.assert_array_equal(found.columns["t"], expected.columns["t"])


def test_not_a_number_is_null_and_infinity_stays(logbook: LogbookWriter) -> None:
    """Numbers of NumPy are stored as numbers."""
    run = logbook.begin_run(make_start(seed=np.int64(3))).run_id
    one = Diagnostic("surface", "yaw", np.float32(0.5), "N^2", i=np.int64(2), j=np.int32(5))  # type: ignore[arg-type]
    values = (np.float64("nan"), np.float32(2.5), math.inf, None, np.int64(3))
    metrics = [
        Metric("validation", "plant", "yaw", f"m{k}", v, "1")  # type: ignore[arg-type]
        for k, v in enumerate(values)
    ]
    logbook.finish_run(run, Results(metrics=metrics, diagnostics=[one]))
    assert [m.value for m in logbook.metrics(run)] == [None, 2.5, math.inf, None, 3.0]
    assert logbook.diagnostics(run) == [Diagnostic("surface", "yaw", 0.5, "N^2", i=2, j=5)]
    assert logbook.run(run).summary.seed == 3


def test_configurations_that_json_or_text_cannot_hold_are_stored_plainly(
    logbook: LogbookWriter,
) -> None:
    config = {"a": np.float64(1.5), "b": float("nan"), "c": (1, np.inf), "d": Path("x"), "e": "\0"}
    run = logbook.begin_run(make_start(config=config)).run_id
    logbook.fail_run(run, "failed", "ValueError", "bad \0 \udcff byte", "line 1\nline 2 \0")
    detail = logbook.run(run)
    assert detail.config == {"a": 1.5, "b": None, "c": [1, "inf"], "d": "x", "e": "\\x00"}
    assert detail.summary.error == "bad \\x00 \\udcff byte"
    assert detail.traceback == "line 1\nline 2 \\x00"


def test_results_and_status_land_together_or_not_at_all(logbook: LogbookWriter) -> None:
    run = logbook.begin_run(make_start()).run_id
    results = make_results()
    twice = replace(results, metrics=[*results.metrics, results.metrics[0]])
    with pytest.raises(Exception, match=r"(?i)unique"):
        logbook.finish_run(run, twice)
    summary = logbook.run(run).summary
    assert (summary.status, summary.metrics, summary.coefficients) == ("running", 0, 0)
    assert not list((logbook.results_dir / "series").iterdir())
    logbook.finish_run(run, results)


def test_a_run_ends_only_once(logbook: LogbookWriter) -> None:
    run = logbook.begin_run(make_start()).run_id
    logbook.finish_run(run, Results())
    with pytest.raises(LogbookError, match=r"run 1 cannot be ended: it is finished"):
        logbook.finish_run(run, Results())
    with pytest.raises(LogbookError, match=r"run 9 cannot be ended: it is missing"):
        logbook.finish_run(9, Results())


def valid(logbook: LogbookWriter, trial: int) -> int | None:
    """The number of the valid attempt at a trial."""
    fingerprint = make_start(trial).fingerprint
    run = logbook.trials([fingerprint]).get(fingerprint)
    return None if run is None else run.run_id


def test_a_finished_trial_is_recognised(logbook: LogbookWriter) -> None:
    first = logbook.begin_run(make_start(1)).run_id
    assert logbook.begin_run(make_start(1)).state == "busy"
    logbook.finish_run(first, Results())
    again = logbook.begin_run(make_start(1))
    assert (again.state, again.run_id) == ("finished", first)
    more = logbook.begin_run(make_start(1), rerun=True)
    assert more.state == "new"
    assert logbook.run(more.run_id).summary.attempt == 2
    logbook.fail_run(more.run_id, "failed", "ValueError", "no", None)
    assert valid(logbook, 1) == first


def test_a_failed_trial_is_tried_again(logbook: LogbookWriter) -> None:
    first = logbook.begin_run(make_start(1)).run_id
    logbook.fail_run(first, "failed", "ValueError", "no", None)
    second = logbook.begin_run(make_start(1))
    assert second.state == "new"
    logbook.finish_run(second.run_id, Results())
    counted = {run.run_id: run.superseded for run in logbook.runs()}
    assert counted == {first: True, second.run_id: False}
    assert valid(logbook, 1) == second.run_id
    assert valid(logbook, 15) is None


def test_a_sweep_counts_each_trial_once(logbook: LogbookWriter) -> None:
    logbook.finish_run(logbook.begin_run(make_start(0)).run_id, Results())
    sweep = logbook.begin_sweep("first", "python -m runner -m", ["seed=range(0,5)"], 5)
    for trial in range(4):
        begun = logbook.begin_run(make_start(trial), sweep)
        if trial == 1:
            logbook.fail_run(begun.run_id, "failed", "ValueError", "no", None)
        elif trial == 2:
            logbook.finish_run(begun.run_id, Results())
    status = logbook.sweep_status(sweep)
    assert (status.planned, status.reused) == (5, 1)
    assert status.counts == {"finished": 2, "failed": 1, "running": 1}
    assert [run.seed for run in status.failed] == [1]
    assert status.finished_at is None
    assert status.left == {"": 2}  # the one that is running, and the one that never started
    logbook.finish_run(logbook.begin_run(make_start(1), sweep).run_id, Results())
    logbook.end_sweep(sweep)
    status = logbook.sweep_status(sweep)
    assert status.counts == {"finished": 3, "running": 1}
    assert status.failed == []
    assert status.finished_at is not None
    with pytest.raises(LogbookError, match="there is no sweep 99"):
        logbook.sweep_status(99)


def test_runs_are_chosen_by_conditions(logbook: LogbookWriter) -> None:
    for trial in range(4):
        start = make_start(trial, identifier="ls" if trial % 2 else "plsr")
        logbook.finish_run(logbook.begin_run(start).run_id, Results())
    assert [run.seed for run in logbook.runs(RunRow.identifier == "ls")] == [1, 3]
    assert [run.seed for run in logbook.runs(newest_first=True, limit=2)] == [3, 2]
    scale = RunRow.config[("plant", "scale")].as_float()
    assert len(logbook.runs(scale == 0.5, RunRow.seed >= 2)) == 2


def test_a_closed_logbook_gives_up_its_open_runs(url: str, results_dir: Path) -> None:
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        run = logbook.begin_run(make_start()).run_id
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        summary = logbook.run(run).summary
        assert summary.status == "interrupted"
        assert summary.error == "the program ended before the run did"
        assert logbook.begin_run(make_start()).state == "new"


def test_a_closed_logbook_holds_no_lock(url: str, results_dir: Path) -> None:
    """Also where Ctrl-C left a transaction that nobody ends."""
    with LogbookWriter.open(url, results_dir=results_dir) as interrupted:
        interrupted.begin_run(make_start(1))
        left = interrupted._writer.connect()
        left.execute(delete(RunRow))
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        begun = time.monotonic()
        logbook.begin_sweep("next", "python -m runner", [], 1)
        assert time.monotonic() - begun < 0.5 * BUSY_TIMEOUT_S
        assert [run.status for run in logbook.runs()] == ["interrupted"]
    left.invalidate()
    left.close()
