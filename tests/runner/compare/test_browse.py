"""Datasette over a logbook: on this host only, read-only, with queries that answer."""

import json
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.runner.compare import browse
from seatrial.runner.compare.results import open_results
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database


def test_every_ready_query_answers_and_every_column_is_described(plain: Path) -> None:
    known = browse.columns_of(plain / "results.db")
    with open_results(str(plain / "results.db")) as results:
        for _, sql in browse.QUERIES.values():
            assert results.reader.sql(sql.replace(":run", "1")).rows
    metadata = browse.metadata_of(plain / "results.db", known)
    tables = metadata["databases"]["results"]["tables"]
    assert set(tables) == set(browse.TABLES)
    described = set().union(*(table["columns"] for table in tables.values()))
    assert described == set(browse.COLUMNS)
    wide = set(known["metric_wide"][known["metric_wide"].index("dof") + 1 :])
    assert wide <= set(browse.COLUMNS)  # no metric without a unit


def test_a_missing_package_and_postgresql_are_one_line(
    program: Program, plain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(browse, "find_spec", lambda name: None)
    code, _, err = program("browse", *database(plain))
    assert (code, len(err.splitlines())) == (2, 1)
    assert "pip install 'seatrial[browse]'" in err


@pytest.fixture
def server(plain: Path) -> Iterator[str]:
    pytest.importorskip("datasette", reason="no datasette: pip install 'seatrial[browse]'")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "runner.compare", "browse", *database(plain)]
    process = subprocess.Popen(
        [*command, "--port", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    url = f"http://127.0.0.1:{port}"
    try:
        for _ in range(300):
            try:
                urllib.request.urlopen(url, timeout=5).close()
                break
            except (urllib.error.URLError, ConnectionError):
                assert process.poll() is None
                time.sleep(0.1)
        yield url
    finally:
        process.terminate()
        process.wait(10)


def _get(url: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(url, timeout=20) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as refused:
        with refused:
            return refused.code, refused.read().decode()


@pytest.mark.slow
def test_the_logbook_is_served_read_only_on_this_host(server: str) -> None:
    status, page = _get(f"{server}/results")
    assert status == 200
    assert "Force error by identifier and disturbance" in page
    status, answer = _get(f"{server}/results/compare_identifiers.json?_shape=array")
    assert status == 200
    assert any(row["identifier"] == "ls" for row in json.loads(answer))
    for sql in ("delete from run", "attach 'x.db' as x", "pragma query_only = off"):
        status, _ = _get(f"{server}/results.json?sql={urllib.parse.quote(sql)}")
        assert status == 400
    status, _ = _get(f"{server}/results.db")
    assert status == 403
