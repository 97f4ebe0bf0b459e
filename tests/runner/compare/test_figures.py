"""How figures are found: by their files, and from elsewhere."""

from pathlib import Path

import pytest

from seatrial.models.errors import PartError
from seatrial.runner.compare import figures
from seatrial.runner.compare.plots.request import PlotRequest
from tests.runner.compare.conftest import Program

ELSEWHERE = '''
"""How many runs there are."""

from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.plots.style import Drawing, panels

FIGURE = Figure("runs", "How many runs there are.", "a run", rows="vessel")


def drawings(results, request):
    figure, (axes,) = panels(1, 1, 4.0, 3.0)
    axes.bar([request.rows], [len(results.runs())])
    return [Drawing("number-of-runs", figure)]
'''


def test_the_help_lists_every_figure(program: Program) -> None:
    code, out, _ = program("plot", "--help")
    text = " ".join(out.split())
    assert code == 0
    for one in figures.figures().values():
        assert f"{one.name}: {one.help}"[:60] in text


def test_a_figure_from_elsewhere_is_drawn_by_its_dotted_name(
    program: Program, plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "elsewhere_figures"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "runs.py").write_text(ELSEWHERE)
    (package / "empty.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    options = ("--database", f"sqlite:///{plain}/results.db", "--output", str(tmp_path / "out"))
    code, out, err = program("plot", "elsewhere_figures.runs", *options)
    assert (code, err) == (0, "")
    assert [Path(line).name for line in out.split()] == ["number-of-runs.png", "number-of-runs.svg"]
    code, _, err = program("plot", "elsewhere_figures.empty", *options)
    assert (code, "elsewhere_figures.empty has no FIGURE" in err) == (2, True)


def test_a_fault_in_a_module_from_elsewhere_is_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "faulty_figures").mkdir()
    (tmp_path / "faulty_figures" / "one.py").write_text("import no_such_module_at_all")
    monkeypatch.syspath_prepend(tmp_path)
    named = "plot: cannot import faulty_figures.one: ModuleNotFoundError: .*no_such_module_at_all"
    with pytest.raises(PartError, match=named):
        figures.figure_of("faulty_figures.one")
    (tmp_path / "faulty_figures" / "two.py").write_text("def drawings(*_):\n    return 1 / 0\n")
    with pytest.raises(PartError, match=r"faulty_figures\.two\.drawings: ZeroDivisionError: "):
        figures.drawings_of("faulty_figures.two")(None, PlotRequest())  # type: ignore[arg-type]
