"""Blocks of pages by the macros of `templates/blocks.html`, which escape every text."""

from functools import cache, partial
from html import escape
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from seatrial.runner.database.terminal import visible

TEMPLATES = Path(__file__).with_name("templates")


@cache
def environment() -> Environment:
    """Return the templates; the filter `lines` escapes a text and keeps the ends of its lines."""
    loader, strict = FileSystemLoader(TEMPLATES), StrictUndefined
    options: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True, "undefined": strict}
    templates = Environment(loader=loader, autoescape=True, **options)
    templates.filters["lines"] = lambda text: Markup(escape(visible(text)).replace("\n", "<br>"))
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
table = partial(_block, "table")  # a TextTable, and its headers as cells
figure = partial(_block, "figure")  # the SVG, its caption, its least width [px], and a class
