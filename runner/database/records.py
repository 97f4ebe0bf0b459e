"""Records of sweeps and runs in the logbook, as frozen dataclasses without SQL."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from seatrial.runner.record.vocabulary import Config

AT_ONCE = 500  # values in one condition; databases limit the variables of a statement


@dataclass(frozen=True)
class RunClaim:
    """The answer to `begin_run`.

    new: the caller is to run the trial as `run_id`; finished: the trial finished before as run
    `run_id`; busy: another process is running the trial as `run_id`.
    """

    run_id: int
    state: Literal["new", "finished", "busy"]


@dataclass(frozen=True)
class RunSummary:
    """One row of the view `run_overview`. Times are UTC, `duration_s` in seconds."""

    run_id: int
    sweep_id: int | None
    sweep: str | None
    attempt: int
    status: str  # running, finished, diverged, failed or interrupted
    superseded: bool  # another attempt at the same trial replaces it
    vessel: str
    disturbance: str
    excitation: str
    identifier: str
    controller: str
    evaluation: str
    seed: int
    started_at: datetime
    finished_at: datetime | None
    duration_s: float | None
    metrics: int
    coefficients: int
    series: int
    below_true_model: float | None
    error_type: str | None
    error: str | None
    fingerprint: str


@dataclass(frozen=True)
class RunDetail:
    """A run with its summary and all other columns of the table `run`."""

    summary: RunSummary
    traceback: str | None
    note: str | None
    config: Config
    overrides: list[str]
    git_commit: str | None
    git_dirty: bool | None
    versions: dict[str, object]
    command: str | None
    host: str
    pid: int
    heartbeat_at: datetime | None
    code: str | None = None  # digest of the code that computed the results
    drawn: list[str] | None = None  # random streams that the results depend on, if known


@dataclass(frozen=True)
class SweepStatus:
    """The progress of a sweep. Each trial counts once, by its last attempt in this sweep."""

    sweep_id: int
    name: str
    planned: int
    counts: dict[str, int]  # number of trials by status, including trials that had finished before
    reused: int  # trials that another sweep has finished or is running
    failed: list[RunSummary]  # failed, diverged and interrupted ones
    finished_at: datetime | None
    # By the choices of trials, where they are known; a search plans as it goes.
    left: Mapping[str, int] = field(default_factory=dict)  # trials to be run
    spent_s: Mapping[str, Sequence[float]] = field(default_factory=dict)  # by those that have ended


@dataclass(frozen=True)
class Answer:
    """Rows of a query, with the names of their columns; `more` rows were left out."""

    columns: tuple[str, ...]
    rows: list[tuple[object, ...]]
    more: bool = False


@dataclass(frozen=True)
class Verification:
    """The number of checked runs and series files, and the defects: (place, description)."""

    runs: int
    series: int
    problems: list[tuple[str, str]]
    leftovers: list[Path]  # files of killed programs, without a row; they do no harm


# Conversion to what a database can store: numbers without NaN, text without NUL.


def cell(value: Any) -> str | float | None:
    """Return a text or a number, also one of NumPy, as a database stores it; NaN is NULL."""
    if value is None or isinstance(value, str):
        return value
    number = value.item() if isinstance(value, np.generic) else value
    return None if number != number else +number  # of a truth value 0 or 1


def plain(value: object) -> object:
    """Convert `value` to JSON types; NaN becomes null, infinity the text "inf" or "-inf".

    NUL and lone surrogates are escaped, because PostgreSQL rejects them in text.
    """
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        text = value.replace("\x00", "\\x00")
        return text.encode("utf-8", "backslashreplace").decode("utf-8")
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else str(value)
    if isinstance(value, Mapping):
        return {plain(str(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return plain(str(value))
