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
from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from seatrial.models.errors import LogbookError
from seatrial.runner.compare import blocks
from seatrial.runner.compare.blocks import environment
from seatrial.runner.database.terminal import visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SQLITE = b"SQLite format 3\0"  # the first bytes of a database
WIDE_FIGURE = 7.0  # a wider figure fills a row of the page [inch]
CSS_PX_PER_POINT = 4.0 / 3.0
PLACES = re.compile(r' (?:d|x|y)="[^"]*"|translate\([^)]*\)')
DECIMALS = re.compile(r"(\d\.\d\d)\d+")
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
    return (
        environment()
        .get_template("page.html")
        .render(
            written=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
            **{"title": title, "lead": list(lead), "sections": sections, "links": links or {}},
            **{"scripts": scripts, "programs": programs},
        )
    )


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


def picture(figure: "Figure", caption: str, prefix: str) -> Markup:
    """Return a figure as inline SVG; the prefix makes its ids unique on the page.

    `caption` is also the label of the image. Coordinates are rounded to a hundredth of a point, so
    that pages stay small.
    """
    out = StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(PLACES, lambda place: DECIMALS.sub(r"\1", place[0]), svg)
    svg = re.sub(r'(?<=[ \n]id=")|(?<=href="#)|(?<=url\(#)', prefix, svg)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{escape(caption)}"', 1)
    least = round(LEGIBLE * figure.get_figwidth() * 72.0 * CSS_PX_PER_POINT)
    kind = "wide" if figure.get_figwidth() > WIDE_FIGURE else ""
    return blocks.figure(Markup(svg), caption, least, kind)
