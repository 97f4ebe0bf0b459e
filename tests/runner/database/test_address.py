"""What a database URL may be, and that its password is never shown."""

import shlex
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from sqlalchemy.engine import URL, make_url

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.__main__ import run as compare
from seatrial.runner.compare.results import open_results
from seatrial.runner.database import Logbook, display_url, without_passwords
from seatrial.runner.database.engine import file_url, parse
from tests.runner.command import Command
from tests.runner.database.samples import make_results, make_start
from tests.runner.postgres import Postgres


@pytest.mark.parametrize(
    ("url", "match"),
    [
        ("mysql://me:secret@host/db", "unknown database dialect 'mysql' in mysql://me:"),
        ("oracle+cx://host", "unknown database dialect 'oracle'"),
        ("results.db", "not a database URL: got 'results.db'"),
        ("", "not a database URL: got ''"),
        ("postgresql://me:secret@host:port/db", "not a database URL"),
        ("sqlite://", "expected sqlite:///FILE"),
        ("sqlite:///:memory:", "expected sqlite:///FILE"),
        ("sqlite://host/file.db", "expected sqlite:///FILE"),
        ("sqlite:///file.db?mode=rwc&uri=true", "expected sqlite:///FILE"),
        ("sqlite:///a?b/results.db", "expected sqlite:///FILE"),  # not in a
    ],
)
def test_urls_that_name_no_logbook_are_refused(tmp_path: Path, url: str, match: str) -> None:
    for use in (Logbook.read, lambda url: Logbook.open(url, results_dir=tmp_path)):
        with pytest.raises(LogbookError, match=match) as caught:
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
    with Logbook.open(url, results_dir=place) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    assert [path.name for path in tmp_path.iterdir()] == [folder]
    assert sorted(path.name for path in place.iterdir()) == ["results.db", "series"]
    assert display_url(url) == url
    assert str(parse(url)) == f"{place}/results.db"
    for name in (url, f"{place}/results.db"):
        with open_results(name) as results:
            assert [run.run_id for run in results.reader.runs()] == [1]
    again = parse(parse(url).url)  # an address that is handed on
    assert again.path == place / "results.db"


def test_the_command_line_takes_such_a_folder(seatrial: Command) -> None:
    seatrial.pretend()
    answer = seatrial("results_dir='a%41?b'", "seed=1")
    assert answer.code == 0, answer.err
    assert [path.name for path in seatrial.folder.iterdir()] == ["a%41?b"]
    shown = shlex.split(answer.out.partition("see ")[2])
    assert compare(shown[3:]) == 0
    again = seatrial("results_dir='a%41?b'", "seed=1")
    assert "already in the logbook" in again.out


def test_postgresql_always_goes_through_psycopg_3() -> None:
    for url in ("postgresql://h/d", "postgres://h/d", "postgresql+psycopg2://h/d"):
        assert parse(url).url.drivername == "postgresql+psycopg"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("postgresql://me:pass@host:1/db", "postgresql://me:***@host:1/db"),
        ("postgresql://me:p%40%2Fss@host/db", "postgresql://me:***@host/db"),
        ("postgresql://me@host/db?password=pass", "postgresql://me@host/db?password=***"),
        ("sqlite:///results/results.db", "sqlite:///results/results.db"),
        ("postgresql://host/db", "postgresql://host/db"),
    ],
)
def test_passwords_are_not_shown(text: str, shown: str) -> None:
    assert display_url(text) == shown
    assert without_passwords(text) == shown
    sentence = f"run database.url={text} seed=1 path=a@b:c"
    assert without_passwords(sentence) == f"run database.url={shown} seed=1 path=a@b:c"


def test_a_password_with_odd_characters_is_not_shown() -> None:
    assert without_passwords("postgresql://me:p@s:s@host/db") == "postgresql://me:***@host/db"
    assert "secret" not in display_url("postgresql://me:secret@host:port/db")


def test_a_server_that_is_not_there_is_told_in_one_line(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))  # bound but not listening: refuses
        url = f"postgresql://me:secret@127.0.0.1:{probe.getsockname()[1]}/db"
        with pytest.raises(LogbookError, match=r"^postgresql://me:\*\*\*@127.*refused") as caught:
            Logbook.open(url, results_dir=tmp_path)
    assert "\n" not in str(caught.value)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [("anchor", "wr0ng", "password authentication failed"), ("/sea", "/lake", "does not exist")],
)
def test_a_server_that_refuses_is_told_in_one_line(
    postgres: Postgres, tmp_path: Path, old: str, new: str, match: str
) -> None:
    url = postgres.new_database().replace(old, new)
    with pytest.raises(LogbookError, match=match) as caught:
        Logbook.read(url)
    assert "wr0ng" not in str(caught.value)
    assert "anchor" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_postgresql_without_its_package_says_what_to_install(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['psycopg'] = None;"
        "from seatrial.runner.database import Logbook; Logbook.read('postgresql://host/db')"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (
        "LogbookError: postgresql://host/db: PostgreSQL needs the package psycopg:"
        in (said.stderr.splitlines()[-1])
    )
