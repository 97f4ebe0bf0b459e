"""Measures of the manoeuvres of test files: as measured, and of a model's free run."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.runner.export.manoeuvre_tracks import (
    Manoeuvre,
    Sheet,
    length_of,
    measured_sheet,
    mission_of,
    sheet,
    track_of_series,
)
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import Config

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
) -> Iterator[Measure]:
    """Yield the measures of each piece of a run's series `prediction`.

    `recording` is the series of that name, which holds the helm. A piece that is no such manoeuvre,
    and a vessel without a length, have none. Compared are results with a value to which an error is
    relative.
    """
    length = length_of(config)
    helm = str(mission_of(config, "recording").get("helm") or "delta")
    if length is None or helm not in recording.columns or "psi" not in prediction.columns:
        return
    rows = np.searchsorted(recording.columns["t"], prediction.columns["t"])
    columns = {**prediction.columns, "helm": recording.columns[helm][rows]}

    def of(part: slice, model: str = "", turn_deg: float | None = None) -> Sheet | None:
        """Return the sheet of a piece; None where the motion is not that manoeuvre."""
        named = {own: f"{name}_{model}" if model else name for own, name in MOTION.items()}
        if not columns.keys() >= {*named.values()}:
            return None
        shown = {own: columns[name][part] for own, name in named.items()}
        if any(np.any(np.isnan(values)) for values in shown.values()):
            return None
        shown |= {name: columns[name][part] for name in ("t", "helm")}
        moved = Series("prediction", shown, dict.fromkeys(shown, ""))
        track = track_of_series(moved, "helm", length, model)
        try:
            return (sheet if model else measured_sheet)(track, manoeuvre, turn_deg=turn_deg)
        except RecordingError:
            return None

    for piece, ends in enumerate(pieces(prediction)):
        measured = of(slice(*ends))
        if measured is None:
            continue
        model = of(slice(*ends), MODEL, measured.turn_deg)
        predicted = {} if model is None else model.values
        for entry in measured.entries:
            known = math.isfinite(entry.value) and entry.value != 0.0
            lasting = entry.unit in ("L", "deg") or entry.quantity == "period P"
            if known and lasting and entry.quantity not in NO_RESULT:
                own = predicted.get(entry.quantity, math.nan)
                yield Measure(piece, entry.quantity, entry.unit, entry.value, own)


def pieces(series: Series) -> Iterator[tuple[int, int]]:
    """First and last row, which is left out, of each piece of a series `prediction`."""
    yield from pairwise([*np.flatnonzero(series.columns["start"]), len(series.columns["t"])])
