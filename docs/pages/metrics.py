"""Tables of metrics: names, units, direction and words are those of the catalogue."""

from fnmatch import fnmatchcase

from docs.pages.markdown import code, prose
from docs.pages.markdown import table as markdown_table
from seatrial.runner.record.catalogue import METRICS, Definition

HEADERS = ("metric", "unit", "better", "what it is")


def selected(*patterns: str) -> list[Definition]:
    """The metrics whose names fit one of the patterns, in the order of the catalogue."""
    return [one for one in METRICS if any(fnmatchcase(one.name, form) for form in patterns)]


def table(*patterns: str) -> str:
    """The table of these metrics."""
    rows = [
        [
            f'<span id="{one.name}"></span>{code(one.name)}',
            prose(one.units) or "–",
            prose(one.better_text) or "neither",
            prose(f"{one.formula}. {one.note}." if one.note else one.formula),
        ]
        for one in selected(*patterns)
    ]
    return markdown_table(HEADERS, rows)
