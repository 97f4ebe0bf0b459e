"""The password of a PostgreSQL address: in no row, no message, no log, no traceback, no file."""

import os
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import update
from sqlalchemy.engine import URL

from seatrial.runner.compare.__main__ import run as compare
from seatrial.runner.database import Logbook, engine
from seatrial.runner.database.engine import parse
from seatrial.runner.database.mask import Mask, without_address
from seatrial.runner.database.tables import Run, Sweep
from tests.runner.command import Command
from tests.runner.database.samples import make_results, make_start
from tests.runner.postgres import Postgres
from tests.runner.programs import ROOT

PASSWORD = "anchor"  # of the tests' own server


def escaped(url: str) -> str:
    """An address as it is typed for Hydra, which wants its colons escaped."""
    return url.replace(":", "\\:")


def everything(url: str) -> str:
    """All text of the tables that hold text of people."""
    with Logbook.read(url) as logbook:
        rows = [logbook.select(table.__table__.select()) for table in (Run, Sweep)]
    return repr(rows)


@pytest.mark.parametrize(
    ("form", "mode"),
    [
        ("database.url={url}", ("-m",)),
        ("++database.url='{url}'", ()),
        ('database={{url: "{url}"}}', ("-m",)),
    ],
)
def test_a_password_on_the_command_line_goes_nowhere(
    seatrial: Command,
    postgres: Postgres,
    capsys: pytest.CaptureFixture[str],
    form: str,
    mode: tuple[str, ...],
) -> None:
    fake = seatrial.pretend()
    fake.failing = {2}
    url = postgres.new_database()
    option = form.format(url=url if "'" in form or '"' in form else escaped(url))
    seed = "seed=1,2" if mode else "seed=2"
    said = [
        seatrial(*mode, seed, option),
        seatrial(*mode, seed, option, "dry_run=true"),
        seatrial("seed=7", option),
        seatrial("seed=7", option),
        seatrial("--cfg", "job", option),
        seatrial("bogus=1", option),
    ]
    assert set(fake.ran) >= {2, 7}
    assert "already in the logbook" in said[3].out
    assert PASSWORD not in repr(said)
    assert PASSWORD not in everything(url)
    assert "127.0.0.1" not in everything(url)  # nothing of the address
    for shown in ([], ["--command"], ["--traceback"]):
        assert compare(["show", "1", *shown, "--database", url]) == 0
        assert PASSWORD not in repr(capsys.readouterr())
    assert compare(["retry", "--database", url]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert shlex.split(line) == ["python", "-m", "runner", "seed=2", "database=postgresql"]


@pytest.mark.parametrize("mode", [(), ("-m",)])
def test_a_password_in_the_environment_goes_nowhere(
    seatrial: Command,
    postgres: Postgres,
    monkeypatch: pytest.MonkeyPatch,
    mode: tuple[str, ...],
) -> None:
    seatrial.pretend().failing = {2}
    url = postgres.new_database()
    monkeypatch.setenv("SEATRIAL_DATABASE", url)
    said = [
        seatrial(*mode, "database=postgresql", "seed=2", "dry_run=true"),
        seatrial(*mode, "database=postgresql", "seed=2"),
        seatrial("database=postgresql", "--cfg", "job", "--resolve"),
        seatrial("database=postgresql", "seed=${database.url}"),
    ]
    assert "postgresql://sailor:***@127.0.0.1" in said[2].out
    assert PASSWORD not in repr(said)
    assert PASSWORD not in everything(url)


def test_a_traceback_that_is_asked_for_holds_no_password(tmp_path: Path) -> None:
    url = "postgresql\\://me\\:s3cr3t\\:x@127.0.0.1\\:9/none"
    for option in ("seed=1", "seed=-1", "seed=[1"):
        answer = subprocess.run(
            [sys.executable, "-m", "runner", f"database.url={url}", option],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT), "HYDRA_FULL_ERROR": "1"},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert answer.returncode != 0
        assert "Traceback" in answer.stderr
        assert "s3cr3t" not in answer.stdout + answer.stderr


TEXT = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=6, max_size=20)


@given(TEXT)
def test_a_known_password_is_hidden_in_every_form(text: str) -> None:
    password = f"{text}9-"  # no plain word
    url = URL.create("postgresql", "me", password, "host", 5432, "db")
    rendered = url.render_as_string(hide_password=False)
    mask = Mask()
    mask.learn(rendered)
    hydra = "".join(f"\\{c}" if c in "\\()[]{}:=, \t'\"" else c for c in rendered)
    for form in (rendered, hydra, repr(hydra), repr(repr(hydra)), shlex.quote(hydra)):
        shown = mask(f"run database.url={form} seed=1")
        assert url.password is not None
        assert str(url).split("@")[0].split(":")[-1] == "***"
        for secret in (password, rendered.split("://me:")[1].split("@")[0]):
            assert secret not in shown
        assert shown.endswith("seed=1") or "'" in form
        assert mask(shown) == shown


def test_what_is_no_password_is_left_alone() -> None:
    mask = Mask()
    mask.learn("postgresql://me:plsr@host/db")  # a plain word that means something here
    for text in (
        "identifier=plsr seed=1",
        "http://host:80/page",
        "expected postgresql://USER@HOST/NAME",
        "12:30:01 a@b:c",
        "password authentication failed for user me",
        "sqlite:///results/results.db",
    ):
        assert mask(text) == text
    assert "plsr" not in mask("postgresql\\://me\\:plsr@host/db")


def test_the_address_is_no_part_of_an_order() -> None:
    words = [
        *("identifier=ls", "database=postgresql", "results_dir=a", "seed=1"),
        *("database.url=postgresql://a", "+database.url=x", "database={url: a}", "~database.url=q"),
    ]
    assert without_address(words) == words[:4]


@pytest.fixture
def old(url: str, results_dir: Path) -> str:
    """A logbook as an older version wrote it: five cells of a run and two of a sweep."""
    secret = "database.url=postgresql\\://me\\:hunter2@host/db"
    with Logbook.open(url, results_dir=results_dir) as logbook:
        sweep = logbook.begin_sweep("s", "c", [], 1)
        run = logbook.begin_run(make_start(1), sweep).run_id
        logbook.fail_run(run, "failed", "E", "no", "trace", make_results())
        clean = logbook.begin_run(make_start(2), sweep).run_id
        logbook.finish_run(clean, make_results())
    writer = engine.writer(parse(url))
    command = f"python -m runner {secret} seed=1"
    texts = {"error": f"no {secret}", "traceback": f"trace {secret!r}", "note": secret}
    with writer.begin() as connection:
        connection.execute(
            update(Run)
            .where(Run.id == run)
            .values(overrides=["seed=1", secret], command=command, **texts)
        )
        connection.execute(update(Sweep).values(overrides=[secret], command=command))
    writer.dispose()
    return url


def test_an_old_logbook_is_found_out_shown_masked_and_scrubbed(
    old: str, results_dir: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    place = ["--database", old, "--results-dir", str(results_dir)]
    commands = [
        ["show", "1"],
        ["show", "1", "--command"],
        ["show", "1", "--traceback"],
        ["runs", "--format", "json"],
        ["sql", "SELECT * FROM run"],
        ["report", "--output", str(tmp_path / "report.html")],
        ["export", str(tmp_path / "out")],
        ["verify", "--results-dir", str(results_dir)],
    ]
    codes = [compare([*words, "--database", old]) for words in commands]
    said = capsys.readouterr()
    assert codes == [0] * 7 + [1]
    assert "hunter2" not in said.out + said.err
    exported = [path.read_bytes() for path in (tmp_path / "out").glob("*.csv")]
    assert exported
    assert not any(b"hunter2" in text for text in exported)
    assert "hunter2" not in (tmp_path / "report.html").read_text()
    assert "run 1" in said.out
    assert "password" in said.out
    assert compare(["scrub", *place]) == 0
    assert "2 rows" in capsys.readouterr().err
    assert compare(["verify", *place]) == 0
    assert "hunter2" not in everything(old)
    with Logbook.read(old, results_dir=results_dir) as logbook:
        assert logbook.run(1).overrides == ["seed=1"]
        assert logbook.run(1).command == "python -m runner seed=1"
        assert logbook.run(2).command == make_start().command
    for file in results_dir.glob("results.db*"):  # nor in what the database has freed
        assert b"hunter2" not in file.read_bytes()
    capsys.readouterr()
    assert compare(["scrub", *place]) == 0
    assert "no row contains a password" in capsys.readouterr().err


def test_retry_hands_the_address_over_in_the_environment(
    seatrial: Command, postgres: Postgres, monkeypatch: pytest.MonkeyPatch
) -> None:
    seatrial.pretend().failing = {2}
    url = postgres.new_database()
    seatrial("seed=2", f"database.url={escaped(url)}")
    calls: list[tuple[list[str], str]] = []

    def start(
        command: list[str], check: bool, env: dict[str, str]
    ) -> subprocess.CompletedProcess[str]:
        calls.append((command, env["SEATRIAL_DATABASE"]))
        return subprocess.CompletedProcess(command, returncode=0)

    monkeypatch.setattr(subprocess, "run", start)
    assert compare(["retry", "--execute", "--database", url]) == 0
    ((command, address),) = calls
    assert PASSWORD not in " ".join(command)
    assert parse(address).url.password == PASSWORD


def test_text_that_is_made_to_be_slow_is_not() -> None:
    began = time.perf_counter()
    Mask()("://a:" * 20_000)
    assert time.perf_counter() - began < 2.0  # without a bound on its length, ten times as long
