"""Single runs that are newer than the sweep of a table are named, not silently left out."""

from pathlib import Path

import pytest

from tests.runner.programs import TRIALS, ended, program, sweep


def table(folder: Path, *options: str) -> tuple[str, str]:
    words = ("-m", "runner.compare", "table", *options)
    code, out, err = ended(program(*words, folder=folder))
    assert code == 0, err
    return out, err


@pytest.mark.slow
def test_a_table_names_the_runs_that_are_newer_than_its_sweep(tmp_path: Path) -> None:
    assert ended(sweep("seed=0,1", folder=tmp_path))[0] == 0
    assert table(tmp_path)[1] == ""
    assert ended(program("-m", "runner", *TRIALS, "seed=2", folder=tmp_path))[0] == 0
    out, hint = table(tmp_path)
    assert "2 runs" in out
    assert hint == "1 newer run is of no sweep and left out: --sweep all\n"
    out, hint = table(tmp_path, "--sweep", "all")
    assert ("3 runs" in out, hint) == (True, "")
    assert table(tmp_path, "--where", "id=3")[1] == ""
