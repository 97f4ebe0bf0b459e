"""Series files of programs that were killed: found, removed, and never another run's."""

import subprocess
import sys
from pathlib import Path

import pytest

from seatrial.runner.database import LogbookWriter, liveness
from tests.runner.database.samples import make_results, make_start, pretend


def killed(logbook: LogbookWriter, url: str, trial: int) -> int:
    """A run whose process was killed while it wrote its series: all but the last is there."""
    run_id = logbook.begin_run(make_start(trial)).run_id
    child = subprocess.Popen([sys.executable, "-c", ""])
    gone = liveness.identity(child.pid)
    child.wait()
    assert gone is not None
    written = logbook._write_series(run_id, make_results().series)
    path = logbook.results_dir / written[0].path
    path.with_name(f".{path.name}.{child.pid}.tmp").write_bytes(b"half")
    pretend(url, run_id, process=gone)
    return run_id


def names(results_dir: Path) -> list[str]:
    return sorted(path.name[:10] for path in (results_dir / "series").iterdir())


@pytest.fixture
def busy(logbook: LogbookWriter, url: str, results_dir: Path) -> LogbookWriter:
    """Run 1 finished, run 2 killed, run 3 under way and about to name its file."""
    logbook.finish_run(logbook.begin_run(make_start(1)).run_id, make_results())
    killed(logbook, url, 2)
    logbook._write_series(logbook.begin_run(make_start(3)).run_id, make_results().series)
    assert len(names(results_dir)) == 4
    return logbook


KEPT = ["run-000001", "run-000003"]


def test_they_are_no_damage_and_removed_with_the_orphans(
    busy: LogbookWriter, results_dir: Path
) -> None:
    found = busy.verify()
    assert (found.problems, len(found.leftovers)) == ([], 2)
    busy.remove_orphans()
    assert names(results_dir) == KEPT
    assert busy.verify().leftovers == []


def test_another_logbook_in_the_same_folder_keeps_its_files(tmp_path: Path) -> None:
    """Both begin before either has a series; then the numbers of their runs are the same."""
    urls = [f"sqlite:///{tmp_path}/{name}.db" for name in ("one", "two")]
    with (
        LogbookWriter.open(urls[0], results_dir=tmp_path) as one,
        LogbookWriter.open(urls[1], results_dir=tmp_path) as two,
    ):
        one.finish_run(one.begin_run(make_start(1)).run_id, make_results(1.0))
        before = one.series(1, "recording")
        assert killed(two, urls[1], 1) == 1
        two.finish_run(two.begin_run(make_start(1)).run_id, make_results(2.0))
        again = one.series(1, "recording")  # its checksum is right
        assert (again.columns["u"] == before.columns["u"]).all()
        assert one.verify().problems == two.verify().problems == []
