"""The sources stay in order: no circles of imports, no function too long to read."""

import ast
from collections import Counter
from importlib import import_module
from pathlib import Path

import pytest

from docs.house import House
from tests.runner.test_layers import house

SMALL = {
    "models/errors.py": "class Wrong(Exception): ...\n",
    "models/vessel/basis.py": "from typing import TYPE_CHECKING\n"
    "if TYPE_CHECKING:\n    from .table import Table\n",
    "models/vessel/table.py": "from models.vessel import basis\n"
    "from seatrial.models.sea.basis import Sea\n",
    "models/sea/basis.py": "from seatrial.models.vessel.basis import x\n"
    "def _f(a, b, c, d, e, f, g, h, i, j, k, l, m): ...\nf_kernel = kernel(_f)\n"
    "class Sea:\n"
    "    def at(self, b, c, d, e, f, g, h, i, j, k, l, m): ...\n"
    "    def on(self, a, b, c, d, e, f, g, h, i, j, k, l, *, m): ...\n",
    "runner/trials/trial.py": "def run(x):\n" + "    x += 1\n" * 60,
}


@pytest.fixture(name="house")
def of_the_checkout() -> House:
    return house()


def test_no_files_import_each_other_in_a_circle(house: House) -> None:
    assert house.circles() == []


def test_no_two_folders_import_each_other(house: House) -> None:
    assert house.mutual_folders() == []


def test_no_function_is_too_long(house: House) -> None:
    assert [str(function) for function in house.too_long()] == []


def test_no_function_but_a_kernel_has_too_many_arguments(house: House) -> None:
    assert [str(function) for function in house.too_many_arguments()] == []


def test_a_class_has_a_name_of_its_own(house: House) -> None:
    """The Python interface calls a vessel and a recording what the models call them."""
    nodes = (node for tree in house.trees.values() for node in tree.body)
    names = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    assert {name for name, count in names.items() if count > 1} == {"Vessel", "Recording"}


@pytest.mark.parametrize("package", ["", ".runner.database", ".runner.compare", ".runner.export"])
def test_names_imported_at_first_use_are_there(package: str) -> None:
    module = import_module(f"seatrial{package}")
    assert module.__all__
    for name in module.__all__:
        getattr(module, name)


def test_what_is_counted_is_found(tmp_path: Path) -> None:
    for name, text in SMALL.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        (tmp_path / name).with_name("__init__.py").touch()
    small = House(tmp_path)
    assert len(small.circles()) == 1
    assert small.mutual_folders() == [("models/sea", "models/vessel")]
    assert [function.name for function in small.too_many_arguments()] == ["on"]
    assert [function.name for function in small.too_long()] == ["run"]


def test_areas_share_no_file(house: House) -> None:
    names = [name for row, _ in house.areas() for name in row["files"].split()]
    assert len(set(names)) == len(names)
    assert sum(lines for _, lines in house.areas()) <= sum(house.lines.values())
