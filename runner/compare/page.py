"""Self-contained pages: templates, figures as inline SVG, and files written whole."""

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import Any

from markupsafe import Markup

from seatrial.models.errors import LogbookError

WIDE = 7.0  # from this width on a figure has the row to itself [inch]
CSS_PX_PER_POINT = 4.0 / 3.0
LEGIBLE = 0.72  # of its natural size a figure may shrink to before it scrolls


@dataclass(frozen=True)
class Picture:
    """A figure as inline SVG; `width` is the narrowest it is legible at [CSS px]."""

    caption: str
    svg: Markup
    width: int
    wide: bool


def render_page(template: str, **context: object) -> str:
    """A page from one of the templates; a value that is missing is an error."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    written = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    return environment.get_template(template).render(written=written, **context)


def write_page(page: str, file: Path) -> None:
    """Write a page, whole or not at all; LogbookError where the file cannot be written."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_name(f".{file.name}.tmp")
        temporary.write_text(page, encoding="utf-8")
        temporary.replace(file)
    except OSError as error:
        raise LogbookError(f"{file}: cannot write the report: {error.strerror}") from error


def picture(figure: Any, caption: str, prefix: str) -> Picture:
    """A figure as an element of a page; its ids get the prefix, for they must differ there."""
    out = StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'(?<=[ \n]id=")', prefix, svg)
    svg = re.sub(r'(?<=href="#)', prefix, svg)
    svg = re.sub(r"(?<=url\(#)", prefix, svg)
    label = str(Markup.escape(caption))
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)
    width = figure.get_figwidth() * 72.0 * CSS_PX_PER_POINT
    wide = figure.get_figwidth() > WIDE
    return Picture(
        caption, Markup(svg), round(LEGIBLE * width), wide
    )  # drawn here, and nowhere else
