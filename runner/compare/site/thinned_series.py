"""Series with as many samples as a screen shows: tracks by stride, the others by their extremes."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from seatrial.runner.compare.site.run_columns import Json
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series

TRACK_SAMPLES = 600
STRETCHES = 300  # of which a line keeps the lowest and the highest sample
DIGITS = 5  # significant
PLANE = ("x", "y", "x_d", "y_d", "psi")
ERRORS = ("e_pos", "e_psi")


def thinned(series: Series) -> Json | None:
    """Return the columns of a series that the page draws; None if it draws none of them.

    `track` holds columns of equal length in metres and radians, `lines` pairs of time [s] and
    value by column; `every` says how many samples one stands for.
    """
    columns = {name: np.asarray(v, dtype=np.float64) for name, v in series.columns.items()}
    t = columns.get("t", np.zeros(0))
    track = {name: columns[name] for name in PLANE if name in columns}
    lines = [name for name in columns if name in ERRORS or name.startswith("residual_")]
    if not t.size or not ({"x", "y"} <= track.keys() or lines):
        return None
    stride = max(1, -(-t.size // TRACK_SAMPLES))
    rows = np.unique(np.append(np.arange(0, t.size, stride), t.size - 1))
    return {
        "every": stride,
        "track": {name: _rounded(values[rows]) for name, values in track.items()},
        "lines": {name: [*map(_rounded, extremes(t, columns[name]))] for name in lines},
        "units": {name: series.units.get(name, "") for name in (*track, *lines)},
        "training_ends_s": _training_end(t, columns),
    }


def extremes(t: Sample, values: Sample) -> tuple[Sample, Sample]:
    """Return the lowest and the highest sample of each stretch, in their order.

    `t` and `values` have shape (n,), the results at most (2 STRETCHES,). Values that are not finite
    are left out.
    """
    kept = np.isfinite(values)
    t, values = t[kept], values[kept]
    if values.size <= 2 * STRETCHES:
        return t, values
    edges = np.linspace(0, values.size, STRETCHES + 1, dtype=np.int64)
    rows: Sequence[int] = [
        edge
        for low, high in pairwise(edges.tolist())
        for edge in (low + int(np.argmin(values[low:high])), low + int(np.argmax(values[low:high])))
    ]
    chosen = np.unique(np.array(rows))
    return t[chosen], values[chosen]


def _training_end(t: Sample, columns: Mapping[str, Sample]) -> float | None:
    """Return the end of the training part [s], if it is the first part of the series."""
    train = columns.get("train")
    if train is None or not np.any(train > 0) or np.all(train > 0) or np.any(np.diff(train) > 0):
        return None
    return float(t[int(np.argmin(train))])


def _rounded(values: Sample) -> list[float | None]:
    return [float(f"{v:.{DIGITS}g}") if np.isfinite(v) else None for v in values.tolist()]
