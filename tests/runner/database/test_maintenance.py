"""verify finds what is wrong, prune deletes what it should, export writes every table."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet
import pytest
from sqlalchemy import delete, insert, update

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter, series_files
from seatrial.runner.database.engine import parse
from seatrial.runner.database.tables import Base, RunRow, SeriesRow
from tests.runner.database.samples import ago, change, gone, make_results, make_start, pretend


@pytest.fixture
def filled(logbook: LogbookWriter) -> LogbookWriter:
    """Runs 1 and 2 finished, 3 failed, 4 diverged, 5 under way."""
    sweep = logbook.begin_sweep("s", "python -m runner -m", [], 5)
    for trial in range(1, 6):
        run = logbook.begin_run(make_start(trial), sweep).run_id
        if trial in (1, 2):
            logbook.finish_run(run, make_results())
        elif trial == 3:
            logbook.fail_run(run, "failed", "ValueError", "no", "trace")
        elif trial == 4:
            logbook.fail_run(run, "diverged", "Diverged", "no", None, make_results())
    return logbook


def test_what_happened_to_series_files_is_found(
    filled: LogbookWriter, url: str, results_dir: Path
) -> None:
    folder = results_dir / "series"
    next(folder.glob("run-000001-*.parquet")).write_bytes(b"changed")
    next(folder.glob("run-000002-*.parquet")).unlink()
    lost = filled.begin_run(make_start(6)).run_id  # of a process that was killed as it wrote
    pretend(url, lost, process=gone())
    left = [
        ".run-000004-0123456789ab.parquet.77.tmp",
        "run-000006-0123456789ab.parquet",
        "run-000009-0123456789ab.parquet",
    ]
    for name in left:
        (folder / name).touch()
    series_files.write(results_dir, 5, make_results().series)  # run 5 is about to name it
    (folder / "notes.txt").touch()  # not ours: named, and left alone
    verified = filled.verify()
    changed, missing = verified.problems
    assert [changed[0], missing[0]] == ["run 1, series recording", "run 2, series recording"]
    assert "the file was changed: got SHA-256" in changed[1]
    assert "cannot be read: No such file" in missing[1]
    assert [path.name for path in verified.leftovers] == sorted([*left, "notes.txt"])
    with pytest.raises(LogbookError, match="the file was changed"):
        filled.series(1, "recording")
    with pytest.raises(LogbookError, match="run 1 has no series 'other'"):
        filled.series(1, "other")
    assert len(list(folder.glob("run-000005-*.parquet"))) == 1


def test_another_logbook_in_the_same_folder_keeps_its_files(tmp_path: Path) -> None:
    """Both begin before either has a series; then the numbers of their runs are the same."""
    urls = [f"sqlite:///{tmp_path}/{name}.db" for name in ("one", "two")]
    with (
        LogbookWriter.open(urls[0], results_dir=tmp_path) as one,
        LogbookWriter.open(urls[1], results_dir=tmp_path) as two,
    ):
        one.finish_run(one.begin_run(make_start(1)).run_id, make_results(1.0))
        before = one.series(1, "recording")
        lost = two.begin_run(make_start(1)).run_id
        assert lost == 1
        series_files.write(tmp_path, lost, make_results().series)  # and is killed
        pretend(urls[1], lost, process=gone())
        two.finish_run(two.begin_run(make_start(1)).run_id, make_results(2.0))
        again = one.series(1, "recording")  # its checksum is right
        assert (again.columns["u"] == before.columns["u"]).all()
        assert one.verify().problems == two.verify().problems == []


def test_rows_that_were_changed_are_found(filled: LogbookWriter, url: str) -> None:
    change(url, update(SeriesRow).where(SeriesRow.run_id == 1).values(sha256="0" * 64))
    (problem,) = filled.verify().problems
    assert "the file was changed: got SHA-256" in problem[1]
    if parse(url).path:  # PostgreSQL has no way round a foreign key
        change(url, delete(RunRow).where(RunRow.id == 2))
        found = dict(filled.verify().problems)
        assert found["table metric"] == "30 rows refer to no run"
        assert found["table coefficient"] == "100 rows refer to no run"


@pytest.mark.parametrize(
    "path",
    ["../secret", "/etc/passwd", "series/../../secret", "results.db", "series", "", "series/a\x00b",
     "series/link"],
)  # fmt: skip
def test_paths_lead_nowhere_else(tmp_path: Path, path: str) -> None:
    (tmp_path / "results" / "series").mkdir(parents=True)
    (tmp_path / "results" / "series" / "link").symlink_to("/etc/passwd")
    file = SeriesRow(kind="recording", path=path, n_rows=1, sha256="0" * 64, columns={})
    with pytest.raises(LogbookError, match="expected a file within"):
        series_files.read(tmp_path / "results", file)


def test_a_path_in_the_database_cannot_delete_other_files(
    filled: LogbookWriter, url: str, results_dir: Path
) -> None:
    (results_dir / "precious").touch()
    change(url, update(SeriesRow).where(SeriesRow.run_id == 1).values(path="precious"))
    assert "expected a file within" in filled.verify().problems[0][1]
    assert filled.prune([1]) == (1, 0, ["precious"])
    assert (results_dir / "precious").exists()


def test_prune_deletes_rows_with_their_files(filled: LogbookWriter, results_dir: Path) -> None:
    assert filled.prune([2, 3, 5, 99]) == (2, 1, [])
    assert [run.run_id for run in filled.runs()] == [1, 4, 5]
    assert filled.sql("SELECT DISTINCT run_id FROM metric ORDER BY run_id").rows == [(1,), (4,)]
    kept = [path.name[:10] for path in (results_dir / "series").iterdir()]
    assert sorted(kept) == ["run-000001", "run-000004"]
    assert filled.verify().problems == []
    assert filled.begin_run(make_start(2)).run_id == 6  # a number is never given twice


def test_a_run_without_a_heartbeat_may_be_pruned(filled: LogbookWriter, url: str) -> None:
    change(url, update(RunRow).where(RunRow.id == 5).values(heartbeat_at=ago(40 * 86400.0)))
    assert filled.prune([5]) == (1, 0, [])


def test_many_runs_are_pruned(logbook: LogbookWriter, url: str) -> None:
    begun = {"host": "h", "pid": 1, "attempt": 1, "started_at": datetime.now(UTC)}
    start = vars(make_start(0)).items()
    values = {name: one for name, one in start if name[0] != "_"} | begun | {"status": "failed"}
    change(url, insert(RunRow).values([values | {"fingerprint": f"{k:064x}"} for k in range(1200)]))
    assert logbook.prune([run.run_id for run in logbook.runs()]) == (1200, 0, [])
    assert logbook.runs() == []


def test_export_writes_every_table(filled: LogbookWriter, tmp_path: Path) -> None:
    paths = filled.export(tmp_path / "out" / "deep")
    assert {*paths} == {*(tmp_path / "out" / "deep").iterdir()}
    by_name = {path.name: path for path in paths}
    for table in Base.metadata.tables:
        (count,) = filled.sql(f"SELECT count(*) FROM {table}").rows[0]
        columns = [column.name for column in Base.metadata.tables[table].columns]
        read = pyarrow.parquet.read_table(by_name[f"{table}.parquet"])
        assert (read.num_rows, read.column_names) == (count, columns)
        lines = pyarrow.csv.read_csv(by_name[f"{table}.csv"])
        assert (lines.num_rows, lines.column_names) == (count, columns)
    runs = pyarrow.parquet.read_table(by_name["run.parquet"]).to_pylist()
    assert runs[0]["config"] == '{"plant": {"scale": 0.5}, "seed": 1}'
    assert abs(runs[0]["started_at"] - datetime.now(UTC)) < timedelta(minutes=1)
    assert runs[2]["traceback"] == "trace"


def test_export_to_a_place_that_cannot_be_written(filled: LogbookWriter, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(LogbookError, match="file/out: cannot export"):
        filled.export(tmp_path / "file" / "out")
