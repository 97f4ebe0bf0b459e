"""Figures for print: their width, their fonts, and labels that stay whole."""

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import drawings_of, figures
from seatrial.runner.compare.plots import draw, paper
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.compare.results import Queries
from tests.runner.compare.test_plots import of_kind as of_kind
from tests.runner.compare.test_plots import voyages as voyages

MM = 72.0 / 25.4  # points


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "width"),
    [*((kind, "column") for kind in figures()), ("coefficients", "page"), ("wind", "page")],
)
def test_every_kind_fits_the_paper(
    of_kind: Callable[[str], Queries], tmp_path: Path, kind: str, width: str
) -> None:
    """The PDF has the width and TrueType fonts; no text is outside, or other than 8 points."""
    millimetres = paper.width_of(width)
    (path,) = draw(kind, of_kind(kind), PlotRequest(), tmp_path, millimetres)
    content = path.read_bytes()
    box = re.search(rb"/MediaBox \[ 0 0 (\S+) (\S+) \]", content)
    assert path.suffix == ".pdf"
    assert box is not None
    assert float(box[1]) == pytest.approx(millimetres * MM, abs=0.01)
    assert b"/FontFile2" in content  # an embedded TrueType font
    assert b"/Type3" not in content
    assert b"CreationDate" not in content
    with drawn(width_mm=millimetres):
        for drawing in drawings_of(kind)(of_kind(kind), PlotRequest()):
            paper.fit(drawing.figure)
            texts = [text for text in drawing.figure.findobj(Text) if shown(text)]
            assert {text.get_fontsize() for text in texts} == {8.0}  # type: ignore[attr-defined]
            page = drawing.figure.bbox
            for text in texts:
                if text not in inner(drawing.figure.axes):
                    assert inside(text.get_window_extent(), page), text
            for axes in drawing.figure.axes:
                assert apart([t for t in axes.get_xticklabels() if t.get_text()])
                assert axes.get_window_extent().height / drawing.figure.dpi > 0.75


def shown(text: object) -> bool:
    return isinstance(text, Text) and bool(text.get_text().strip()) and text.get_visible()


def inner(axes: list) -> list[Text]:  # type: ignore[type-arg]
    """Ticks: matplotlib also keeps those outside of the limits, which it does not draw."""
    return [text for one in axes for axis in (one.xaxis, one.yaxis) for text in axis.findobj(Text)
            if text is not axis.label]  # fmt: skip


def inside(box: Bbox, page: Bbox) -> bool:
    return bool(box.x0 > -1 and box.y0 > -1 and box.x1 < page.x1 + 1 and box.y1 < page.y1 + 1)


def apart(labels: list[Text]) -> bool:
    """Turned labels may overlap in their boxes, for they are parallel."""
    boxes = sorted((t.get_window_extent() for t in labels), key=lambda box: float(box.x0))
    turned = any(label.get_rotation() for label in labels)
    return turned or all(a.x1 <= b.x0 for a, b in pairwise(boxes))


def test_a_narrow_paper_shows_the_same_panels(voyages: Queries) -> None:
    counts = []
    for width in (None, 60.0):
        with drawn(width_mm=width):
            (drawing,) = drawings_of("response")(voyages, PlotRequest())
            counts.append([(a.get_ylabel(), len(a.lines)) for a in drawing.figure.axes])
    assert counts[0] == counts[1]
    assert len(counts[0]) > 3


def test_the_screen_is_as_before_afterwards(voyages: Queries, tmp_path: Path) -> None:
    first = draw("track", voyages, PlotRequest(), tmp_path / "a")
    draw("track", voyages, PlotRequest(), tmp_path / "b", 86.0)
    second = draw("track", voyages, PlotRequest(), tmp_path / "c")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_a_width_that_is_none_is_refused() -> None:
    for text in ("colum", "-5", "0", "5", "1e9", "nan", "inf", ""):
        with pytest.raises(ConfigurationError, match=r"--width: got .* expected column, page or"):
            paper.width_of(text)


def test_on_the_command_line(
    sailed: Path, tmp_path: Path, program: Callable[..., tuple[int, str, str]]
) -> None:
    words = ("plot", "track", "--database", sailed / "results.db", "--output", tmp_path)
    code, out, _ = program(*words, "--width", "120")
    assert code == 0
    assert [Path(line).suffix for line in out.split()] == [".pdf"]
    assert program(*words, "--width", "wide")[0] == 2
