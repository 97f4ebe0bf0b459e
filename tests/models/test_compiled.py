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
        shutil.copytree(ROOT / folder, tmp_path / "checkout" / folder)
    shutil.copy(ROOT / "pyproject.toml", tmp_path / "checkout")
    return tmp_path / "checkout"


def start(cache: Path, root: Path) -> "subprocess.Popen[str]":
    environment = os.environ | {"SEATRIAL_CACHE": str(cache), "PYTHONPATH": str(root)}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM], env=environment, cwd=root, text=True,
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
    assert "lag.b[0] * asked" in text
    callee.write_text(text.replace("lag.b[0] * asked", "0.0 * asked"))
    changed, missed, other = finish(start(tmp_path, checkout))
    assert changed != folder
    assert int(missed) > 0
    assert other != force
