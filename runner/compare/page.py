"""The one page maker: sections of blocks under one template, and atomic writing of files.

Every page is made here: the report, those of the site, of the benchmark, of a recording and of the
published figures. A block is Markup by a macro of `templates/blocks.html`; it escapes every text.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache, partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from seatrial.models.errors import LogbookError
from seatrial.runner.database.terminal import visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDE_FIGURE = 7.0  # a wider figure fills a row of the page [inch]
PLACES = re.compile(r' (?:d|x|y)="[^"]*"|translate\([^)]*\)')
DECIMALS = re.compile(r"(\d\.\d\d)\d+")
MOST_MARKERS = 1000  # of a figure that are elements of the page; more are one image
LEGIBLE = 0.72 * 96.0  # width of a figure [px/inch], below which it scrolls


@cache
def environment() -> Environment:
    """Return the templates; the filter `lines` escapes a text and keeps the ends of its lines."""
    loader = FileSystemLoader(Path(__file__).with_name("templates"))
    options: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True}
    templates = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, **options)
    templates.filters["lines"] = lambda text: Markup("<br>").join(visible(text).split("\n"))
    return templates


def _block(name: str, *content: Any, **options: Any) -> Markup:
    macro = getattr(environment().get_template("blocks.html").module, name)
    return Markup(macro(*content, **options))


paragraph = partial(_block, "paragraph")  # text, and a class of the style sheet
bullets = partial(_block, "bullets")  # a list of lines; empty without any
code = partial(_block, "code")  # lines of a command or a traceback
link = partial(_block, "link")  # an address, and the text of a link to it
status = partial(_block, "status")  # a status, and a text in its colour
facts = partial(_block, "facts")  # pairs of names with what stands for them
folded = partial(_block, "folded")  # a summary, and blocks that a click on it shows; opened=True
group = partial(_block, "group")  # a class of the style sheet, and the blocks in its box
html_table = partial(_block, "table")  # a TextTable, whose headings sort it


class Section(NamedTuple):
    """A part of a page: its heading, the name for links to it, and its blocks."""

    title: str
    anchor: str
    blocks: Sequence[Markup]


def page(
    title: str, lead: Iterable[Markup], sections: Sequence[Section],
    links: Mapping[str, str] | None = None, scripts: Sequence[str] = (),
    programs: Sequence[str] = (),
) -> str:  # fmt: skip
    """Return a page; it needs no network.

    `lead` stands above the links: those to its sections and `links` (text by address) to other
    pages. `scripts` are files beside the page, `programs` templates of further scripts in it.
    """
    written = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    content = {"title": title, "lead": list(lead), "sections": sections, "links": links or {}}
    files = {"scripts": scripts, "programs": programs}
    return environment().get_template("page.html").render(written=written, **content, **files)


def write_page(page: str, file: Path) -> None:
    """Write a page atomically; raises LogbookError if the file cannot be written."""
    temporary = file.parent / f".{file.name}.tmp"
    try:
        if file.is_file() and file.read_bytes().startswith(b"SQLite format 3\0"):
            raise LogbookError(f"{file}: got a SQLite database, expected the name of the report")
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(visible(page), encoding="utf-8")
        temporary.replace(file)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise LogbookError(f"{file}: cannot write the report: {error.strerror}") from error


def picture(figure: "Figure", caption: str, prefix: str, **size: float) -> Markup:
    """Return a figure as inline SVG; the prefix makes its ids unique on the page.

    `caption` is also the label of the image; `size` may give another `figheight` [inch].
    Pages stay small: coordinates are rounded to a hundredth of a point, many markers are an image.
    """
    figure.set(**size)
    lines: list[Any] = [line for axes in figure.axes for line in axes.lines]
    marked = [line for line in lines if line.get_marker() not in ("", "None")]
    several = sum(len(line.get_xdata()) for line in marked) > MOST_MARKERS
    for line in marked:
        line.set_rasterized(several)
    out = StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    svg = "<svg" + out.getvalue().partition("<svg")[2]
    svg = re.sub(PLACES, lambda place: DECIMALS.sub(r"\1", place[0]), svg)
    svg = re.sub(r'(?<=[ \n]id=")|(?<=href="#)|(?<=url\(#)', prefix, svg)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{escape(caption)}"', 1)
    width = figure.get_figwidth()
    kind = "wide" if width > WIDE_FIGURE else ""
    return _block("figure", Markup(svg), caption, round(LEGIBLE * width), kind)
