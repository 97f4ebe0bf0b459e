"""Options given in Python as overrides of the command line: `identifier__basis="physical"`.

Options of tables and figures in Python; their names are those of `seatrial-results`.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, cast

from seatrial.models.errors import ConfigurationError
from seatrial.runner import database
from seatrial.runner.record.vocabulary import GROUPS

NESTED = "__"  # in the name of an argument, for the dot of an option
# Text that the grammar of overrides reads as itself, without quotes.
_PLAIN = re.compile(r"[A-Za-z_/.][\w/.:+-]*", re.ASCII)
_WORDS = ("null", "true", "false", "nan", "inf")  # that it reads as something else


def overrides_of(options: Mapping[str, object]) -> list[str]:
    """Return the overrides of options by name.

    A double underscore stands for the dot of a nested option, and a mapping for several options of
    one group: `controller__kp=[1, 2, 3]` equals `controller={"kp": [1, 2, 3]}`.
    """
    texts = []
    for name, value in options.items():
        key = name.replace(NESTED, ".")
        if key in GROUPS and isinstance(value, Mapping):
            texts += [f"{key}.{inner}={text_of(item)}" for inner, item in value.items()]
        else:
            texts.append(f"{key}={text_of(value)}")
    return texts


def text_of(value: object) -> str:
    """Return a value in the grammar of overrides.

    Takes numbers, text, paths, None, sequences, mappings, NumPy's values, a range (several values
    of a sweep), and vessels and models, which name themselves by `choice`. Raises
    ConfigurationError for anything else.
    """
    choice = getattr(value, "choice", None)
    if isinstance(choice, str):
        return text_of(choice)
    if isinstance(value, range):
        return f"range({value.start},{value.stop},{value.step})"
    if type(value).__module__ == "numpy":  # which the command line does not import
        value = cast(Any, value).tolist()
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | Path):
        return _quoted(str(value))
    if isinstance(value, Mapping):
        return "{" + ",".join(f"{key}:{text_of(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Sequence):
        return "[" + ",".join(map(text_of, value)) + "]"
    raise ConfigurationError(
        f"got a {type(value).__name__}, expected a number, text, None, a list or a mapping"
    )


def _quoted(text: str) -> str:
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    escaped = re.sub(r"(\\*)'", r"\1\1\\'", text)  # backslashes count before a quote only
    trailing = escaped[len(escaped.rstrip("\\")) :]
    return f"'{escaped}{trailing}'"


def place_of(path: str | Path | None) -> list[str]:
    """Return the overrides for a logbook, given by its file or address; None: the default one."""
    if path is None:
        return []
    url = database.engine.url_of(path)
    file = Path(path) if url != str(path) else database.engine.parse(url).path
    series = [] if file is None else [f"results_dir={_quoted(str(file.parent))}"]
    return [*series, f"database.url={_quoted(url)}"]


Names = str | Sequence[str]
Kind = Literal["nominal", "identified", "plant", "adaptive"]


TABLE_LISTS = ("metric", "coefficient", "dof", "stage", "model", "statistic", "baseline", "pool")
PLOT_LISTS = ("dof", "pool")


class Selected(TypedDict, total=False):
    """Which runs: conditions of the options of the same names of `seatrial-results`."""

    where: str  # "seed<10 and identifier=ls"
    sweep: int | str  # number or name of a sweep, or "all"
    tag: str


class TableArguments(Selected, total=False):
    """Options of `seatrial-results table`; several names as a list or comma-separated."""

    rows: Names
    columns: Names
    metric: Names
    coefficient: Names
    coefficients: bool
    dof: Names
    stage: Names
    model: Names
    statistic: Names
    interval: Literal["t", "bootstrap"]
    baseline: Names
    pool: Names
    digits: int
    cells: int


class PlotArguments(Selected, total=False):
    """Options of `seatrial-results plot`."""

    run: int
    metric: str
    rows: str
    columns: str
    dof: Names
    model: str
    facet: str
    log: bool
    pool: Names


def listed(names: Names | None) -> tuple[str, ...]:
    """Return names as a tuple; text is one name, or several with commas, as the shell takes it."""
    if names is None:
        return ()
    return (names,) if isinstance(names, str) else tuple(names)
