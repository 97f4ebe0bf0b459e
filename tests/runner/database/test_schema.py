"""The schema is created, renewed in its views, and refused if it is another one."""

import sqlite3
from contextlib import closing
from hashlib import sha256
from pathlib import Path

import pytest
from sqlalchemy import inspect

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter, engine, schema, views
from seatrial.runner.database.engine import parse
from seatrial.runner.record.rows import Results
from tests.runner.database.samples import change, make_results, make_start


def refused(url: str, results_dir: Path, match: str) -> None:
    """Both ways of opening say the same one line."""
    for opener in (
        lambda: LogbookWriter.open(url, results_dir=results_dir),
        lambda: LogbookWriter.read(url),
    ):
        with pytest.raises(LogbookError, match=match) as caught:
            opener()
        assert "\n" not in str(caught.value)


def test_a_logbook_of_another_schema_names_the_version_that_exports_it(
    url: str, results_dir: Path
) -> None:
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        for trial, version in enumerate(("0.8.0", "0.9.1")):
            start = make_start(trial, versions={"seatrial": version}, git_commit=f"{trial}a" * 20)
            logbook.finish_run(logbook.begin_run(start).run_id, Results())
    for number in ("0002", "0999"):
        change(url, f"UPDATE seatrial_version SET version_num = '{number}'")
        refused(
            url, results_dir,
            rf"written by seatrial 0\.9\.1 \(commit 1a1a1a1a1a1a\) with schema {number}, expected"
            rf" schema {schema.SCHEMA}: install that version and run its 'seatrial-results export'",
        )  # fmt: skip
    change(url, "DELETE FROM seatrial_version")
    refused(url, results_dir, f"with schema unknown, expected schema {schema.SCHEMA}")
    change(url, *(f"DROP VIEW {name}" for name in views.NAMES))
    change(url, "ALTER TABLE run RENAME TO trial", "INSERT INTO seatrial_version VALUES ('4')")
    refused(url, results_dir, "written by seatrial of an unknown version with schema 4")


def test_views_of_another_catalogue_are_renewed(
    url: str, results_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    views.statements.cache_clear()
    monkeypatch.setattr(views, "METRIC_NAMES", (*views.METRIC_NAMES, "own_metric"))
    try:
        assert schema.inspect(parse(url)) is schema.SchemaState.OTHER_VIEWS
        with LogbookWriter.read(url) as reader, pytest.raises(LogbookError, match="own_metric"):
            reader.sql("SELECT own_metric FROM metric_wide")
        with LogbookWriter.open(url, results_dir=results_dir) as logbook:
            assert len(logbook.sql("SELECT own_metric FROM metric_wide").rows) == 6
        assert schema.inspect(parse(url)) is schema.SchemaState.CURRENT
    finally:
        views.statements.cache_clear()


def test_a_database_that_is_not_ours_is_refused(url: str, results_dir: Path) -> None:
    address = parse(url)
    if address.path is not None:
        address.path.parent.mkdir()
        with closing(sqlite3.connect(address.path)) as foreign:
            foreign.execute("CREATE TABLE alembic_version (version_num)")
            foreign.execute("CREATE TABLE run (id)")
        before = sha256(address.path.read_bytes()).hexdigest()
        refused(url, results_dir, r"not a seatrial logbook \(it holds alembic_version, run\)")
        assert sha256(address.path.read_bytes()).hexdigest() == before
        assert [path.name for path in address.path.parent.iterdir()] == ["results.db"]
    else:
        change(url, "CREATE TABLE run (id int)")
        refused(url, results_dir, r"not a seatrial logbook \(it holds run\)")
        reader = engine.reader(address)
        with reader.connect() as connection:
            assert inspect(connection).get_table_names() == ["run"]
        reader.dispose()


@pytest.mark.parametrize("content", [b"not a database at all", b"\0\xff" * 5000])
def test_a_file_that_is_no_database_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "results.db"
    path.write_bytes(content)
    refused(f"sqlite:///{path}", tmp_path, "results.db: file is not a database")
    assert path.read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["results.db"]


def test_a_missing_logbook_is_not_made_by_reading(
    url: str, results_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SEATRIAL_DATABASE", raising=False)
    with pytest.raises(LogbookError, match=r"there is no logbook[^,]*$"):
        LogbookWriter.read(url)
    monkeypatch.setenv("SEATRIAL_DATABASE", url)
    expected = r"there is no logbook.*, or --database SEATRIAL_DATABASE$"
    with pytest.raises(LogbookError, match=expected):
        LogbookWriter.open(url, results_dir=results_dir, create=False)
    assert not results_dir.exists()
