"""retry, export, prune and verify: what they show, what they do, and what they leave alone."""

import csv
import json
import shlex
import shutil
import sqlite3
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare import commands
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database


@pytest.fixture
def copy(plain: Path, tmp_path: Path) -> Path:
    """A copy of the plain logbook that a test may change."""
    return Path(shutil.copytree(plain, tmp_path / "copy"))


@pytest.fixture
def voyage_copy(sailed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sailed, tmp_path / "copy"))


def _change(folder: Path, statement: str) -> None:
    with closing(sqlite3.connect(folder / "results.db")) as connection, connection:
        connection.execute(statement)


def _count(folder: Path, table: str) -> int:
    with closing(sqlite3.connect(folder / "results.db")) as connection:
        number: int = connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
    return number


def test_retry_prints_the_command_of_each_failed_trial(program: Program, plain: Path) -> None:
    code, out, _ = program("retry", *database(plain))
    assert (code, len(out.splitlines())) == (0, 1)
    assert shlex.split(out) == [
        *("python", "-m", "runner", "identifier=ls", "seed=1", f"results_dir={plain}")
    ]
    _, out, _ = program("retry", *database(plain), "--status", "failed,diverged")
    assert [line.split()[4] for line in out.splitlines()] == ["seed=1", "seed=2"]
    _, out, _ = program("retry", *database(plain), "--status", "diverged", "--where", "seed=1")
    assert out == ""


def test_a_failure_that_was_made_good_is_not_repeated(program: Program, tmp_path: Path) -> None:
    with stored.logbook_at(tmp_path) as logbook:
        stored.fail(logbook, stored.start("ls"))
        stored.finish(logbook, stored.start("ls"), [stored.force_mse(1.0)])
    code, out, err = program("retry", *database(tmp_path))
    assert (code, out) == (0, "")
    assert "nothing to retry" in err


def test_ages() -> None:
    for text, hours in (("30d", 720.0), ("12h", 12.0), ("2w", 336.0), ("90m", 1.5)):
        assert commands.age(text) == timedelta(hours=hours)
    for text in ("30", "d", "-1d", "1.5d", "30 d", "1y", "9999999d", ""):
        with pytest.raises(ConfigurationError, match="expected an age such as 30d"):
            commands.age(text)


def test_prune_shows_and_deletes_only_with_yes(program: Program, voyage_copy: Path) -> None:
    arguments = ["prune", *database(voyage_copy), "--where", "identifier=plsr"]
    code, out, err = program(*arguments)
    assert code == 0
    assert "2 runs with 8 series" in out
    assert "--yes deletes" in err
    assert _count(voyage_copy, "run") == 9
    code, _, err = program(*arguments, "--yes")
    assert (code, err.strip()) == (0, "deleted 2 runs and 2 files")
    assert _count(voyage_copy, "run") == 7
    assert _count(voyage_copy, "diagnostic WHERE run_id IN (2, 4)") == 0
    files = sorted(path.name for path in (voyage_copy / "series").iterdir())
    assert len(files) == 5  # of 7
    assert not any("000002" in name or "000004" in name for name in files)
    assert program("verify", *database(voyage_copy))[0] == 0


def test_prune_by_age_and_status(program: Program, copy: Path) -> None:
    _change(copy, "UPDATE run SET started_at = '2020-01-01 00:00:00.000000' WHERE id = 14")
    _, out, _ = program("prune", *database(copy), "--older-than", "30d", "--format", "json")
    assert [run["run_id"] for run in json.loads(out)] == [14]
    _, out, _ = program("prune", *database(copy), "--status", "failed,diverged", "--format", "json")
    assert [run["run_id"] for run in json.loads(out)] == [14, 15]
    arguments = ["--older-than", "30d", "--status", "diverged"]
    assert "0 runs" in program("prune", *database(copy), *arguments, "--yes")[1]
    assert _count(copy, "run") == 17


def test_prune_without_a_clear_choice_is_refused(program: Program, copy: Path) -> None:
    for arguments, expected in (
        ([], "expected --older-than, --status or --where"),
        (["--older-than", "soon"], "expected an age"),
        (["--status", "running"], "expected one of failed"),
        (["--status", ""], "--status: got no status"),  # a variable that is not set
        (["--where", "1=1"], "--where"),
    ):
        code, out, err = program("prune", *database(copy), *arguments, "--yes")
        assert (code, out, len(err.splitlines())) == (2, "", 1)
        assert expected in err
    assert _count(copy, "run") == 17


def test_export_writes_every_table_twice(program: Program, plain: Path, tmp_path: Path) -> None:
    code, out, _ = program("export", tmp_path / "out", *database(plain))
    assert code == 0
    names = {Path(line).name for line in out.splitlines()}
    for table in ("run", "metric", "coefficient", "diagnostic", "series", "sweep"):
        assert {f"{table}.csv", f"{table}.parquet"} <= names
    with (tmp_path / "out" / "run.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == 17


def test_verify_of_a_whole_logbook_says_so(program: Program, sailed: Path) -> None:
    code, out, _ = program("verify", *database(sailed))
    assert code == 0
    assert "checked 9 runs and 7 series files: no problems" in out


def test_verify_names_what_is_damaged_missing_or_left_over(
    program: Program, voyage_copy: Path
) -> None:
    files = sorted((voyage_copy / "series").glob("run-*"))
    files[0].write_bytes(files[0].read_bytes() + b"x")
    files[1].unlink()
    (voyage_copy / "series" / "stray.parquet").write_text("")
    _change(voyage_copy, "INSERT INTO reuse VALUES (99, 1)")
    code, out, _ = program("verify", *database(voyage_copy), "--format", "json")
    problems = json.loads(out)
    assert code == 1
    assert len(problems) == 4
    assert sum("unused" in problem["problem"] for problem in problems) == 1
    assert any(p["where"].startswith("run 1, series ") for p in problems)
    assert any("stray.parquet" in p["where"] for p in problems)


def test_what_killed_programs_left_is_no_damage_and_can_be_deleted(
    program: Program, voyage_copy: Path
) -> None:
    series = voyage_copy / "series"
    whole = sorted(series.iterdir())
    left = ["run-000009-0123456789ab.parquet", ".run-000001-0123456789ab.parquet.7.tmp"]
    for name in left:
        (series / name).write_bytes(b"half")
    code, out, _ = program("verify", *database(voyage_copy))
    assert code == 0
    assert "no problems, 2 unused files" in out
    code, out, err = program("prune", "--orphans", *database(voyage_copy))
    assert code == 0
    assert all(name in out.replace("\n", "") for name in left)
    assert "--yes deletes these files" in err
    assert len(list(series.iterdir())) == len(whole) + 2
    code, _, err = program("prune", "--orphans", "--yes", *database(voyage_copy))
    assert (code, err) == (0, "deleted 2 files\n")
    assert sorted(series.iterdir()) == whole
    code, _, err = program("prune", "--orphans", "--where", "seed=1", *database(voyage_copy))
    assert code == 2
    assert "--orphans alone" in err


def test_a_new_logbook_leaves_the_series_of_one_that_is_lost(
    program: Program, voyage_copy: Path
) -> None:
    before = {path: path.read_bytes() for path in (voyage_copy / "series").iterdir()}
    file = voyage_copy / "results.db"
    kept = file.read_bytes()
    file.unlink()
    assert program("verify", *database(voyage_copy))[0] == 2
    assert not file.exists()
    with stored.logbook_at(voyage_copy) as logbook:
        logbook.begin_run(stored.start("ls", seed=77))
    file.write_bytes(kept)
    assert program("verify", *database(voyage_copy))[0] == 0
    assert {path: path.read_bytes() for path in before} == before


def test_a_file_of_zero_bytes_without_series_is_made_a_logbook(
    program: Program, tmp_path: Path
) -> None:
    (tmp_path / "results.db").touch()  # as a program leaves it that is killed as it starts
    code, _, err = program("verify", *database(tmp_path))
    assert code == 2
    assert "there is no logbook" in err
    with stored.logbook_at(tmp_path) as logbook:
        assert logbook.runs() == []
