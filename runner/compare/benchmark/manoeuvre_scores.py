"""Measures of the manoeuvres of test files: as measured, and of a model's free run."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.runner.database.records import Series
from seatrial.runner.export.manoeuvre_tracks import (
    Manoeuvre,
    length_of,
    mission_of,
    sheet,
    track_of_series,
)
from seatrial.runner.vocabulary import Config

MODEL = "identified"
NO_RESULT = ("helm", "change of heading")  # of a sheet: what was ordered
MOTION = {"x": "x", "y": "y", "psi": "psi", "u": "surge", "v": "sway"}


@dataclass(frozen=True)
class Measure:
    """A quantity of the manoeuvre of one piece, such as a file; NaN for what is not reached."""

    piece: int
    quantity: str
    unit: str  # L: ship lengths
    measured: float
    predicted: float

    @property
    def error(self) -> float:
        """Error over the measured value; inf for what the model does not reach."""
        error = abs(self.predicted - self.measured) / abs(self.measured)
        return error if math.isfinite(error) else math.inf


def measures(
    prediction: Series, recording: Series, config: Config, manoeuvre: Manoeuvre
) -> list[Measure]:
    """Return the measures of each piece of a run's series `prediction`.

    `recording` is the series of that name, which holds the helm. A piece that is no such manoeuvre,
    and a vessel without a length, have none.
    """
    length = length_of(config)
    helm = str(mission_of(config, "recording").get("helm") or "delta")
    if length is None or helm not in recording.columns or "psi" not in prediction.columns:
        return []
    rows = np.searchsorted(recording.columns["t"], prediction.columns["t"])
    given = recording.columns[helm][rows]
    found = []
    for piece, (first, last) in enumerate(pieces(prediction)):
        part = slice(first, last)
        values = [
            _values(prediction, model, given, part, length, manoeuvre) for model in ("", MODEL)
        ]
        for (name, unit), measured in values[0].items():
            if math.isfinite(measured) and measured != 0.0:
                predicted = values[1].get((name, unit), math.nan)
                found.append(Measure(piece, name, unit, measured, predicted))
    return found


def pieces(series: Series) -> Iterator[tuple[int, int]]:
    """First and last row, which is left out, of each piece of a series `prediction`."""
    yield from pairwise([*np.flatnonzero(series.columns["start"]), len(series.columns["t"])])


def _values(
    series: Series, model: str, helm: np.ndarray, part: slice, length: float, manoeuvre: Manoeuvre
) -> dict[tuple[str, str], float]:
    """Measures by quantity and unit; empty where the motion is not that manoeuvre."""
    suffix = f"_{model}" if model else ""
    columns = {name: series.columns.get(f"{own}{suffix}") for name, own in MOTION.items()}
    shown = {name: values[part] for name, values in columns.items() if values is not None}
    if len(shown) < len(MOTION) or any(np.any(np.isnan(values)) for values in shown.values()):
        return {}
    shown |= {"t": series.columns["t"][part], "helm": helm[part]}
    moved = Series("prediction", shown, dict.fromkeys(shown, ""))
    try:
        result = sheet(track_of_series(moved, "helm", length, model), manoeuvre)
    except RecordingError:
        return {}
    return {
        (entry.quantity, entry.unit): entry.value
        for entry in result.entries
        if (entry.unit in ("L", "deg") or entry.quantity == "period P")
        and entry.quantity not in NO_RESULT
    }
