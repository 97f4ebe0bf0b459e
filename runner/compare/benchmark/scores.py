"""Scores of a trial's predictions: normalised errors of the free run and over given times.

The error of an output is its root mean square over the standard deviation of what was measured
(NRMSE); FIT = 100 (1 - NRMSE) %. A model that predicts the mean of the measured motion has 1, one
that diverges has inf. The loss of a case is the mean over the outputs. nonlinearbenchmark.org.

A prediction with a band is scored as a normal distribution, by the share of what was measured that
lies in its band of 90 %, and by the continuous ranked probability score (CRPS), in units of the
output's deviation: of a prediction without a band it is the mean absolute error.

The error of the position that is predicted over a given time is the root mean square of the
distance [m] to the measured one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from seatrial.runner.compare.ranking import block_bootstrap
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import IDENTIFIED_STD

PERSISTENCE = "persistence"  # the first measured velocity, held
MEAN_MOTION = "mean_motion"  # the mean of the measured velocity
AT_REST = "at_rest"  # the position that was measured before
REFERENCES = (MEAN_MOTION, PERSISTENCE, AT_REST)
POSITION = ("x", "y")
INTERVAL_LEVEL = 0.9
BLOCK_S = 30.0
BAND_LEVEL = 0.9


@dataclass(frozen=True, eq=False)
class Score:
    """Errors (N, n) of a prediction over the spread of each output, by time; of a position [m].

    `starts` (N,) marks the first sample of each piece, such as a file; `after` is the NRMSE of each
    output by horizon [s]; `deviations` (N, n) are those of a band over the spread, if there is one.
    """

    errors: Sample
    starts: Sample
    period_s: float
    after: dict[float, Sample] = field(default_factory=dict)
    deviations: Sample | None = None

    @cached_property
    def nrmse(self) -> Sample:
        """NRMSE of each output (n,); inf without samples, and for one that is not finite."""
        return _rms(self.errors)

    @property
    def covered(self) -> Sample | None:
        """Whether the outputs (N, n) are in the band; None without one. Starts are left out."""
        if self.deviations is None:
            return None
        inside = np.abs(self.errors) <= half_width(self.deviations)
        return np.asarray(inside[self.starts == 0.0])

    @property
    def crps(self) -> Sample:
        """CRPS (N, n) over the spread, without starts."""
        errors = self.errors
        each = np.abs(errors) if self.deviations is None else crps(errors, self.deviations)
        return np.asarray(each[self.starts == 0.0])

    @property
    def loss(self) -> float:
        """Mean NRMSE over the outputs."""
        return float(np.mean(self.nrmse))

    def pieces(self) -> list[Sample]:
        """Errors of each piece, such as a file."""
        return np.split(self.errors, np.flatnonzero(self.starts)[1:])


def score(
    series: Series, model: str, outputs: Sequence[str], horizons_s: Sequence[float] = ()
) -> Score:
    """Score the free run of a model, or of PERSISTENCE or MEAN_MOTION, on the series `prediction`.

    `outputs` are degrees of freedom. A model without a prediction scores inf.
    """
    spread = np.std(_columns(series, outputs), axis=0)
    after = {}
    for seconds in horizons_s:
        ahead = _errors(series, model, outputs, seconds) / spread
        after[seconds] = _rms(ahead[~np.isnan(ahead[:, 0])])
    band = None
    if model == "identified" and f"{outputs[0]}_{IDENTIFIED_STD}" in series.columns:
        band = _columns(series, [f"{name}_{IDENTIFIED_STD}" for name in outputs]) / spread
    errors = _errors(series, model, outputs) / spread
    return Score(errors, series.columns["start"], _period_s(series), after, band)


def score_after(series: Series, model: str, outputs: Sequence[str], seconds: float) -> Score:
    """Score the predictions `seconds` after every measured state, in the series `prediction`.

    `outputs` are degrees of freedom, or POSITION, whose errors are distances [m]: of one output. A
    model that lacks a prediction where some model has one scores inf.
    """
    reached = _reached(series, seconds)
    errors = _errors(series, model, outputs, seconds)
    if outputs == POSITION:
        errors = np.linalg.norm(errors, axis=1)[:, None]
    else:
        errors = errors / np.std(_columns(series, outputs), axis=0)
    piece = np.cumsum(series.columns["start"])[reached]
    starts = np.asarray(np.diff(piece, prepend=-1) != 0, dtype=np.float64)
    return Score(errors[reached], starts, _period_s(series))


def _errors(
    series: Series, model: str, outputs: Sequence[str], seconds: float | None = None
) -> Sample:
    """Errors (N, n) of the free run, or of predictions from the state `seconds` before.

    NaN where no prediction ends; those of the trivial rivals end where some model's do. PERSISTENCE
    holds the velocity that was measured before, for a position in NED; MEAN_MOTION moves by the
    mean of what was measured; AT_REST stays at the position before, and has no velocity.
    """
    measured, columns = _columns(series, outputs), series.columns
    if model not in REFERENCES or (model == AT_REST and outputs != POSITION):
        end = "" if seconds is None else f"_{seconds:g}s"
        return _columns(series, [f"{name}_{model}{end}" for name in outputs]) - measured
    if seconds is None:
        rows = np.arange(len(measured))
        before = measured[np.maximum.accumulate(np.where(columns["start"], rows, 0))]
        reached, steps = np.full(len(measured), True), 0
    else:
        steps = max(round(seconds / _period_s(series)), 1)
        before, reached = np.roll(measured, steps, axis=0), _reached(series, seconds)
    predicted = before
    if model == MEAN_MOTION and outputs != POSITION:
        predicted = np.broadcast_to(measured.mean(axis=0), measured.shape)
    elif model == MEAN_MOTION:
        predicted = before + np.mean((measured - before)[reached], axis=0)
    elif model == PERSISTENCE and outputs == POSITION and seconds is not None:
        u, v, psi = (columns[name] for name in ("surge", "sway", "psi"))
        north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
        predicted = before + seconds * np.roll(np.column_stack([north, east]), steps, axis=0)
    return np.where(reached[:, None], predicted - measured, np.nan)


def half_width(deviations: Sample, level: float = BAND_LEVEL) -> Sample:
    """Half the width of the band of a level, of a normal distribution."""
    return NormalDist().inv_cdf(0.5 + 0.5 * level) * deviations


def crps(errors: Sample, deviations: Sample) -> Sample:
    """CRPS of a normal distribution, in the unit of the errors.

    s (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)), z = e / s; |e| where s is zero. Gneiting and
    Raftery (2007), J. Am. Stat. Assoc. 102, eq. (21).
    """
    from scipy.special import ndtr  # slow to import

    with np.errstate(over="ignore"):
        z = np.clip(errors / np.maximum(deviations, np.finfo(float).tiny), -40.0, 40.0)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    spread = deviations * (2.0 * density - 1.0 / np.sqrt(np.pi))
    return np.asarray(errors * (2.0 * ndtr(z) - 1.0) + spread)


def pooled(scores: Sequence[Score]) -> Sample:
    """Return the NRMSE of each output (n,) over the samples of several free runs."""
    return _rms(np.concatenate([score.errors for score in scores]))


def interval(scores: Sequence[Score], seed: int = 0) -> tuple[float, float]:
    """Return the 90 % interval of the mean of `pooled`, by a bootstrap of files and blocks."""
    pieces = [piece for score in scores for piece in score.pieces()]
    drawn = _drawn(pieces, scores[0].period_s, seed).mean(axis=1)
    low, high = np.quantile(drawn, [(1.0 - INTERVAL_LEVEL) / 2.0, (1.0 + INTERVAL_LEVEL) / 2.0])
    return float(low), float(high)


def chance(first: Sequence[Score | None], other: Sequence[Score | None], seed: int = 0) -> float:
    """Return the p-value of equal pooled losses of two entrants, by a paired bootstrap.

    `first` and `other` are their scores of the same files: both are drawn at the same files and
    blocks. None is that of a run that failed: where some scores are lost or diverge, 1 if they are
    those of the same files for both, else 0. NaN for scores that do not match.
    """
    own, others = ([each for each in scores if each is not None] for scores in (first, other))
    lost, lost_too = (
        [each is None or not np.isfinite(each.loss) for each in scores] for scores in (first, other)
    )
    if any(lost) or any(lost_too):
        return float(lost == lost_too)
    if [each.errors.shape for each in own] != [each.errors.shape for each in others]:
        return np.nan
    pairs = zip(own, others, strict=True)
    both = [np.hstack(two) for a, b in pairs for two in zip(a.pieces(), b.pieces(), strict=True)]
    drawn = _drawn(both, own[0].period_s, seed)
    half = drawn.shape[1] // 2
    gain = drawn[:, half:].mean(axis=1) - drawn[:, :half].mean(axis=1)
    better = np.mean(gain > 0.0) + 0.5 * np.mean(gain == 0.0)
    return float(min(2.0 * min(better, 1.0 - better) + 2.0 / len(drawn), 1.0))


def _drawn(pieces: Sequence[Sample], period_s: float, seed: int) -> Sample:
    """Return the NRMSE (resamples, n) over pieces and blocks that are drawn again."""
    length = max(round(BLOCK_S / period_s), 1)
    return np.sqrt(block_bootstrap(pieces, length, np.random.default_rng(seed)))


def _rms(errors: Sample) -> Sample:
    """Root mean square (n,) of errors (N, n); inf without any, and where one is not finite."""
    if not len(errors):
        return np.full(errors.shape[1], np.inf)
    values = np.sqrt(np.mean(np.square(errors), axis=0))
    return np.where(np.isnan(values), np.inf, values)


def _reached(series: Series, seconds: float) -> NDArray[np.bool_]:
    """Where (N,) the prediction of some model over this time ends."""
    ends = [values for name, values in series.columns.items() if name.endswith(f"_{seconds:g}s")]
    return np.any(np.isfinite(ends), axis=0) if ends else np.zeros(len(series.columns["t"]), bool)


def _columns(series: Series, names: Sequence[str]) -> Sample:
    """Columns (N, n); NaN for one that is not stored."""
    unknown = np.full(len(series.columns["t"]), np.nan)
    return np.column_stack([series.columns.get(name, unknown) for name in names])


def _period_s(series: Series) -> float:
    return float(np.median(np.diff(series.columns["t"])))
