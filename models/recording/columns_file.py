"""Columns of a recording by their names or places: motion of a manoeuvre."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.column_map import read_table
from seatrial.models.recording.sources import ReadOptions, read_sources
from seatrial.models.vessel.basis import Array

DEGREES = "_deg"  # suffix of a quantity in degrees
QUANTITIES = ("t", "x", "y", "psi", "helm", "u", "v")
NEEDED = ("t", "x", "y", "psi", "helm")
REPEATED = 0.02  # share of the duration by which rounded times may deviate from equal steps


def parse_columns(text: str) -> dict[str, str]:
    """Columns by quantity, from `t=1,x=2,psi_deg=5`; raises ConfigurationError."""
    columns: dict[str, str] = {}
    for part in next(csv.reader([text])):
        quantity, equals, column = (piece.strip() for piece in part.partition("="))
        if not equals or quantity.removesuffix(DEGREES) not in QUANTITIES or not column:
            raise ConfigurationError(
                f"--columns: got {part.strip()!r}, expected QUANTITY=COLUMN, a quantity of "
                f"{', '.join(QUANTITIES)}, or psi_deg, helm_deg"
            )
        columns[quantity] = column
    given = {name.removesuffix(DEGREES) for name in columns}
    missing = [name for name in NEEDED if name not in given]
    if missing:
        raise ConfigurationError(f"--columns: no {missing[0]}, expected {', '.join(NEEDED)}")
    return columns


def read_columns(path: Path, columns: Mapping[str, str]) -> dict[str, Array]:
    """The quantities of a file in SI units and radians, (N,) each.

    Raises RecordingError for a file that cannot be read, that lacks a column, and for times that
    do not rise.
    """
    if all(column.isdigit() for column in columns.values()):
        values = _by_place(path, {name: int(column) for name, column in columns.items()})
    else:
        table = read_table(path, list(columns.values()))
        values = {name: table.columns[column] for name, column in columns.items()}
    for name in [name for name in values if name.endswith(DEGREES)]:
        values[name.removesuffix(DEGREES)] = np.radians(values.pop(name))
    values["t"] = _rising(path, values["t"])
    values["psi"] = np.unwrap(values["psi"])
    return values


def _by_place(path: Path, places: Mapping[str, int]) -> dict[str, Array]:
    """Columns by their numbers, counted from 1."""
    source = next(iter(read_sources(path, ReadOptions()).values()))
    names = list(source.columns)
    for place in places.values():
        if not 1 <= place <= len(names):
            raise RecordingError(f"{path}: got {len(names)} columns, no column {place}")
    return {name: source.numbers(names[place - 1]) for name, place in places.items()}


def _rising(path: Path, t: Array) -> Array:
    """Times [s] from 0 on; equidistant ones in place of times rounded so that some are equal."""
    equal = np.linspace(t[0], t[-1], len(t))
    if np.all(np.diff(t) > 0.0):
        equal = t
    elif np.any(np.diff(t) < 0.0) or np.max(np.abs(equal - t)) > REPEATED * (t[-1] - t[0]):
        row = int(np.argmax(np.diff(t) <= 0.0)) + 2
        raise RecordingError(f"{path}: the time does not rise in row {row} of numbers")
    return np.asarray(equal - equal[0])
