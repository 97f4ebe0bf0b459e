"""Names and units in the titles of columns."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

UNIT = re.compile(r"(?P<name>.*?\S)[\s_]*[\[(](?P<unit>[^\[\]()]*)[\])]")


class Names(NamedTuple):
    """Names of the columns, and what their titles say besides."""

    names: list[str]
    written: dict[str, str]  # titles that differ from the names
    units: dict[str, str]
    repeated: Mapping[str, int]  # names that several columns have


def names_of(titles: Sequence[str], below: Sequence[str] = ()) -> Names:
    """The names and units of columns: `t [s]` is `t` in `s`, a column without title is c1, c2 ...

    `below` are the cells of a second line of titles, which hold units. Columns whose names differ
    by the unit only keep their titles.
    """
    plain, units = [], []
    for place, title in enumerate(titles):
        match = UNIT.fullmatch(title)
        name, unit = (match["name"], match["unit"].strip()) if match else (title, "")
        units.append(below[place].strip("[]() ") if below and below[place] else unit)
        plain.append(name)
    counts = Counter(plain)
    names = [
        (title if counts[name] > 1 else name) or f"c{place + 1}"
        for place, (name, title) in enumerate(zip(plain, titles, strict=True))
    ]
    return Names(
        names,
        {name: title for name, title in zip(names, titles, strict=True) if name != title},
        {name: unit for name, unit in zip(names, units, strict=True) if unit},
        {title: count for title, count in Counter(titles).items() if count > 1 and title},
    )
