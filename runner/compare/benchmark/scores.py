"""Scores of a trial's predictions: normalised errors of the free run and over given times.

The error of an output is its root mean square over the standard deviation of what was measured
(NRMSE, 1 for the mean of the measured motion, inf if it diverges); FIT = 100 (1 - NRMSE) %; the
loss of a case is the mean over the outputs. nonlinearbenchmark.org. That of a position is the root
mean square of the distance [m] to the measured one.

A prediction with a band is scored as a normal distribution, by the share of what was measured that
lies in its band of 90 %, and by the continuous ranked probability score (CRPS), in units of the
output's deviation: of a prediction without a band it is the mean absolute error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import IDENTIFIED_STD

PERSISTENCE = "persistence"  # the first measured velocity, held
MEAN_MOTION = "mean_motion"  # the mean of the measured velocity
AT_REST = "at_rest"  # the position that was measured before
REFERENCES = (MEAN_MOTION, PERSISTENCE, AT_REST)
POSITION = ("x", "y")
BLOCK_S = 30.0
BAND_LEVEL = 0.9  # also of intervals


@dataclass(frozen=True, eq=False)
class Score:
    """Errors (N, n) of a prediction over the spread of each output, by time; of a position [m].

    `starts` (N,) marks the first sample of each piece, such as a file. Of a free run, without the
    starts, it is known which outputs are in the band, and their CRPS over the spread.
    """

    errors: Sample
    starts: NDArray[np.bool_]
    block: int  # samples of a block of the bootstrap
    covered: Sample | None = None
    crps: Sample | None = None

    @cached_property
    def loss(self) -> float:
        """Mean NRMSE over the outputs; inf without samples, and for one that is not finite."""
        return float(np.mean(pooled([self])))

    def pieces(self) -> list[Sample]:
        """Errors of each piece, such as a file."""
        return np.split(self.errors, np.flatnonzero(self.starts)[1:])


NOTHING = Score(np.empty((0, 1)), np.empty(0, np.bool_), 1)  # of a lost run


def score(
    series: Series, model: str, outputs: Sequence[str], after_s: float | None = None
) -> Score:
    """Score a model, or one of REFERENCES, on the series `prediction`.

    Its free run, or its predictions `after_s` [s] after every measured state. `outputs` are degrees
    of freedom, or POSITION, whose errors are distances [m]: of one output. A model that lacks a
    prediction where some model has one scores inf.
    """
    measured, columns = _columns(series, outputs), series.columns
    end = "" if after_s is None else f"_{after_s:g}s"
    ends = [np.isfinite(v) for name, v in columns.items() if name.endswith(end)]
    reached = np.any([np.isnan(columns["t"]), *ends], axis=0)  # in a free run everywhere
    predicted = _columns(series, [f"{name}_{model}{end}" for name in outputs])
    if model in REFERENCES and (model != AT_REST or outputs == POSITION):
        predicted = _trivial(series, model, outputs, after_s, reached)
    errors, spread = (predicted - measured)[reached], np.std(measured, axis=0)
    errors = np.linalg.norm(errors, axis=1)[:, None] if outputs == POSITION else errors / spread
    starts = np.diff(np.cumsum(columns["start"])[reached], prepend=-1) != 0
    block = max(round(BLOCK_S / _period_s(series)), 1)
    if after_s is not None:
        return Score(errors, starts, block)
    free, bands = errors[~starts], [f"{name}_{IDENTIFIED_STD}" for name in outputs]
    if model != "identified" or bands[0] not in columns:
        return Score(errors, starts, block, crps=np.abs(free))
    deviations = (_columns(series, bands) / spread)[~starts]
    covered = np.abs(free) <= half_width(deviations)
    return Score(errors, starts, block, covered, crps(free, deviations))


def _trivial(
    series: Series, model: str, outputs: Sequence[str], after_s: float | None,
    reached: NDArray[np.bool_],
) -> Sample:  # fmt: skip
    """The predictions (N, n) of a trivial rival, which end where some model's do: `reached`.

    PERSISTENCE holds the velocity that was measured before, for a position in NED; MEAN_MOTION
    moves by the mean of what was measured; AT_REST stays at the position before.
    """
    measured, columns = _columns(series, outputs), series.columns
    begin = np.arange(len(measured))
    if after_s is None:
        begin = np.maximum.accumulate(np.where(columns["start"], begin, 0))
    else:
        begin = np.roll(begin, max(round(after_s / _period_s(series)), 1))
    before, moved = measured[begin], np.zeros(len(outputs))
    if outputs != POSITION:
        mean = np.broadcast_to(measured.mean(axis=0), measured.shape)
        return before if model == PERSISTENCE else mean
    if model == MEAN_MOTION:
        moved = np.mean((measured - before)[reached], axis=0)
    elif model == PERSISTENCE and after_s is not None:
        u, v, psi = (columns[name][begin] for name in ("surge", "sway", "psi"))
        north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
        moved = after_s * np.column_stack([north, east])
    return np.asarray(before + moved)


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
    """Return the NRMSE of each output (n,) over the samples of several runs.

    inf without samples, and where one is not finite.
    """
    errors = np.concatenate([score.errors for score in scores])
    if not len(errors):
        return np.full(errors.shape[1], np.inf)
    values = np.sqrt(np.mean(np.square(errors), axis=0))
    return np.where(np.isnan(values), np.inf, values)


def interval(scores: Sequence[Score]) -> Sample:
    """Return the 90 % interval (2,) of the mean of `pooled`, by a bootstrap of files and blocks."""
    pieces = [piece for score in scores for piece in score.pieces()]
    drawn = np.sqrt(block_bootstrap(pieces, scores[0].block)).mean(axis=1)
    return np.asarray(np.quantile(drawn, [0.5 - 0.5 * BAND_LEVEL, 0.5 + 0.5 * BAND_LEVEL]))


def chance(first: Sequence[Score], other: Sequence[Score]) -> float:
    """Return the p-value of equal pooled losses of two entrants, by a paired bootstrap.

    `first` and `other` are their scores of the same files: both are drawn at the same files and
    blocks. Where some are infinite, 1 if they are those of the same files for both, else 0. NaN for
    scores that do not match.
    """
    lost, lost_too = ([np.isinf(each.loss) for each in scores] for scores in (first, other))
    if any(lost) or any(lost_too):
        return float(lost == lost_too)
    pieces = [[piece for each in scores for piece in each.pieces()] for scores in (first, other)]
    if not first or [*map(len, pieces[0])] != [*map(len, pieces[1])]:
        return np.nan
    both = [np.hstack(two) for two in zip(*pieces, strict=True)]
    drawn = np.sqrt(block_bootstrap(both, first[0].block))
    half = drawn.shape[1] // 2
    gain = drawn[:, half:].mean(axis=1) - drawn[:, :half].mean(axis=1)
    better = np.mean(gain > 0.0) + 0.5 * np.mean(gain == 0.0)
    return float(min(2.0 * min(better, 1.0 - better) + 2.0 / len(drawn), 1.0))


def block_bootstrap(
    errors: Sequence[Sample], length: int, seed: np.random.Generator | int = 0,
    resamples: int = 1000,
) -> Sample:  # fmt: skip
    """Mean squares (resamples, n) of resampled errors, to give intervals of pooled scores.

    `errors` holds (N, n) for every file. Files are drawn with replacement, then blocks of `length`
    samples within each (circular, so that every sample is as likely): neighbouring errors depend on
    each other, and so do those of a file. Politis and Romano (1992).
    """
    rng = np.random.default_rng(seed)
    total, count = np.zeros((resamples, errors[0].shape[1])), np.zeros(resamples)
    files = rng.integers(0, len(errors), (resamples, len(errors)))
    for file, of_file in enumerate(errors):
        n = len(of_file)
        row = np.repeat(np.arange(resamples), np.count_nonzero(files == file, axis=1))
        whole, rest = divmod(n, min(length, n))
        starts = rng.integers(0, n, (len(row), whole + 1))
        repeated = np.resize(np.square(of_file), (n + length, *of_file.shape[1:]))
        cumulative = np.cumsum(np.concatenate([np.zeros_like(repeated[:1]), repeated]), axis=0)
        blocks, last = starts[:, :whole], starts[:, whole]
        squares = (cumulative[blocks + min(length, n)] - cumulative[blocks]).sum(axis=1)
        np.add.at(total, row, squares + (cumulative[last + rest] - cumulative[last]))
        np.add.at(count, row, n)
    return np.asarray(total / count[:, None])


def _columns(series: Series, names: Sequence[str]) -> Sample:
    """Columns (N, n); NaN for one that is not stored."""
    unknown = np.full(len(series.columns["t"]), np.nan)
    return np.column_stack([series.columns.get(name, unknown) for name in names])


def _period_s(series: Series) -> float:
    return float(np.median(np.diff(series.columns["t"])))
