"""Addresses of logbooks: what they may be, and that a password is in SEATRIAL_DATABASE alone."""

import shlex
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy.engine import URL, make_url

import seatrial as st
from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.__main__ import run as compare
from seatrial.runner.compare.frame import open_results
from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.engine import file_url, parse
from seatrial.runner.database.tables import Base
from seatrial.runner.database.terminal import refuse_passwords
from tests.runner.command import Command
from tests.runner.database.samples import make_results, make_start
from tests.runner.postgres import PASSWORD, Postgres


@pytest.mark.parametrize(
    ("url", "match"),
    [
        ("mysql://me:secret@host/db", r"unknown database dialect 'mysql' in mysql://me:\*\*\*@"),
        ("results.db", "not a database URL: got 'results.db'"),
        ("postgresql://me@host:port/db", "not a database URL"),
        ("postgresql://me:secret@host/db", "use SEATRIAL_DATABASE, PGPASSWORD or ~/.pgpass$"),
        ("SEATRIAL_DATABASE", "SEATRIAL_DATABASE: got a password after '?'"),
        ("sqlite://", "expected sqlite:///FILE"),
        ("sqlite:///:memory:", "expected sqlite:///FILE"),
        ("sqlite:///a?b/results.db", "expected sqlite:///FILE"),  # not in a
    ],
)
def test_urls_that_name_no_logbook_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str, match: str
) -> None:
    monkeypatch.setenv("SEATRIAL_DATABASE", "postgresql://host/db?password=secret")
    for use in (LogbookWriter.read, lambda url: LogbookWriter.open(url, results_dir=tmp_path)):
        with pytest.raises((LogbookError, ConfigurationError), match=match) as caught:
            use(url)  # type: ignore[operator]
        assert "secret" not in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "folder", ["a?b", "a?mode=ro", "50%", "a%41b", "a%2Fb", "a%00b", "a#b", "a&b=c", "a b", "é:@x"]
)
def test_a_folder_with_any_name_holds_its_own_database(tmp_path: Path, folder: str) -> None:
    place = tmp_path / folder
    url = file_url(place / "results.db")
    assert make_url(url) == URL.create("sqlite", database=f"{place}/results.db")
    with LogbookWriter.open(url, results_dir=place) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    assert [path.name for path in tmp_path.iterdir()] == [folder]
    assert sorted(path.name for path in place.iterdir()) == ["results.db", "series"]
    assert str(parse(url)) == f"{place}/results.db"
    for name in (url, f"{place}/results.db"):
        with open_results(name) as results:
            assert [run.run_id for run in results.reader.runs()] == [1]
    again = parse(parse(url).url)  # an address that is handed on
    assert again.path == place / "results.db"


def test_postgresql_always_goes_through_psycopg_3() -> None:
    for url in ("postgresql://h/d", "postgres://h/d", "postgresql+psycopg2://h/d"):
        assert parse(url).url.drivername == "postgresql+psycopg"


def test_a_server_that_is_not_there_is_told_in_one_line(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))  # bound but not listening: refuses
        url = f"postgresql://me@127.0.0.1:{probe.getsockname()[1]}/db"
        with pytest.raises(LogbookError, match=r"^postgresql://me@127.*refused") as caught:
            LogbookWriter.open(url, results_dir=tmp_path)
    assert "\n" not in str(caught.value)
    assert "come back" not in str(caught.value)  # told at once: it was never there


def test_a_server_that_refuses_is_told_in_one_line(
    postgres: Postgres, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = postgres.new_database()
    with pytest.raises(LogbookError, match=r"^postgresql://sailor@[^\n]* does not exist$"):
        LogbookWriter.read(url.replace("/sea", "/lake"))
    monkeypatch.setenv("SEATRIAL_DATABASE", url.replace("sailor", "sailor:wr0ng"))
    with pytest.raises(LogbookError, match=r"password authentication failed[^\n]*$") as caught:
        LogbookWriter.read("SEATRIAL_DATABASE")
    assert str(caught.value).startswith("postgresql://sailor:***@127")
    assert "wr0ng" not in str(caught.value)


def test_postgresql_without_its_package_says_what_to_install() -> None:
    code = (
        "import sys; sys.modules['psycopg'] = None; from seatrial.runner.database import"
        " LogbookWriter; LogbookWriter.read('postgresql://host/db')"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    last = answer.stderr.splitlines()[-1]
    assert "LogbookError: postgresql://host/db: PostgreSQL needs the package psycopg:" in last


def test_a_password_in_an_option_is_found() -> None:
    for text in (
        "postgresql://me:secret@host/db",
        "postgresql+psycopg://me:s@cr/e:t@host/db",
        "database.url=postgresql\\://me\\:secret@host/db",
        '++database={url: "postgresql://me:my secret@host/db"}',
        "postgresql://me@host/db?password=secret",
        "postgresql://host/db?sslmode=require&SSLpassword=secret",
    ):
        with pytest.raises(ConfigurationError, match=r"use SEATRIAL_DATABASE, PGPASSWORD or"):
            refuse_passwords(["seed=1", text])
    note = "sweep.note=see http://host:80/page and me@host"
    refuse_passwords(["sqlite:////tmp/a:b@c.db", note, "SEATRIAL_DATABASE"])


URL_WITH_PASSWORD = "postgresql://me:s3cret@127.0.0.1:9/none"


@pytest.mark.parametrize(
    "words",
    [
        ("--cfg", "job", f"database.url={URL_WITH_PASSWORD}"),
        ("bogus=1", f"database.url='{URL_WITH_PASSWORD}'"),
        ("-m", "--variant", f"seed=1 database.url={URL_WITH_PASSWORD}"),
        ("experiment=secret", "--config-dir", "{folder}"),
        ("database.url=${{oc.env:SEATRIAL_DATABASE}}",),
    ],
)
def test_an_option_with_a_password_is_refused_before_anything_is_written(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory,
    words: tuple[str, ...],
) -> None:  # fmt: skip
    folder = tmp_path_factory.mktemp("conf")
    (folder / "experiment").mkdir()
    (folder / "experiment" / "secret.yaml").write_text(
        f"# @package _global_\ndatabase:\n  url: {URL_WITH_PASSWORD}\n"
    )
    monkeypatch.setenv("SEATRIAL_DATABASE", URL_WITH_PASSWORD)
    fake = seatrial.pretend()
    line = seatrial.refuses(*(word.format(folder=folder) for word in words))
    assert line.endswith("use SEATRIAL_DATABASE, PGPASSWORD or ~/.pgpass")
    assert "s3cret" not in line
    assert fake.ran == []


def test_the_comparison_and_python_refuse_it_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert compare(["runs", "--bogus", "--database", URL_WITH_PASSWORD]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.endswith("use SEATRIAL_DATABASE, PGPASSWORD or ~/.pgpass\n")
    assert "s3cret" not in printed.err
    for call in (
        lambda: st.open(URL_WITH_PASSWORD),
        lambda: st.run(database=URL_WITH_PASSWORD, seed=1),
        lambda: st.sweep([f"database.url={URL_WITH_PASSWORD}"], seed=[1, 2]),
    ):
        with pytest.raises(st.ConfigurationError, match="use SEATRIAL_DATABASE") as caught:
            call()
        assert "s3cret" not in str(caught.value)


@pytest.mark.slow
def test_a_password_in_the_environment_works_and_goes_nowhere(
    seatrial: Command, postgres: Postgres, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    fake = seatrial.pretend()
    fake.failing = {2}
    url = postgres.new_database()
    monkeypatch.setenv("SEATRIAL_DATABASE", url.replace("sailor", f"sailor:{PASSWORD}"))
    monkeypatch.delenv("PGPASSWORD")
    place = ("--database", "SEATRIAL_DATABASE")
    answers = [
        seatrial("-m", "database=postgresql", "seed=2,3", "dry_run=true"),
        seatrial("-m", "database=postgresql", "seed=2,3"),
        seatrial("database=postgresql", "seed=3"),
        seatrial("database=postgresql", "--cfg", "job", "--resolve"),
        seatrial("database=postgresql", "seed=${database.url}"),
    ]
    assert fake.ran == [2, 3]
    assert "results: postgresql://sailor:***@127" in answers[1].out
    assert "already in the logbook" in answers[2].out
    suggested = shlex.split(answers[2].out.partition("see ")[2])
    assert compare(suggested[3:]) == 0  # the command that was printed
    assert compare(["show", "1", "--traceback", *place]) == 0
    printed = capsys.readouterr()
    assert "run 2" in printed.out
    assert compare(["retry", *place]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert shlex.split(line) == ["python", "-m", "runner", "seed=2", "database=postgresql"]
    assert st.open("SEATRIAL_DATABASE").runs()["seed"].tolist() == [3, 2]
    with LogbookWriter.read("SEATRIAL_DATABASE") as logbook:
        tables = Base.metadata.tables.values()
        stored = repr([logbook.select(table.select()) for table in tables])
    assert PASSWORD not in repr((answers, printed, line, stored))
