"""The sources stay in order: no circles of imports, no function too long to read."""

import io
import shutil
import subprocess
import tarfile
from importlib import import_module
from pathlib import Path

import pytest

from docs.house import BEFORE, BEFORE_FIGURES, ROOT, House

SMALL = {
    "models/__init__.py": "",
    "models/errors.py": "class Wrong(Exception): ...\n",
    "models/vessel/__init__.py": "",
    "models/vessel/basis.py": (
        "from typing import TYPE_CHECKING\n"
        "from seatrial.models.errors import Wrong\n"
        "if TYPE_CHECKING:\n    from .table import Table\n"
    ),
    "models/vessel/table.py": "from seatrial.models.vessel import basis\nclass Table: ...\n",
    "models/vessel/device.py": "from seatrial.models.sea.basis import Sea\n",
    "models/excitation/schedule.py": "x = 1\ny = 2\n",
    "models/planning/lattice.py": "x = 1\n",
    "models/sea/__init__.py": "from seatrial.models.vessel import basis\n",
    "models/sea/basis.py": (
        "def _f(a, b, c, d, e, f, g, h, i, j, k, l, m): ...\n"
        "f_kernel = kernel(_f)\n"
        "class Sea:\n"
        "    def at(self, b, c, d, e, f, g, h, i, j, k, l, m): ...\n"
        "    def on(self, a, b, c, d, e, f, g, h, i, j, k, l, *, m): ...\n"
    ),
    "runner/__init__.py": "",
    "runner/trial.py": (
        "from typing import Any\n"
        "def run(x: Any) -> Any:\n"
        "    from models.vessel.table import Table\n"
        "    from models import errors\n" + "    x += 1\n" * 58
    ),
    "tests/test_sea.py": "x = 1\n",
}
# A new pair must not come in; the folders of the runner are made anew later.
ALLOWED_PAIRS = [
    ("runner", "runner/compare"),
    ("runner", "runner/database"),
    ("runner", "runner/export"),
    ("runner", "runner/record"),
]


@pytest.fixture(scope="module")
def house() -> House:
    return House()


def test_no_files_import_each_other_in_a_circle(house: House) -> None:
    assert house.circles() == []


def test_no_more_folders_import_each_other(house: House) -> None:
    assert house.mutual_folders() == ALLOWED_PAIRS


def test_no_function_is_too_long(house: House) -> None:
    assert [str(function) for function in house.too_long()] == []


def test_no_function_but_a_kernel_has_too_many_arguments(house: House) -> None:
    assert [str(function) for function in house.too_many_arguments()] == []


@pytest.mark.parametrize("package", ["", ".runner.database", ".runner.compare", ".runner.export"])
def test_names_imported_at_first_use_are_there(package: str) -> None:
    module = import_module(f"seatrial{package}")
    assert module.__all__
    for name in module.__all__:
        getattr(module, name)


def test_a_small_house_is_counted_right(tmp_path: Path) -> None:
    for name, text in SMALL.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    small = House(tmp_path)
    # runner -> vessel -> errors, runner -> errors, and sea on its own
    assert small.imported["models/vessel/basis.py"] == {
        "models/errors.py", "models/vessel/table.py",
    }  # fmt: skip
    assert small.circles() == [["models/vessel/basis.py", "models/vessel/table.py"]]
    assert small.mutual_folders() == [("models/sea", "models/vessel")]
    assert [function.name for function in small.too_many_arguments()] == ["on"]
    assert [function.name for function in small.too_long()] == ["run"]
    assert small.figures()["lines of tests"] == 1
    # By a name and by patterns; `models/` beside the areas does not count.
    assert {int(row["step"]): lines for row, lines in small.areas() if lines} == {7: 3, 30: 62}


def test_areas_share_no_file(house: House) -> None:
    names = [name for row, _ in house.areas() for name in row["files"].split()]
    assert len(set(names)) == len(names)
    assert sum(lines for _, lines in house.areas()) <= sum(house.lines.values())


def test_the_figures_before_are_those_of_their_commit(tmp_path: Path) -> None:
    git = shutil.which("git")
    if git is None:
        pytest.skip("git is not installed")
    command = [git, "-C", str(ROOT), "archive", BEFORE, "models", "runner", "tests"]
    archive = subprocess.run(command, capture_output=True, check=False)
    if archive.returncode:
        pytest.skip(f"commit {BEFORE} is not in this checkout's history")
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(tmp_path, filter="data")
    assert tuple(House(tmp_path).figures().values()) == BEFORE_FIGURES
