"""Times of a recording in seconds: numbers in any unit, seconds with nanoseconds, date-times."""

from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.recording.column import Column
from seatrial.models.recording.source import Source
from seatrial.models.recording.units import factor
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:  # slow to import
    import pandas as pd
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")


def seconds(source: Source, column: Column) -> Array:
    """Times [s] of the rows of a source, shape (N,); date-times since 1970, UTC.

    A date-time without a zone is UTC. Raises RecordingError if a cell is neither a number nor a
    date-time.
    """
    name = source.find(column.name) or column.name
    values = source.columns.get(name)
    if values is not None and values.dtype == np.object_ and _is_date(str(values[0])):
        times = _of_dates(source, name)
    else:
        unit = column.unit or source.units.get(name)
        times = source.numbers(name, gaps=True) * (factor(unit, "s") if unit else 1.0)
    if column.nanoseconds is not None:
        times = times + 1e-9 * source.numbers(column.nanoseconds)
    if column.uniform and len(times) > 1:
        times = np.linspace(times[0], times[-1], len(times))
    return column.sign * times


def _is_date(text: str) -> bool:
    return ":" in text or text.count("-") + text.count("/") > 1


def _of_dates(source: Source, name: str) -> Array:
    cells = [str(cell).strip().replace("/", "-") for cell in source.columns[name]]
    times = pd.to_datetime(cells, format="ISO8601", utc=True, errors="coerce")
    wrong = np.asarray(times.isna())
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise RecordingError(
            f"{source.path}, column {name}, {source.cell(row, name).place}: got {cells[row]!r}, "
            "expected a date and time such as 2025-04-11T11:51:09.416Z"
        )
    return np.asarray(times.as_unit("ns").asi8, dtype=np.float64) * 1e-9
