"""Tasks of the benchmark, their cells, and scores of predictions.

A task is a file of `conf/benchmark`: where its data come from, its trials, and what is scored. It
ships no data: it names their source, how to get them, and the SHA-256 of each file. A file is
looked for in SEATRIAL_DATA, then in the user's own folder.

The error of an output is its root mean square over the standard deviation of what was measured
(NRMSE, 1 for the mean of the measured motion, inf if it diverges); FIT = 100 (1 - NRMSE) %; the
loss of a case is the mean over the outputs. nonlinearbenchmark.org. That of a position is the root
mean square of the distance [m] to the measured one.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from statistics import NormalDist
from typing import Literal, NamedTuple, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.configuration import options, search_path
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import IDENTIFIED_STD

GROUP = "benchmark"
MAPS = search_path.CONF / GROUP / "maps"  # of columns
PERSISTENCE = "persistence"  # the first measured velocity, held
MEAN_MOTION = "mean_motion"  # the mean of the measured velocity
AT_REST = "at_rest"  # the position that was measured before
REFERENCES = (MEAN_MOTION, PERSISTENCE, AT_REST)
POSITION = ("x", "y")
BLOCK_S = 30.0
BAND_LEVEL = 0.9  # also of intervals


@dataclass(frozen=True)
class Case:
    """What is trained and tested on: files relative to the folder of data, or further options."""

    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    seeds: int | None = None  # null: as many as the task has; 1 where nothing is random


@dataclass(frozen=True)
class Task:
    """A task; its trials have the options `trial` and those of a case and an entrant.

    `outputs` are the degrees of freedom whose velocities are scored, `horizons_s` [s] the times
    over which predictions are scored beside the free run. The loss is that of `score`: of the free
    run; of the velocities (`restarts`) or of the position at the last horizon after every measured
    state, where free runs are chaotic. `entrants` are those of this task alone.
    """

    name: str
    title: str
    trial: tuple[str, ...]
    cases: dict[str, Case]
    outputs: tuple[Literal["surge", "sway", "heave", "roll", "pitch", "yaw"], ...]
    # Of the data: name, url, licence, and how to get them; none of a simulated task.
    source: dict[str, str] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)  # SHA-256 by path
    map: str | None = None  # of the columns, a file of the folder `maps` beside the task
    test_map: str | None = None  # of the files that are tested on, where it is another one
    seeds: int = 1
    horizons_s: tuple[float, ...] = (1.0, 10.0, 60.0)
    score: Literal["free_run", "restarts", "position"] = "free_run"
    entrants: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, case in self.cases.items():
            for path in (*case.train, *case.test):
                if not self.parts(path):
                    raise ConfigurationError(f"cases.{name}: {path} has no SHA-256 under `files`")

    def parts(self, *paths: str) -> list[str]:
        """The files of recordings: themselves, or those that are listed of a folder."""
        return [file for path in paths for file in self.files if Path(file).is_relative_to(path)]


class Located(NamedTuple):
    """A file of a task: in which folder of data it is, or is expected."""

    name: str
    folder: Path
    state: str  # found, damaged or missing


class BenchmarkTrial(NamedTuple):
    """One trial of the benchmark; `options` are all that its command gives."""

    task: str
    case: str
    seed: int
    entrant: str
    options: tuple[str, ...]
    lacking: tuple[Located, ...]  # of its files, those that are missing or damaged


def task_of(name: str) -> Task:
    """Read a task; raises ConfigurationError for an unknown one or a file that is none."""
    names = search_path.options(GROUP)
    if name not in names:
        expected = f"{meant(name, names)}expected one of {', '.join(names)}"
        raise ConfigurationError(f"task: got {name!r}, {expected}")
    folders = (search_path.CONF, *search_path.user_folders())
    path = next(filter(Path.is_file, (folder / GROUP / f"{name}.yaml" for folder in folders)))
    try:
        node = {**yaml.safe_load(path.read_text(encoding="utf-8")), "name": name}
        return cast(Task, options.part(Task, node))
    except (yaml.YAMLError, ValueError, TypeError) as error:  # TypeError: not a mapping
        told = " ".join(str(error).split()).lstrip(".: ")
        raise ConfigurationError(f"{path}: {told}") from error


def located(task: Task) -> list[Located]:
    """Where the files of a task are, each verified by its SHA-256."""
    texts = (os.environ.get("SEATRIAL_DATA"), "~/.local/share/seatrial")
    folders, files = [Path(text).expanduser() for text in texts if text], []
    for name, digest in task.files.items():
        holding = next((folder for folder in folders if (folder / name).is_file()), None)
        data = b"" if holding is None else (holding / name).read_bytes()
        is_same = hashlib.sha256(data).hexdigest() == digest
        state = "missing" if holding is None else "found" if is_same else "damaged"
        files.append(Located(name, holding or folders[0], state))
    return files


def cells(task: Task, entrants: Sequence[str] = ()) -> Iterator[BenchmarkTrial]:
    """Yield the cells of a task, entrant by entrant.

    An entrant that the task does not name is an option of the group `identifier`, such as one's
    own; by default they are all of the task.
    """
    files, maps = {file.name: file for file in located(task)}, ("map", "test_map")
    columns = [f"excitation.{key}={MAPS / file}" for key in maps if (file := getattr(task, key))]
    names = dict.fromkeys(entrants or task.entrants)
    for entrant, (label, case) in product(names, task.cases.items()):
        needed = [files[part] for part in task.parts(*case.train, *case.test)]
        lacking = tuple(file for file in needed if file.state != "found")
        texts = [*task.trial, *columns, *case.options]
        for key, paths in (("train", case.train), ("test", case.test)):
            of_case = [str(files[task.parts(path)[0]].folder / path) for path in paths]
            texts += [f"excitation.{key}={json.dumps(of_case)}"] if of_case else []
        texts += task.entrants.get(entrant, (f"identifier={entrant}",))
        texts.append(f"horizons_s={list(task.horizons_s)}")
        for seed in range(case.seeds or task.seeds):
            # The last option of a key counts: an entrant may replace one of the task.
            last = {text.partition("=")[0]: text for text in (*texts, f"seed={seed}")}
            yield BenchmarkTrial(task.name, label, seed, entrant, (*last.values(),), lacking)


@dataclass(frozen=True, eq=False)
class Score:
    """Errors (N, n) of a prediction over the spread of each output, by time; of a position [m].

    `starts` (N,) marks the first sample of each piece, such as a file. Of a free run with a band it
    is known which outputs, without the starts, are `covered`; without one the continuous ranked
    probability score (CRPS) is the absolute error.
    """

    errors: Sample
    starts: NDArray[np.bool_]
    block: int  # samples of a block of the bootstrap
    crps: Sample | None = None
    covered: Sample | None = None

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
    bands, deviations = [f"{name}_{IDENTIFIED_STD}" for name in outputs], np.zeros_like(errors)
    banded = model == "identified" and after_s is None and bands[0] in columns
    if banded:
        deviations = _columns(series, bands) / spread
    inside = np.abs(errors) <= half_width(deviations)
    scored = crps(errors, deviations)[~starts]
    return Score(errors, starts, block, scored, inside[~starts] if banded else None)


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
