"""Error of the position that is predicted over a given time.

It is the root mean square of the distance [m] between the predicted and the measured position, each
prediction beginning at the state that was measured the given time before.
"""

import numpy as np

from seatrial.runner.compare.benchmark.scores import MEAN_MOTION, PERSISTENCE, Score
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series

POSITION = ("x", "y")


def position_score(series: Series, model: str, seconds: float) -> Score:
    """Return the distances [m] after `seconds` in the series `prediction`, as errors of one output.

    Its loss is their root mean square, inf without predictions.
    PERSISTENCE holds the measured velocity in NED, MEAN_MOTION moves by the mean of the measured
    displacements; both where a prediction of the nominal model ends.
    """
    measured = np.column_stack([series.columns[name] for name in POSITION])
    starts, period_s = series.columns["start"], float(np.median(np.diff(series.columns["t"])))
    steps = max(round(seconds / period_s), 1)
    of = "nominal" if model in (PERSISTENCE, MEAN_MOTION) else model
    ends = _predicted(series, of, seconds)
    if ends is None or not np.any(reached := ~np.isnan(ends[:, 0])):
        return Score(np.array([np.inf]), np.full((len(starts), 1), np.inf), starts, period_s, {})
    before = np.roll(measured, steps, axis=0)
    if model == PERSISTENCE:
        ends = before + seconds * np.roll(_velocity(series), steps, axis=0)
    elif model == MEAN_MOTION:
        ends = before + np.mean((measured - before)[reached], axis=0)
    distance = np.linalg.norm(ends - measured, axis=1)[reached, None]
    piece = np.cumsum(starts)[reached]
    first = np.diff(piece, prepend=piece[0] - 1) != 0
    return Score(np.sqrt(np.mean(distance**2, axis=0)), distance, first, period_s, {})


def _predicted(series: Series, model: str, seconds: float) -> Sample | None:
    names = [f"{name}_{model}_{seconds:g}s" for name in POSITION]
    if any(name not in series.columns for name in names):
        return None
    return np.column_stack([series.columns[name] for name in names])


def _velocity(series: Series) -> Sample:
    """Measured velocity along north and east [m/s], shape (N, 2)."""
    u, v, psi = (series.columns[name] for name in ("surge", "sway", "psi"))
    return np.column_stack([u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)])
