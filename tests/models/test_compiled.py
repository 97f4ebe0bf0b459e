"""Machine code on disk: keyed by the sources, shared by processes that start at once."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

PROGRAM = """
import numpy as np
from seatrial.models.vessel import basis, thruster
from seatrial.models.compiled import cache_folder
force = thruster.acting_force(thruster.SecondOrderLag(2.0, 0.8), np.ones((50, 2)), 0.1)
stats = thruster._filter.stats
print(cache_folder().name, sum(stats.cache_misses.values()), repr(float(force[-1, 0])))
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """The sources alone, so that nothing changes them meanwhile."""
    for folder in ("models", "seatrial"):
        shutil.copytree(ROOT / folder, tmp_path / "checkout" / folder, symlinks=True)
    shutil.copy(ROOT / "pyproject.toml", tmp_path / "checkout")
    return tmp_path / "checkout"


def start(cache: Path, root: Path, program: str = PROGRAM) -> "subprocess.Popen[str]":
    environment = os.environ | {"SEATRIAL_CACHE": str(cache), "PYTHONPATH": str(root)}
    return subprocess.Popen(
        [sys.executable, "-c", program], env=environment, cwd=root, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def finish(process: "subprocess.Popen[str]") -> list[str]:
    out, error = process.communicate(timeout=240)
    assert process.returncode == 0, error
    return out.split()


def test_a_second_process_compiles_nothing(tmp_path: Path, checkout: Path) -> None:
    folder, missed, force = finish(start(tmp_path, checkout))
    assert int(missed) > 0
    assert finish(start(tmp_path, checkout)) == [folder, "0", force]


def test_processes_that_start_at_once_share_one_compilation(tmp_path: Path, checkout: Path) -> None:
    answers = [finish(process) for process in [start(tmp_path, checkout) for _ in range(4)]]
    assert len({force for _, _, force in answers}) == 1
    assert sum(int(missed) for _, missed, _ in answers) == 1
    assert finish(start(tmp_path, checkout))[1] == "0"  # what they left is whole


def test_a_changed_source_begins_an_empty_cache(tmp_path: Path, checkout: Path) -> None:
    folder, _, force = finish(start(tmp_path, checkout))
    callee = checkout / "models" / "vessel" / "thruster.py"
    text = callee.read_text()
    assert "lag.b[i, 0] * target" in text
    callee.write_text(text.replace("lag.b[i, 0] * target", "0.0 * target"))
    changed, missed, other = finish(start(tmp_path, checkout))
    assert changed != folder
    assert int(missed) > 0
    assert other != force


def test_a_changed_comment_or_docstring_compiles_nothing(tmp_path: Path, checkout: Path) -> None:
    """Not in the kernel's own file either, where it moves the kernel to other lines."""
    folder, _, force = finish(start(tmp_path, checkout))
    for name in ("thruster.py", "basis.py"):
        path = checkout / "models" / "vessel" / name
        first, *rest = path.read_text().split('"""')
        rest = [f"{text}\n\nMore.\n" if n % 2 == 0 else text for n, text in enumerate(rest)]
        path.write_text("# a comment\n\n" + '"""'.join([first, *rest]))
    assert finish(start(tmp_path, checkout)) == [folder, "0", force]


def test_code_that_was_changed_under_a_running_process_is_not_kept(
    tmp_path: Path, checkout: Path
) -> None:
    """Its folder is named by the sources that it started with."""
    change = "from pathlib import Path; import seatrial.models.vessel.thruster"
    change += "; path = Path('models/vessel/thruster.py')"
    change += "; text = path.read_text(); path.write_text(text + '\\nADDED = 1\\n')\n"
    folder, missed, force = finish(start(tmp_path, checkout, change + PROGRAM))
    assert int(missed) > 0
    assert not list((tmp_path / folder).glob("*.nb?"))
    path = checkout / "models" / "vessel" / "thruster.py"
    path.write_text(path.read_text().removesuffix("\nADDED = 1\n"))
    assert finish(start(tmp_path, checkout)) == [folder, missed, force]


def test_nothing_is_lost_where_the_cache_cannot_be_written(tmp_path: Path, checkout: Path) -> None:
    """A folder that is full or read-only is no error: every process compiles for itself."""
    blocked = (
        "from seatrial.models import compiled\n"
        "compiled.cache_folder = lambda: compiled.Path('/proc')\n"
    )
    _, missed, force = finish(start(tmp_path, checkout, blocked + PROGRAM))
    assert int(missed) > 0
    assert float(force) != 0.0
