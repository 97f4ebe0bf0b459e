"""A digest of sources changes with what they compute, and with nothing else."""

from pathlib import Path

import pytest

from seatrial.models import source_digest
from seatrial.models.source_digest import KEPT_FILE, folder_digest, imported_files, parse

PLAIN = """
import numpy as np
def speed(u, v):
    return np.hypot(u, v)
class Limits:
    surge = 2.0
"""
DESCRIBED = '''"""Speeds."""


import numpy as np  # arrays


def speed(
    u, v,
):
    """Speed [m/s]."""
    # Pythagoras
    return np.hypot(u,
                    v)

class Limits:
    """Of the ferry."""
    surge = 2.0
    """m/s"""
'''


@pytest.fixture(autouse=True)
def _empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEATRIAL_CACHE", str(tmp_path / "cache"))
    forget()


def forget() -> None:
    source_digest._cached.cache_clear()
    source_digest._source.cache_clear()


def test_comments_docstrings_and_layout_do_not_count() -> None:
    assert parse(PLAIN.encode()) == parse(DESCRIBED.encode())


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("hypot(u, v)", "hypot(v, u)"),
        ("surge = 2.0", "surge = 2.5"),
        ("surge = 2.0", "sway = 2.0"),
        ("def speed(u, v)", "def speed(u, v=None)"),
        ("def speed(u, v)", "def speed(u, v: float)"),
        ("surge = 2.0", "surge = '2.0'"),
        ("surge = 2.0", "surge = None"),
    ],
)
def test_code_counts(before: str, after: str) -> None:
    assert before in PLAIN
    changed = PLAIN.replace(before, after)
    assert parse(changed.encode()).digest != parse(PLAIN.encode()).digest


def test_of_a_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its place does not count, a comment does not, the name of a file does."""
    first, second = tmp_path / "first", tmp_path / "second" / "place"
    for folder, text in ((first, PLAIN), (second, DESCRIBED)):
        (folder / "deep").mkdir(parents=True)
        (folder / "deep" / "speeds.py").write_text(text)
    assert folder_digest(first) == folder_digest(second)
    forget()  # what was parsed is kept on disk
    monkeypatch.setattr(source_digest, "parse", lambda content: pytest.fail("parsed again"))
    assert folder_digest(first) == folder_digest(second)
    (second / "deep" / "speeds.py").rename(second / "speeds.py")
    assert folder_digest(first) != folder_digest(second)


@pytest.mark.parametrize("content", ["", "[1]", '{"a": 1}', "\0"])
def test_a_damaged_file_of_the_cache_is_made_again(tmp_path: Path, content: str) -> None:
    (tmp_path / "speeds.py").write_text(PLAIN)
    first = folder_digest(tmp_path)
    kept = tmp_path / "cache" / KEPT_FILE
    kept.write_text(content)
    forget()
    assert folder_digest(tmp_path) == first
    assert parse(PLAIN.encode()).digest in kept.read_text()


def test_a_read_only_cache_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.py").write_text(PLAIN)
    monkeypatch.setattr(source_digest, "cache_home", lambda: tmp_path / "a.py")
    digest = folder_digest(tmp_path)
    forget()
    assert folder_digest(tmp_path) == digest


def test_imports_are_followed_within_the_package(tmp_path: Path) -> None:
    files = {
        "__init__.py": "",
        "trial.py": "import numpy\nfrom lab import rows\nfrom lab.record import metrics",
        "rows.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import lab.typed",
        "record/__init__.py": "",
        "record/metrics.py": "def f():\n    from . import series\n    from lab.store import save",
        "record/series.py": "import lab.deep.units",
        "deep/units.py": "late = lazy_loader.load('lab.late', suppress_warning=True)",
        "late.py": "",
        "store/__init__.py": "import lab.unused",
        "typed.py": "",
        "unused.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    reached = imported_files(tmp_path / "trial.py", tmp_path, "lab", left_out=("store",))
    assert {path.relative_to(tmp_path).as_posix() for path in reached} == {
        "trial.py", "rows.py", "record/__init__.py", "record/metrics.py", "record/series.py",
        "deep/units.py", "late.py",
    }  # fmt: skip
