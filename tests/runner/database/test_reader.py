"""SQL from people is answered where it reads, and refused where it writes."""

from pathlib import Path

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.database import Logbook
from seatrial.runner.database.engine import parse
from tests.runner.database.samples import make_results, make_start

WRITING = [
    "DELETE FROM run",
    "UPDATE run SET seed = 1",
    "INSERT INTO reuse VALUES (1, 1)",
    "DROP TABLE metric",
    "CREATE TABLE mine (x int)",
    "CREATE TEMP TABLE mine (x int)",
    "ALTER TABLE run ADD COLUMN mine int",
    "SELECT 1; DELETE FROM run",
    "COMMIT; DELETE FROM run",
    "COMMIT",
    "BEGIN",
    "ROLLBACK",
    "VACUUM",
    "WITH gone AS (DELETE FROM run RETURNING id) SELECT * FROM gone",
    "INSERT INTO reuse VALUES (1, 1) RETURNING run_id",
    "",
    ";",
    "-- nothing",
]
WRITING_SQLITE = [
    "ATTACH DATABASE '{folder}/other.db' AS other",
    "ATTACH DATABASE 'file:{folder}/other.db?mode=rwc' AS other",
    "VACUUM INTO '{folder}/other.db'",
    "PRAGMA query_only = OFF",
    "PRAGMA journal_mode = DELETE",
    "PRAGMA user_version = 7",
    "PRAGMA writable_schema = ON",
    "SELECT load_extension('{folder}/other')",
    "SELECT writefile('{folder}/other.db', 'x')",
    "EXPLAIN DELETE FROM run",
    "UPDATE sqlite_master SET sql = ''",
]
WRITING_POSTGRESQL = [
    "COPY run TO '{folder}/other.db'",
    "COPY (SELECT 1) TO PROGRAM 'touch {folder}/other.db'",
    "SET TRANSACTION READ WRITE",
    "SELECT set_config('transaction_read_only', 'off', false)",
    "SELECT setval('run_id_seq', 99)",
    "SELECT * INTO mine FROM run",
    "SELECT 1 FOR UPDATE; DELETE FROM run",
    "SELECT * FROM run FOR UPDATE",
    "LOCK TABLE run",
    "DO $$ BEGIN DELETE FROM run; END $$",
    "EXPLAIN ANALYZE DELETE FROM run",
    "LISTEN x",
    "SELECT set_config('default_transaction_read_only', 'off', false)",
    "SELECT lo_from_bytea(0, 'x')",
    "SELECT lo_import('/etc/hostname')",
    "SELECT pg_read_file('/etc/hostname')",
    "SELECT pg_read_binary_file('/etc/hostname')",
    "SELECT pg_ls_dir('/')",
    "SELECT U&\"pg\\005fread\\005ffile\"('/etc/hostname')",
    "SELECT query_to_xml('SELECT pg_' || 'read_file(''/etc/hostname'')', true, true, '')",
]


@pytest.fixture
def filled(logbook: Logbook) -> Logbook:
    logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    return logbook


def test_what_writes_is_refused(filled: Logbook, url: str, tmp_path: Path) -> None:
    sqlite = parse(url).sqlite
    tables = set(filled.sql(_TABLES[sqlite]).rows)
    with Logbook.read(url) as reader:
        for query in WRITING + (WRITING_SQLITE if sqlite else WRITING_POSTGRESQL):
            with pytest.raises(LogbookError, match=r"^sql: ") as caught:
                reader.sql(query.format(folder=tmp_path))
            assert "\n" not in str(caught.value)
            assert reader.sql("SELECT count(*), sum(seed) FROM run").rows == [(1, 0)], query
        if not sqlite:
            assert reader.sql("SELECT * FROM pg_largeobject_metadata").rows == []
    assert not (tmp_path / "other.db").exists()
    assert set(filled.sql(_TABLES[sqlite]).rows) == tables
    filled.begin_run(make_start(2))  # and writers go on as before


_TABLES = {
    True: "SELECT name FROM sqlite_master",
    False: "SELECT relname FROM pg_class WHERE relnamespace = 'public'::regnamespace",
}


@pytest.mark.parametrize(
    ("query", "rows"),
    [
        ("SELECT name, value FROM metric WHERE id = 1", [("force_mse", 1.0)]),
        ("select count(*) from coefficient;", [(100,)]),
        ("WITH a AS (SELECT seed FROM run) SELECT * FROM a", [(0,)]),
        ("VALUES (1, 'x')", [(1, "x")]),
        ("SELECT '100%' AS share", [("100%",)]),
        ("SELECT seed FROM run WHERE vessel = ':x' OR vessel LIKE 'milli%'", [(0,)]),
        ("SELECT term FROM coefficient WHERE id < 0", []),
    ],
)
def test_what_reads_is_answered(filled: Logbook, query: str, rows: list[object]) -> None:
    assert filled.sql(query).rows == rows


def test_columns_have_their_names(filled: Logbook) -> None:
    assert filled.sql("SELECT id AS number, seed FROM run").columns == ("number", "seed")


def test_a_mistake_is_told_in_one_line(filled: Logbook) -> None:
    with pytest.raises(LogbookError, match=r"sql: .*nowhere"):
        filled.sql("SELECT * FROM nowhere")
    with pytest.raises(LogbookError, match=r"sql: .*syntax"):
        filled.sql("SELEKT 1")


def test_sqlite_tells_of_its_tables(tmp_path: Path) -> None:
    with Logbook.open(f"sqlite:///{tmp_path}/results.db", results_dir=tmp_path) as logbook:
        assert ("status",) in logbook.sql("SELECT name FROM pragma_table_info('run')").rows
        assert logbook.sql("PRAGMA table_info(run)").columns[1] == "name"
