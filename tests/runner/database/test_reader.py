"""SQL from people is answered where it reads, and refused where it writes."""

import re
import time
from collections.abc import Iterator
from inspect import signature
from pathlib import Path

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter, sql_query
from seatrial.runner.database.engine import parse
from seatrial.runner.database.reader import LogbookReader
from tests.runner.database.samples import make_results, make_start
from tests.runner.postgres import Postgres

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
    "ATTACH DATABASE '{folder}/other.db' AS other",
    "ATTACH DATABASE 'file:{folder}/other.db?mode=rwc' AS other",
    *("VACUUM INTO '{folder}/other.db'", "PRAGMA query_only = OFF"),
    *("PRAGMA journal_mode = DELETE", "PRAGMA user_version = 7", "PRAGMA writable_schema = ON"),
    *("SELECT load_extension('{folder}/other')", "SELECT writefile('{folder}/other.db', 'x')"),
    *("EXPLAIN DELETE FROM run", "UPDATE sqlite_master SET sql = ''"),
]
WRITING_POSTGRESQL = [
    *("COPY run TO '{folder}/other.db'", "COPY (SELECT 1) TO PROGRAM 'touch {folder}/other.db'"),
    *("SET TRANSACTION READ WRITE", "SELECT setval('run_id_seq', 99)", "LISTEN x"),
    "SELECT set_config('transaction_read_only', 'off', false)",
    "SELECT set_config('default_transaction_read_only', 'off', false)",
    *("SELECT * INTO mine FROM run", "SELECT 1 FOR UPDATE; DELETE FROM run"),
    *("SELECT * FROM run FOR UPDATE", "LOCK TABLE run", "EXPLAIN ANALYZE DELETE FROM run"),
    *("DO $$ BEGIN DELETE FROM run; END $$", "SELECT lo_from_bytea(0, 'x')"),
    *("SELECT lo_import('/etc/hostname')", "SELECT pg_read_file('/etc/hostname')"),
    *("SELECT pg_read_binary_file('/etc/hostname')", "SELECT pg_ls_dir('/')"),
    "SELECT U&\"pg\\005fread\\005ffile\"('/etc/hostname')",
    "SELECT query_to_xml('SELECT pg_' || 'read_file(''/etc/hostname'')', true, true, '')",
]


@pytest.fixture
def filled(logbook: LogbookWriter) -> LogbookWriter:
    logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    return logbook


def test_what_writes_is_refused(filled: LogbookWriter, url: str, tmp_path: Path) -> None:
    sqlite = parse(url).sqlite
    tables = set(filled.sql(_TABLES[sqlite]).rows)
    with LogbookWriter.read(url) as reader:
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
            reader.sql(ENDLESS[parse(url).sqlite], timeout_s=0.5)
        assert 0.4 < time.monotonic() - start_s < 20.0
        assert reader.sql("SELECT count(*) FROM run").rows == [(1,)]  # and the next is answered
    assert signature(LogbookReader.sql).parameters["timeout_s"].default == 30.0


def test_an_answer_has_a_limited_number_of_rows(filled: LogbookWriter) -> None:
    for limit, more in ((7, True), (29_999, True), (30_000, False)):
        answer = filled.sql(MANY, limit=limit)
        assert (len(answer.rows), answer.more) == (limit, more)
    assert (len(filled.sql(MANY).rows), filled.sql(MANY).more) == (10_000, True)


def test_an_answer_has_a_limited_size(
    filled: LogbookWriter, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert sql_query._LARGEST == 2**28
    monkeypatch.setattr(sql_query, "_LARGEST", 2**20)
    large = {True: "hex(zeroblob(75000))", False: "repeat('x', 150000)"}[parse(url).sqlite]
    with pytest.raises(LogbookError, match=r"^sql: the answer is larger than 1 MB after 6 rows"):
        filled.sql(f"SELECT {large} FROM ({MANY}) AS many")


READERS = {
    "reader": "pg_read_all_data",
    "copier": "pg_read_all_data, pg_read_server_files",
    "files": "pg_read_server_files",
}


@pytest.fixture
def roles(postgres: Postgres, results_dir: Path) -> Iterator[dict[str, str]]:
    """Addresses of a logbook for roles with different rights."""
    import psycopg

    url = postgres.new_database()
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    with psycopg.connect(url, autocommit=True) as connection:
        for role, granted in READERS.items():
            connection.execute(f"CREATE ROLE {role} LOGIN PASSWORD 'anchor' IN ROLE {granted}")
        connection.execute("GRANT USAGE ON SCHEMA public TO files")
        connection.execute("GRANT SELECT ON ALL TABLES IN SCHEMA public TO files")
        yield {"sailor": url, **{role: url.replace("sailor", role) for role in READERS}}
        connection.execute("DROP OWNED BY reader, copier, files")
        connection.execute("DROP ROLE reader, copier, files")


def test_files_of_the_server_are_out_of_reach(roles: dict[str, str]) -> None:
    hidden = "SELECT U&\"pg!005fread!005ffile\" UESCAPE '!' ('/etc/hostname')"
    for role in ("sailor", "reader", "copier"):
        with LogbookWriter.read(roles[role]) as logbook:
            assert logbook.sql("SELECT count(*) FROM run_overview").rows == [(1,)], role
            for query in (hidden, "SELECT pg_read_file('/etc/hostname')"):
                with pytest.raises(LogbookError, match=r"sql: refused: (U&|pg_read_file) can"):
                    logbook.sql(query)
            user = "reader" if role == "reader" else "pg_read_all_data"
            assert logbook.sql("SELECT current_user").rows == [(user,)]
    with (
        LogbookWriter.read(roles["files"]) as logbook,
        pytest.raises(LogbookError, match="role files is a member of pg_read_server_files, so a"),
    ):
        logbook.sql("SELECT 1")


def test_the_role_without_rights_is_refused_by_the_server_too(
    roles: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Functions that the list of names does not know are refused by the rights given up."""
    monkeypatch.setattr(sql_query, "_FORBIDDEN", re.compile("(?!)"))
    queries = ("SELECT pg_read_file('/etc/hostname')", "SELECT lo_import('/etc/hostname')")
    for role in ("sailor", "copier", "reader"):
        with LogbookWriter.read(roles[role]) as logbook:
            for query in queries:
                with pytest.raises(LogbookError, match="permission denied for function"):
                    logbook.sql(query)
