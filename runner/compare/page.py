"""The one page maker: sections of blocks under one template, and atomic writing of files.

Every page is made here: the report, those of the site, of the benchmark, of a recording and of the
published figures. A block is Markup in which every text is escaped.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
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
class Section:
    """A part of a page: its heading, the name for links to it, and its blocks."""

    title: str
    anchor: str
    blocks: Sequence[Markup]


def page(
    title: str,
    lead: Iterable[Markup],
    sections: Sequence[Section],
    links: Mapping[str, str] | None = None,
    scripts: Sequence[str] = (),
    programs: Sequence[str] = (),
) -> str:
    """Return a page; it needs no network.

    `lead` stands above the links: those to its sections and `links` (text by address) to other
    pages. `scripts` are files beside the page, `programs` templates of further scripts in it.
    """
    strict: dict[str, Any] = {"autoescape": True, "undefined": StrictUndefined}
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), trim_blocks=True, lstrip_blocks=True, **strict
    )
    return environment.get_template("page.html").render(
        written=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        **{"title": title, "lead": list(lead), "sections": sections, "links": links or {}},
        **{"scripts": scripts, "programs": programs},
    )


# Blocks.


def paragraph(text: str, kind: str = "") -> Markup:
    """Return a paragraph of a class of the style sheet."""
    return Markup('<p class="{}">{}</p>').format(kind, text)


def bullets(lines: Iterable[str | Markup]) -> Markup:
    """Return a list of lines; empty without any."""
    items = Markup("").join(Markup("<li>{}</li>").format(line) for line in lines)
    return Markup("<ul>{}</ul>").format(items) if items else items


def code(text: str) -> Markup:
    """Return lines of a command or a traceback."""
    return Markup("<pre><code>{}</code></pre>").format(text)


def link(address: str, text: str) -> Markup:
    """Return a link to a page or a section."""
    return Markup('<a href="{}" rel="noreferrer">{}</a>').format(address, text)


def status(name: str, text: str) -> Markup:
    """Return a text in the colour of a run's status."""
    return Markup('<span class="status {}">{}</span>').format(name, text)


def facts(pairs: Iterable[tuple[str, str | Markup]]) -> Markup:
    """Return names with what stands for them."""
    rows = (Markup("<dt>{}</dt><dd>{}</dd>").format(name, value) for name, value in pairs)
    return Markup("<dl>{}</dl>").format(Markup("").join(rows))


def folded(summary: str | Markup, *blocks: Markup, opened: bool = False) -> Markup:
    """Return blocks that a click on their summary shows; `opened` ones are shown at first."""
    state, inside = Markup(" open" if opened else ""), Markup("").join(blocks)
    return Markup("<details{}><summary>{}</summary>{}</details>").format(state, summary, inside)


def group(kind: str, *blocks: Markup) -> Markup:
    """Return blocks in a box of a class of the style sheet."""
    return Markup('<div class="{}">{}</div>').format(kind, Markup("").join(blocks))


# Files.


def write_page(page: str, file: Path) -> None:
    """Write a page atomically; raises LogbookError if the file cannot be written."""
    if not file.name:
        raise LogbookError(f"{file}: cannot write the report: expected the name of a file")
    database = False
    with suppress(OSError), file.open("rb") as stream:  # there is none, or it cannot be written
        database = stream.read(len(SQLITE)) == SQLITE
    if database:
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


def thin(figure: "Figure") -> None:
    """Keep the lowest and the highest sample of every column of pixels of lines over time.

    Lines whose x does not increase, such as tracks, and lines with gaps stay as they are.
    """
    for axes in figure.axes:
        for line in axes.lines:
            x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
            if len(x) > 4 * THINNED_COLUMNS and np.all(np.diff(x) > 0.0) and np.all(np.isfinite(y)):
                log = axes.get_xscale() == "log" and x[0] > 0.0
                kept = extremes(np.log(x) if log else x, y, THINNED_COLUMNS)
                line.set_data(x[kept], y[kept])


def extremes(x: NDArray[np.float64], y: NDArray[np.float64], columns: int) -> list[int]:
    """Return the samples that are the first, last, lowest or highest of one of equal columns of x.

    `x` increases; it and `y` have shape (n,) and are finite.
    """
    edges = np.linspace(x[0], x[-1], columns + 1)[1:-1]
    parts = np.split(np.arange(len(x)), np.searchsorted(x, edges))
    ends = [
        int(part[end(y[part])]) for part in parts if len(part) for end in (np.argmin, np.argmax)
    ]
    return sorted({0, len(x) - 1, *ends})


def picture(figure: "Figure", caption: str, prefix: str) -> Markup:
    """Return a figure as inline SVG; the prefix makes its ids unique on the page.

    `caption` is also the label of the image. Lines of many samples are thinned, and coordinates
    are rounded to a hundredth of a point, so that pages stay small.
    """
    out = StringIO()
    thin(figure)
    figure.savefig(out, format="svg", metadata={"Date": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(PLACES, lambda place: DECIMALS.sub(r"\1", place[0]), svg)
    svg = re.sub(r'(?<=[ \n]id=")|(?<=href="#)|(?<=url\(#)', prefix, svg)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{escape(caption)}"', 1)
    least = round(LEGIBLE * figure.get_figwidth() * 72.0 * CSS_PX_PER_POINT)
    kind = "wide" if figure.get_figwidth() > WIDE_FIGURE else ""
    return Markup(
        '<figure class="{}"><div class="scroll" tabindex="0">'
        '<div style="min-width: min({}px, 300%)">{}</div></div>'
        "<figcaption>{}</figcaption></figure>"
    ).format(kind, least, Markup(svg), caption)
