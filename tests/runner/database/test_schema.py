"""The schema is made, upgraded and refused as it should be."""

import sqlite3
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, inspect

from seatrial.models.errors import LogbookError
from seatrial.runner.database import Logbook, engine, schema, views
from seatrial.runner.database.engine import parse
from seatrial.runner.database.tables import Base
from seatrial.runner.record.rows import Results
from tests.runner.database.former import insert_first_results, migrated
from tests.runner.database.samples import make_results, make_start


def options(index: Any) -> Any:
    return index.get("dialect_options", {}).items()


def described(connection: Connection) -> dict[str, Any]:
    """Everything that the database says of its tables."""
    found = inspect(connection)
    return {
        table: {
            "columns": [
                {**column, "type": str(column["type"])} for column in found.get_columns(table)
            ],
            "primary key": found.get_pk_constraint(table),
            "foreign keys": found.get_foreign_keys(table),
            "indexes": sorted(
                str({**index, "dialect_options": {k: str(v) for k, v in options(index)}})
                for index in found.get_indexes(table)
            ),
            "unique": sorted(found.get_unique_constraints(table), key=str),
            "checks": found.get_check_constraints(table),
        }
        for table in found.get_table_names()
    }


def test_the_known_revisions_are_those_of_the_migrations() -> None:
    config = Config()
    config.set_main_option("script_location", str(Path(schema.__file__).with_name("migrations")))
    config.set_main_option("path_separator", "os")
    scripts = [script.revision for script in ScriptDirectory.from_config(config).walk_revisions()]
    assert tuple(reversed(scripts)) == schema.REVISIONS


def test_made_at_once_is_equal_to_migrated(url: str, tmp_path: Path, request: Any) -> None:
    migrated(url, "head")
    other = f"sqlite:///{tmp_path}/made.db"
    if not parse(url).sqlite:
        other = request.getfixturevalue("postgres").new_database()
    Logbook.open(other, results_dir=tmp_path).close()
    seen = []
    for one in (url, other):
        reader = engine.reader(parse(one))
        with reader.connect() as connection:
            seen.append(described(connection))
            context = MigrationContext.configure(
                connection, opts={"version_table": schema.VERSION_TABLE}
            )
            assert compare_metadata(context, Base.metadata) == []
        reader.dispose()
    for table, description in seen[0].items():
        for part, found in description.items():
            assert (table, part, found) == (table, part, seen[1][table][part])
    assert seen[0].keys() == seen[1].keys()
    assert seen[0].keys() == {*Base.metadata.tables, schema.VERSION_TABLE}


def test_a_logbook_of_the_first_revision_is_upgraded_with_its_data(
    url: str, results_dir: Path
) -> None:
    migrated(url, "0001")
    insert_first_results(url)
    with pytest.raises(LogbookError, match=r"of an older version .* \(schema 0003\)"):
        Logbook.read(url)
    with Logbook.open(url, results_dir=results_dir) as logbook:
        assert [run.status for run in logbook.runs()] == ["finished", "interrupted"]
        assert [metric.value for metric in logbook.metrics(1)] == [2.5]
        assert [metric.value for metric in logbook.metrics(2)] == [2.5]
        assert logbook.begin_run(make_start(0)).state == "finished"
        again = logbook.begin_run(make_start(1))
        assert again.state == "new"
        logbook.finish_run(again.run_id, make_results())
        assert logbook.sweep_status(1).counts == {"finished": 1, "interrupted": 1}
    if parse(url).sqlite:
        (backup,) = results_dir.glob("results-schema-0001-*.db")
        with closing(sqlite3.connect(backup)) as old:
            assert old.execute("SELECT version_num FROM seatrial_version").fetchone() == ("0001",)
            assert old.execute("SELECT count(*) FROM metric").fetchone() == (2,)
            assert old.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_an_upgrade_that_fails_changes_nothing(
    url: str, results_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    migrated(url, "0001")
    insert_first_results(url)

    def fail(connection: Connection) -> None:
        raise LogbookError("the views cannot be made")

    monkeypatch.setattr(views, "create", fail)
    with pytest.raises(LogbookError, match="the views cannot be made"):
        Logbook.open(url, results_dir=results_dir)
    monkeypatch.undo()
    assert schema.inspect(parse(url)) is schema.Condition.OLDER
    with Logbook.open(url, results_dir=results_dir) as logbook:
        assert len(logbook.runs()) == 2


def test_views_of_another_version_are_renewed(
    url: str, results_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Logbook.open(url, results_dir=results_dir) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    views.statements.cache_clear()
    views.digest.cache_clear()
    monkeypatch.setattr(views, "METRIC_NAMES", (*views.METRIC_NAMES, "own_metric"))
    try:
        assert schema.inspect(parse(url)) is schema.Condition.OTHER_VIEWS
        with Logbook.read(url) as reader, pytest.raises(LogbookError, match="own_metric"):
            reader.sql("SELECT own_metric FROM metric_wide")
        with Logbook.open(url, results_dir=results_dir) as logbook:
            assert len(logbook.sql("SELECT own_metric FROM metric_wide").rows) == 6
        assert schema.inspect(parse(url)) is schema.Condition.CURRENT
    finally:
        views.statements.cache_clear()
        views.digest.cache_clear()


def refused(url: str, results_dir: Path, match: str) -> None:
    """Both ways of opening say the same one line, and change nothing."""
    for opener in (lambda: Logbook.open(url, results_dir=results_dir), lambda: Logbook.read(url)):
        with pytest.raises(LogbookError, match=match) as caught:
            opener()
        assert "\n" not in str(caught.value)


def test_a_newer_logbook_is_refused(url: str, results_dir: Path) -> None:
    Logbook.open(url, results_dir=results_dir).close()
    writer = engine.writer(parse(url))
    with writer.begin() as connection:
        connection.exec_driver_sql("UPDATE seatrial_version SET version_num = '0999'")
    writer.dispose()
    refused(url, results_dir, r"of a newer version of seatrial: got schema 0999.* up to 0003")


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
        writer = engine.writer(address)
        with writer.begin() as connection:
            connection.exec_driver_sql("CREATE TABLE run (id int)")
        refused(url, results_dir, r"not a seatrial logbook \(it holds run\)")
        with writer.begin() as connection:
            assert inspect(connection).get_table_names() == ["run"]
        writer.dispose()


@pytest.mark.parametrize("content", [b"not a database at all", b"\0\xff" * 5000])
def test_a_file_that_is_no_database_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "results.db"
    path.write_bytes(content)
    refused(f"sqlite:///{path}", tmp_path, "results.db: file is not a database")
    assert path.read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["results.db"]


def test_a_missing_logbook_is_not_made_by_reading(url: str, results_dir: Path) -> None:
    with pytest.raises(LogbookError, match="there is no logbook here"):
        Logbook.read(url)
    with pytest.raises(LogbookError, match="there is no logbook here"):
        Logbook.open(url, results_dir=results_dir, create=False)
    assert not results_dir.exists()


def test_an_empty_file_becomes_a_logbook(tmp_path: Path) -> None:
    path = tmp_path / "an odd %41 name?#.db"
    path.touch()
    from sqlalchemy.engine import URL

    url = URL.create("sqlite", database=str(path)).render_as_string()
    with Logbook.open(url, results_dir=tmp_path) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, Results())
    with Logbook.read(url) as reader:
        assert len(reader.runs()) == 1
    assert path.stat().st_size > 0


def test_opening_a_current_logbook_needs_no_alembic(tmp_path: Path) -> None:
    import subprocess
    import sys

    url = f"sqlite:///{tmp_path}/results.db"
    code = (
        "import sys; from pathlib import Path; from seatrial.runner.database import Logbook;"
        f"Logbook.open({url!r}, results_dir=Path({str(tmp_path)!r})).close();"
        # pyarrow itself is there at once, and its library when it is used
        "print({'alembic', 'pyarrow.lib', 'psycopg', 'pandas'} & sys.modules.keys())"
    )
    for _ in range(2):
        said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert (said.stdout, said.stderr, said.returncode) == ("set()\n", "", 0)
