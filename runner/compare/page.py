"""Self-contained HTML pages: templates, figures as inline SVG, and atomic writing of files."""

import re
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from seatrial.models.errors import LogbookError
from seatrial.runner.database.terminal import visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATES = Path(__file__).with_name("templates")
SQLITE = b"SQLite format 3\0"  # the first bytes of a database
WIDE_FIGURE = 7.0  # a wider figure fills a row of the page [inch]
CSS_PX_PER_POINT = 4.0 / 3.0
PLACES = re.compile(r' (?:d|x|y)="[^"]*"|translate\([^)]*\)')
DECIMALS = re.compile(r"(\d\.\d\d)\d+")
THINNED_COLUMNS = 700  # of a line that is thinned: more than a panel has pixels
LEGIBLE = 0.72  # smallest scale of a figure; below it the figure scrolls


@dataclass(frozen=True)
class Picture:
    """A figure as inline SVG; `width` is its smallest legible width [CSS px]."""

    caption: str
    svg: Markup
    width: int
    wide: bool


def render_page(template: str, folder: Path = TEMPLATES, **context: object) -> str:
    """Render a page from a template of a folder; a missing value is an error."""
    environment = Environment(
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    written = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    return environment.get_template(template).render(written=written, **context)


def write_page(page: str, file: Path) -> None:
    """Write a page atomically; raises LogbookError if the file cannot be written."""
    if not file.name:
        raise LogbookError(f"{file}: cannot write the report: expected the name of a file")
    if _is_database(file):
        raise LogbookError(f"{file}: got a SQLite database, expected the name of the report")
    temporary = file.with_name(f".{file.name}.tmp")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(visible(page), encoding="utf-8")
        temporary.replace(file)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise LogbookError(f"{file}: cannot write the report: {error.strerror}") from error


def _is_database(file: Path) -> bool:
    try:
        with file.open("rb") as stream:
            return stream.read(len(SQLITE)) == SQLITE
    except OSError:  # there is none; or what it is shows when it is written
        return False


def thin(figure: "Figure") -> None:
    """Keep the lowest and the highest sample of every column of pixels of lines over time.

    Lines whose x does not increase, such as tracks, and lines with gaps stay as they are.
    """
    for axes in figure.axes:
        for line in axes.lines:
            x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
            if len(x) > 4 * THINNED_COLUMNS and np.all(np.diff(x) > 0.0) and np.all(np.isfinite(y)):
                log = axes.get_xscale() == "log" and x[0] > 0.0
                kept = _extremes(np.log(x) if log else x, y)
                line.set_data(x[kept], y[kept])


def _extremes(x: NDArray[np.float64], y: NDArray[np.float64]) -> list[int]:
    """Return the samples (n,) that are the first, last, lowest or highest of a column of pixels."""
    edges = np.linspace(x[0], x[-1], THINNED_COLUMNS + 1)[1:-1]
    parts = np.split(np.arange(len(x)), np.searchsorted(x, edges))
    kept = {0, len(x) - 1}
    for part in parts:
        if len(part):
            kept |= {int(part[np.argmin(y[part])]), int(part[np.argmax(y[part])])}
    return sorted(kept)


def picture(figure: "Figure", caption: str, prefix: str) -> Picture:
    """Return a figure as an element of a page; the prefix makes its ids unique on the page.

    `caption` is also the label of the image. Lines of many samples are thinned, and coordinates
    are rounded to a hundredth of a point, so that pages stay small.
    """
    out = StringIO()
    thin(figure)
    figure.savefig(out, format="svg", metadata={"Date": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(PLACES, lambda place: DECIMALS.sub(r"\1", place[0]), svg)
    svg = re.sub(r'(?<=[ \n]id=")', prefix, svg)
    svg = re.sub(r'(?<=href="#)', prefix, svg)
    svg = re.sub(r"(?<=url\(#)", prefix, svg)
    label = str(Markup.escape(caption))
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)
    width = figure.get_figwidth() * 72.0 * CSS_PX_PER_POINT
    wide = figure.get_figwidth() > WIDE_FIGURE
    return Picture(caption, Markup(svg), round(LEGIBLE * width), wide)
