"""Machine code on disk: named by the sources and the signature, shared by every process."""

import importlib
import json
import os
import pkgutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numba
import pytest
from numba.core.dispatcher import Dispatcher

from seatrial import models
from seatrial.models import compiled
from seatrial.models.compiled import kernel

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]

PACKAGE = {
    "__init__.py": "",
    "law.py": """
from seatrial.models.compiled import kernel
@kernel
def inner(x):
    '''Twice x.'''
    return 2.0 * x
""",
    "ship.py": """
from seatrial.models.compiled import kernel
from seatrial.models.law import inner
@kernel
def drag(x):
    return inner(x) + 1.0
@kernel
def side(gains):
    return gains.kp * 2
@kernel
def turn(x):
    return x * x
""",
}
HEAD = """
import logging, sys
logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
from seatrial.models.ship import drag, side, turn
from seatrial.models.law import inner
"""
TAIL = """
print("misses", sum(sum(k.stats.cache_misses.values()) for k in (inner, drag, side, turn)))
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A package of its own that compiles as ours does."""
    folder = tmp_path / "seatrial" / "models"
    folder.mkdir(parents=True)
    own = {
        name: (ROOT / "models" / name).read_text() for name in ("compiled.py", "source_digest.py")
    }
    for name, text in (PACKAGE | own | {"../__init__.py": ""}).items():
        (folder / name).write_text(text)
    return tmp_path


def start(root: Path, program: str) -> "subprocess.Popen[str]":
    environment = os.environ | {"SEATRIAL_CACHE": str(root / "cache"), "PYTHONPATH": str(root)}
    return subprocess.Popen(
        [sys.executable, "-c", HEAD + program + TAIL], env=environment, cwd=root, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


def lines(process: "subprocess.Popen[str]") -> list[str]:
    out, _ = process.communicate(timeout=240)
    assert process.returncode == 0, out
    return out.splitlines()


def test_the_first_process_says_that_it_compiles_and_the_next_what_changed(checkout: Path) -> None:
    """A changed callee makes its callers compile again, a changed docstring does not."""
    law, program = checkout / "seatrial" / "models" / "law.py", "print(drag(3.0), turn(3.0))"
    first = "compiling ship.{} (first time on this machine)"
    names = ("drag", "turn")
    messages = [first.format(name) for name in names]
    assert lines(start(checkout, program)) == [*messages, "7.0 9.0", "misses 2"]
    text = law.read_text()
    law.write_text(text.replace("Twice x.", "Twice x.\n\n    As it was.").replace("@", "# law\n@"))
    assert lines(start(checkout, program)) == ["7.0 9.0", "misses 0"]
    law.write_text(text.replace("2.0 *", "3.0 *"))
    times = checkout / "cache" / "compilation-times.json"
    assert json.loads(times.read_text()).keys() == {f"seatrial.models.ship.{n}" for n in names}
    times.write_text('{"seatrial.models.ship.drag": 0.9, "seatrial.models.ship.turn": 7.1}')
    assert lines(start(checkout, program)) == [
        "compiling ship.turn (7 s last time)", "10.0 9.0", "misses 2",
    ]  # fmt: skip


def test_only_what_python_calls_is_compiled_to_machine_code(checkout: Path) -> None:
    """A callee is linked into its caller; called from Python it is compiled by itself."""
    program = "print(drag(3.0), len(inner.overloads), *(f() for f in {}))"
    for calls in ("[]", "[lambda: inner(3.0)]"):
        lines(start(checkout, program.format(calls)))
        files = [path.name.partition("-")[0] for path in (checkout / "cache").rglob("*.nbc")]
        assert sorted(files) == ["seatrial.models.ship.drag"] or calls != "[]"
    assert sorted(files) == ["seatrial.models.law.inner", "seatrial.models.ship.drag"]
    again = lines(start(checkout, program.format("[lambda: inner(3.0)]")))
    assert again == ["7.0 0 6.0", "misses 0"]


def test_numba_still_links_what_was_not_optimised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The undocumented parts of numba that `_Fragment` depends on are as they were."""
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)

    @kernel
    def inner(x: float) -> float:
        if x < 0.0:
            raise ValueError("negative")
        return 2.0 * x

    @kernel
    def outer(x: float) -> float:
        return inner(x) + 1.0

    changed = f"numba {numba.__version__} compiles callees otherwise; see models/compiled.py"
    assert outer(3.0) == 7.0, changed
    (fragment,) = inner._inner.overloads.values()  # type: ignore[attr-defined]
    (whole,) = outer.overloads.values()  # type: ignore[attr-defined]
    assert isinstance(fragment.library, compiled._Fragment), changed
    engine = whole.library.codegen._engine
    assert engine.is_symbol_defined(whole.fndesc.llvm_cpython_wrapper_name), changed
    assert not engine.is_symbol_defined(fragment.fndesc.llvm_cpython_wrapper_name), changed
    assert fragment.fndesc.mangled_name not in whole.library.get_asm_str(), changed
    with pytest.raises(ValueError, match="negative"):
        outer(-1.0)


@pytest.mark.nightly
def test_processes_that_save_at_once_keep_all_their_code(checkout: Path) -> None:
    arguments = ("3.0", "3", "3j", "3.0")
    at_once = [start(checkout, f"print(turn({argument}))") for argument in arguments]
    assert [lines(process)[-2] for process in at_once] == ["9.0", "9", "(-9+0j)", "9.0"]
    assert lines(start(checkout, "print(turn(3.0), turn(3), turn(3j))")) == [
        "9.0 9 (-9+0j)", "misses 0",
    ]  # fmt: skip


def test_code_that_was_changed_under_a_running_process_is_not_kept(checkout: Path) -> None:
    """Its folder is named by the sources that it started with."""
    law = checkout / "seatrial" / "models" / "law.py"
    text = law.read_text()
    change = f"open({str(law)!r}, 'w').write({text.replace('2.0', '3.0')!r}); print(drag(3.0))"
    assert lines(start(checkout, change))[-2:] == ["7.0", "misses 1"]
    assert not [*(checkout / "cache").rglob("*.nbc")]
    law.write_text(text)
    assert lines(start(checkout, "print(drag(3.0))"))[-2:] == ["7.0", "misses 1"]


@pytest.mark.nightly
def test_types_from_elsewhere_are_told_apart(checkout: Path) -> None:
    """By their modules, which other programs need not have, and by the content of these files."""
    for name, factor in (("one", 1), ("two", 10)):
        (checkout / f"{name}.py").write_text(
            "from typing import NamedTuple\n"
            "from seatrial.models.compiled import kernel\n"
            "class Gains(NamedTuple):\n"
            "    kp: float\n"
            "@kernel\n"
            f"def part(gains): return {factor} * gains.kp\n"
        )
    program = "import {0}; print(side({0}.Gains(1.0)), {0}.part({0}.Gains(1.0)))"
    one, two = program.format("one"), program.format("two")
    assert lines(start(checkout, one))[-2:] == ["2.0 1.0", "misses 1"]
    assert lines(start(checkout, two))[-2:] == ["2.0 10.0", "misses 1"]
    (checkout / "two.py").unlink()
    assert lines(start(checkout, one)) == ["2.0 1.0", "misses 0"]
    text = (checkout / "one.py").read_text()
    (checkout / "one.py").write_text(text.replace("return 1 ", "return 5 "))
    assert lines(start(checkout, one))[-2:] == ["2.0 5.0", "misses 1"]


@pytest.mark.nightly
def test_damaged_files_are_made_again(checkout: Path) -> None:
    program = "print(turn(3.0), turn(3))"
    lines(start(checkout, program))
    for file, content in zip((checkout / "cache").rglob("*.nbc"), (b"", b"damaged"), strict=True):
        file.write_bytes(content)
    assert lines(start(checkout, program))[-2:] == ["9.0 9", "misses 2"]
    assert lines(start(checkout, program)) == ["9.0 9", "misses 0"]


def test_what_cannot_be_kept_is_compiled(checkout: Path) -> None:
    """Where nothing can be written, and for a kernel that is in no file."""
    blocked = "from seatrial.models import compiled\n"
    blocked += "compiled.cache_folder = lambda: compiled.Path('/proc')\n"
    typed = "print(turn(3.0), compiled.kernel(lambda x: x + 1.0)(1.0))"
    assert lines(start(checkout, blocked + typed))[-2:] == ["9.0 2.0", "misses 1"]


def test_no_two_kernels_have_one_name() -> None:
    """Within `models/` the name of a kernel, with its bytecode, stands for its code."""
    kernels: dict[int, Dispatcher] = {}
    for module in pkgutil.walk_packages(models.__path__, f"{models.__name__}."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Dispatcher):
                kernels[id(value)] = value
    names = Counter(
        (k.py_func.__module__, k.py_func.__qualname__, k.targetoptions.get("forceinline"))
        for k in kernels.values()
    )
    assert len(names) > 50
    assert [name for name, count in names.items() if count > 1] == []
