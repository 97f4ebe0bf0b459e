"""retry, export, prune and verify: what they show, what they do, and what they leave alone."""

import json
import shlex
import shutil
from datetime import UTC, datetime
from pathlib import Path

import pytest

from seatrial.runner.database import LogbookWriter
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database
from tests.runner.database.samples import change, pretend


@pytest.fixture
def copy(plain: Path, tmp_path: Path) -> Path:
    """A copy of the plain logbook that a test may change."""
    return Path(shutil.copytree(plain, tmp_path / "copy"))


@pytest.fixture
def voyage_copy(sailed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sailed, tmp_path / "copy"))


def _runs(folder: Path) -> int:
    with stored.logbook_at(folder) as logbook:
        return len(logbook.runs())


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


def test_a_failure_that_was_made_good_is_not_repeated(
    program: Program, logbook: LogbookWriter, folder: Path
) -> None:
    stored.fail(logbook, stored.start("ls"))
    stored.finish(logbook, stored.start("ls"), [stored.force_mse(1.0)])
    code, out, err = program("retry", *database(folder))
    assert (code, out, "nothing to retry" in err) == (0, "", True)


def test_prune_shows_and_deletes_only_with_yes(program: Program, voyage_copy: Path) -> None:
    arguments = ["prune", *database(voyage_copy), "--where", "identifier=plsr"]
    code, out, err = program(*arguments)
    assert (code, "2 runs with 8 series" in out, "--yes deletes" in err) == (0, True, True)
    assert _runs(voyage_copy) == 9
    code, _, err = program(*arguments, "--yes")
    assert (code, err.strip()) == (0, "deleted 2 runs and 2 files")
    assert _runs(voyage_copy) == 7
    assert len(list((voyage_copy / "series").iterdir())) == 5  # of 7


def test_prune_by_age_and_status(program: Program, copy: Path) -> None:
    pretend(database(copy)[1], 14, started_at=datetime(2020, 1, 1, tzinfo=UTC))
    old = ["prune", *database(copy), "--where", "started_at<2021-01-01", "--format", "json"]
    assert [run["run_id"] for run in json.loads(program(*old)[1])] == [14]
    _, out, _ = program("prune", *database(copy), "--status", "failed,diverged", "--format", "json")
    assert [run["run_id"] for run in json.loads(out)] == [14, 15]
    assert json.loads(program(*old, "--status", "diverged", "--yes")[1]) == []
    assert _runs(copy) == 17


def test_prune_without_a_clear_choice_is_refused(program: Program, copy: Path) -> None:
    for arguments, expected in (
        ([], "expected --status or --where"),
        (["--older-than", "30d"], "--older-than is gone: use --where"),
        (["--status", "running"], "expected one of failed"),
        (["--status", ""], "prune: got no choice of runs"),  # a variable that is not set
        (["--where", "1=1"], "--where"),
    ):
        code, out, err = program("prune", *database(copy), *arguments, "--yes")
        assert (code, out, len(err.splitlines())) == (2, "", 1)
        assert expected in err
    assert _runs(copy) == 17


def test_export_names_what_it_has_written(program: Program, plain: Path, tmp_path: Path) -> None:
    code, out, _ = program("export", tmp_path / "out", *database(plain))
    assert code == 0
    assert {Path(line) for line in out.splitlines()} == {*(tmp_path / "out").iterdir()}


def test_verify_names_what_is_damaged_missing_or_left_over(
    program: Program, voyage_copy: Path
) -> None:
    code, out, _ = program("verify", *database(voyage_copy))
    assert code == 0
    assert "checked 9 runs and 7 series files: no problems, no unused files" in out
    files = sorted((voyage_copy / "series").glob("run-*"))
    files[0].write_bytes(files[0].read_bytes() + b"x")
    files[1].unlink()
    (voyage_copy / "series" / "stray.parquet").write_text("")
    change(database(voyage_copy)[1], "INSERT INTO reuse VALUES (99, 1)")
    code, out, _ = program("verify", *database(voyage_copy), "--format", "json")
    problems = json.loads(out)
    assert (code, len(problems)) == (1, 4)
    assert any(p["where"].startswith("run 1, series ") for p in problems)
    (unused,) = [p["where"] for p in problems if "unused" in p["problem"]]
    assert "stray.parquet" in unused


def test_what_killed_programs_left_is_no_damage(program: Program, voyage_copy: Path) -> None:
    series = voyage_copy / "series"
    left = ["run-000009-0123456789ab.parquet", ".run-000001-0123456789ab.parquet.7.tmp"]
    for name in left:
        (series / name).write_bytes(b"half")
    code, out, _ = program("verify", *database(voyage_copy))
    assert (code, "no problems, 2 unused files" in out) == (0, True)
    assert all(name in out.replace("\n", "") for name in left)


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
    assert (code, "there is no logbook" in err) == (2, True)
    with stored.logbook_at(tmp_path) as logbook:
        assert logbook.runs() == []
