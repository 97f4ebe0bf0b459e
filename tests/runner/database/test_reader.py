"""SQL from people is answered where it reads, and refused where it writes."""

import time
from inspect import signature
from pathlib import Path

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.engine import parse
from seatrial.runner.database.reader import LogbookReader
from tests.runner.database.samples import make_results, make_start

WRITING = [
    *("DELETE FROM run", "UPDATE run SET seed = 1", "DROP TABLE metric"),
    *("INSERT INTO reuse VALUES (1, 1)", "INSERT INTO reuse VALUES (1, 1) RETURNING run_id"),
    *("CREATE TABLE mine (x int)", "CREATE TEMP TABLE mine (x int)"),
    *("ALTER TABLE run ADD COLUMN mine int", "SELECT 1; DELETE FROM run"),
    *("COMMIT; DELETE FROM run", "COMMIT", "BEGIN", "ROLLBACK", "VACUUM"),
    "WITH gone AS (DELETE FROM run RETURNING id) SELECT * FROM gone",
    *("", ";", "-- nothing"),
]
WRITING_SQLITE = [
    *("VACUUM INTO '{folder}/other.db'", "PRAGMA user_version = 7"),
    *("ATTACH DATABASE '{folder}/other.db' AS other", "UPDATE sqlite_master SET sql = ''"),
]
WRITING_POSTGRESQL = [
    *("COPY run TO '{folder}/other.db'", "COPY (SELECT 1) TO PROGRAM 'touch {folder}/other.db'"),
    *("SET TRANSACTION READ WRITE", "SELECT setval('run_id_seq', 99)", "LISTEN x"),
    *("SELECT * INTO mine FROM run", "SELECT 1 FOR UPDATE; DELETE FROM run"),
    *("SELECT * FROM run FOR UPDATE", "LOCK TABLE run", "EXPLAIN ANALYZE DELETE FROM run"),
    "DO $$ BEGIN DELETE FROM run; END $$",
]


@pytest.fixture
def filled(logbook: LogbookWriter) -> LogbookWriter:
    logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    return logbook


def test_what_writes_is_refused(filled: LogbookWriter, url: str, tmp_path: Path) -> None:
    sqlite = parse(url).path is not None
    tables = set(filled.sql(_TABLES[sqlite]).rows)
    with LogbookWriter.read(url) as reader:
        for query in WRITING + (WRITING_SQLITE if sqlite else WRITING_POSTGRESQL):
            with pytest.raises(LogbookError, match=r"^sql: ") as caught:
                reader.sql(query.format(folder=tmp_path))
            assert "\n" not in str(caught.value)
            assert reader.sql("SELECT count(*), sum(seed) FROM run").rows == [(1, 0)], query
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
def test_what_reads_is_answered(filled: LogbookWriter, query: str, rows: list[object]) -> None:
    assert filled.sql(query).rows == rows


def test_a_mistake_is_told_in_one_line(filled: LogbookWriter) -> None:
    with pytest.raises(LogbookError, match=r"sql: .*nowhere"):
        filled.sql("SELECT * FROM nowhere")
    with pytest.raises(LogbookError, match=r"sql: .*syntax"):
        filled.sql("SELEKT 1")


def test_sqlite_tells_of_its_tables(tmp_path: Path) -> None:
    with LogbookWriter.open(f"sqlite:///{tmp_path}/results.db", results_dir=tmp_path) as logbook:
        assert ("status",) in logbook.sql("SELECT name FROM pragma_table_info('run')").rows
        assert logbook.sql("PRAGMA table_info(run)").columns[1] == "name"


ENDLESS = {
    True: "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT max(i) FROM n",
    False: "SELECT pg_sleep(600)",
}
MANY = (
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 30000)"
    " SELECT i FROM n"
)


def test_a_query_ends_in_time(filled: LogbookWriter, url: str) -> None:
    with LogbookWriter.read(url) as reader:
        start_s = time.monotonic()
        with pytest.raises(LogbookError, match=r"^sql: stopped after 0\.5 s; expected"):
            reader.sql(ENDLESS[bool(parse(url).path)], timeout_s=0.5)
        assert 0.4 < time.monotonic() - start_s < 20.0
        assert reader.sql("SELECT count(*) FROM run").rows == [(1,)]  # and the next is answered
    assert signature(LogbookReader.sql).parameters["timeout_s"].default == 30.0


def test_an_answer_has_a_limited_number_of_rows(filled: LogbookWriter) -> None:
    for limit, more in ((7, True), (29_999, True), (30_000, False)):
        answer = filled.sql(MANY, limit=limit)
        assert (len(answer.rows), answer.more) == (limit, more)
    assert (len(filled.sql(MANY).rows), filled.sql(MANY).more) == (10_000, True)
