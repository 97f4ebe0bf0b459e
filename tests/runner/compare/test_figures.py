"""How figures are found: by their files; those of plug-ins: tests/test_plugins.py."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.models.errors import PartError
from seatrial.runner.compare import figures
from seatrial.runner.compare.figures import PlotRequest
from tests.runner.compare.conftest import Program

FAULTY = """
from seatrial.runner.compare.figures import Figure

FIGURE = Figure("faulty", "A figure with a fault.", "nothing")


def drawings(*_):
    return 1 / 0
"""


def test_the_help_lists_every_figure(program: Program) -> None:
    code, out, _ = program("plot", "--help")
    text = " ".join(out.split())
    assert code == 0
    for one in figures.figures().values():
        assert f"{one.name}: {one.help}"[:60] in text


@pytest.fixture
def found_again() -> Iterator[None]:
    """Figures are searched for by the test, and once more after it."""
    figures._modules.cache_clear()
    yield
    figures._modules.cache_clear()


def test_a_fault_in_a_figure_from_elsewhere_is_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found_again: None
) -> None:
    (tmp_path / "faulty_figure.py").write_text(FAULTY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("SEATRIAL_PLUGINS", "faulty_figure")
    with pytest.raises(PartError, match=r"faulty_figure\.drawings: ZeroDivisionError: "):
        figures.drawings(None, PlotRequest("faulty"))  # type: ignore[arg-type]
