"""The tables of the logbook as text and as a figure: `python -m docs.pages.database > tables.svg`.

Both are made from the metadata of SQLAlchemy.
"""

from html import escape

from sqlalchemy import Column, Table
from sqlalchemy.dialects import sqlite

from docs.pages.markdown import code, table
from seatrial.runner.database.tables import Base
from seatrial.runner.database.views import NAMES, statements

FIGURE = "reference/tables.svg"
WIDTH, GAP, LINE, HEAD = 300, 90, 17, 24  # of a table and its rows [px]
DIALECT = sqlite.dialect()
HEADERS = ("column", "type", "null", "key")
_DARK = (
    ":root{--line:#456;--head:#dde6f2;--text:#123;--soft:#567;--back:#fff}"
    "@media(prefers-color-scheme:dark)"
    "{:root{--line:#9ab;--head:#2b3a4d;--text:#e6edf5;--soft:#a9b8c8;--back:#1b232d}}"
)


def tables() -> str:
    """A section for every table, and the names and columns of the views."""
    sections = [_section(one) for one in Base.metadata.sorted_tables]
    shown = [name for name in NAMES if name != "view_version"]
    bodies = {
        name: text for text in statements("sqlite") for name in shown if f" {name} AS" in text
    }
    for name in shown:
        sections.append(f"### {name}\n\nA view.\n\n```sql\n{bodies[name].strip()}\n```\n")
    return "\n".join(sections)


def _section(one: Table) -> str:
    rows = [
        [code(column.name), _type(column), "yes" if column.nullable else "", _key(column)]
        for column in one.columns
    ]
    return f"### {one.name}\n\n{table(HEADERS, rows)}"


def _type(column: Column[object]) -> str:
    return str(column.type.compile(DIALECT)).lower()


def _key(column: Column[object]) -> str:
    targets = [f"→ {key.target_fullname}" for key in column.foreign_keys]
    return ", ".join((["primary"] if column.primary_key else []) + targets)


def drawn() -> str:
    """The figure as SVG: a box a table, an arrow from every foreign key to its table."""
    columns = _columns()
    places = {}
    for i, column in enumerate(columns):
        y = 10
        for one in column:
            places[one.name] = (10 + i * (WIDTH + GAP), y)
            y += HEAD + LINE * len(one.columns) + 28
    width = 20 + len(columns) * WIDTH + (len(columns) - 1) * GAP
    height = max(y + HEAD + LINE * len(t.columns) for t in _tables() for _, y in [places[t.name]])
    body = [_arrow(one, key, places) for one in _tables() for key in _references(one)]
    body += [_box(one, *places[one.name]) for one in _tables()]  # over arrows that pass behind
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height + 12}" '
        f'width="{width}" height="{height + 12}" font-family="sans-serif" font-size="12" '
        f'role="img"><title>Tables of the logbook</title><style>{_DARK}</style>'
        '<defs><marker id="a" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" '
        'markerHeight="8" orient="auto-start-reverse"><path d="M0 0L8 4L0 8z" '
        f'fill="var(--line)"/></marker></defs>{"".join(body)}</svg>\n'
    )


def _tables() -> list[Table]:
    return Base.metadata.sorted_tables


def _references(one: Table) -> list[tuple[int, str]]:
    """Row of each foreign key, and the table that it names."""
    return [
        (i, key.column.table.name)
        for i, column in enumerate(one.columns)
        for key in column.foreign_keys
    ]


def _columns() -> list[list[Table]]:
    """The tables by how many references lead from them to the first one."""
    depth: dict[str, int] = {}
    for one in _tables():  # a table comes after those that it names
        depth[one.name] = max((depth[name] + 1 for _, name in _references(one)), default=0)
    return [
        [one for one in _tables() if depth[one.name] == i] for i in range(max(depth.values()) + 1)
    ]


def _box(one: Table, x: int, y: int) -> str:
    height = HEAD + LINE * len(one.columns) + 4
    frame = f'<rect x="{x}" y="{y}" width="{WIDTH}"'
    lines = [
        f'{frame} height="{height}" rx="4" fill="var(--back)" stroke="var(--line)"/>',
        f'{frame} height="{HEAD}" rx="4" fill="var(--head)" stroke="var(--line)"/>',
        f'<text x="{x + 8}" y="{y + 16}" font-weight="bold" fill="var(--text)">{one.name}</text>',
    ]
    for i, column in enumerate(one.columns):
        row = y + HEAD + LINE * i + 13
        bold = ' font-weight="bold"' if column.primary_key else ""
        null = " null" if column.nullable else ""
        lines.append(
            f'<text x="{x + 8}" y="{row}"{bold} fill="var(--text)">{escape(column.name)}</text>'
            f'<text x="{x + WIDTH - 8}" y="{row}" text-anchor="end" fill="var(--soft)">'
            f"{_type(column)}{null}</text>"
        )
    return "".join(lines)


def _arrow(one: Table, key: tuple[int, str], places: dict[str, tuple[int, int]]) -> str:
    """From a row of a table to the head of the table that it names, which stands further left."""
    row, name = key
    x, y = places[one.name][0], places[one.name][1] + HEAD + LINE * row + 9
    to_x, to_y = places[name][0] + WIDTH, places[name][1] + HEAD // 2
    bend = to_x + GAP // 2
    return (
        f'<path d="M{x} {y}C{bend} {y} {bend} {to_y} {to_x} {to_y}" fill="none" '
        'stroke="var(--line)" marker-end="url(#a)"/>'
    )


if __name__ == "__main__":
    print(drawn(), end="")
