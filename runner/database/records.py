"""What goes into the logbook and what comes out of it, as plain frozen objects.

Nothing here knows SQL. Numbers are SI, angles radians unless `unit` says otherwise; a value that
is not a number (NaN) is stored as NULL.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.models.findings import Finding
from seatrial.runner.vocabulary import Stage


@dataclass(frozen=True)
class Metric:
    """One figure of merit of a run."""

    stage: Stage
    model: str  # nominal, identified or plant
    dof: str  # surge, sway, heave, roll, pitch, yaw, position, heading or all
    name: str
    value: float | None
    unit: str


@dataclass(frozen=True)
class Coefficient:
    """One entry of a model: a hydrodynamic derivative, or an element of a matrix.

    `true_value` is the plant's, where the plant is known.
    """

    model: str  # nominal, residual, identified (= nominal + residual) or plant
    dof: str
    term: str
    value: float | None
    std_error: float | None
    true_value: float | None
    unit: str


@dataclass(frozen=True)
class Series:
    """Columns of equal length, each of shape (n,), with the unit of each; stored as one file."""

    kind: str  # recording, residual, deployment_nominal, deployment_identified, ...
    columns: Mapping[str, NDArray[Any]]
    units: Mapping[str, str]

    def __post_init__(self) -> None:
        shapes = {name: column.shape for name, column in self.columns.items()}
        if len({*shapes.values()}) > 1 or any(len(shape) != 1 for shape in shapes.values()):
            raise ValueError(
                f"series {self.kind}: expected 1-d columns of one length, got {shapes}"
            )
        if self.columns.keys() != self.units.keys():
            odd = sorted(self.columns.keys() ^ self.units.keys())
            raise ValueError(f"series {self.kind}: no column or no unit for {', '.join(odd)}")


@dataclass(frozen=True)
class Results:
    """All that a run stores beside its own row."""

    metrics: Sequence[Metric] = ()
    coefficients: Sequence[Coefficient] = ()
    diagnostics: Sequence[Finding] = ()  # rows of the table `diagnostic`
    series: Sequence[Series] = ()
    note: str | None = None


@dataclass(frozen=True)
class RunStart:
    """What is known of a run before it does any work."""

    fingerprint: str  # SHA-256 in hexadecimal, 64 characters
    vessel: str
    disturbance: str
    excitation: str
    identifier: str
    controller: str
    evaluation: str
    seed: int
    config: Mapping[str, Any]
    overrides: Sequence[str] = ()
    git_commit: str | None = None
    git_dirty: bool | None = None
    versions: Mapping[str, Any] = field(default_factory=dict)
    command: str = ""


@dataclass(frozen=True)
class Begun:
    """The answer to `begin_run`.

    new: the run is the caller's, under `run_id`; finished: run `run_id` has done it already;
    busy: run `run_id`, of another process, is doing it now.
    """

    run_id: int
    state: Literal["new", "finished", "busy"]
    lost: int = 0  # earlier attempts that were given up for it


@dataclass(frozen=True)
class RunSummary:
    """One row of the view `run_overview`. Times are UTC, `duration_s` in seconds."""

    run_id: int
    sweep_id: int | None
    sweep: str | None
    attempt: int
    status: str  # running, finished, diverged, failed or interrupted
    superseded: bool  # another attempt at the same trial counts instead
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
    """Everything in one row of `run`, beside its summary."""

    summary: RunSummary
    traceback: str | None
    note: str | None
    config: dict[str, Any]
    overrides: list[str]
    git_commit: str | None
    git_dirty: bool | None
    versions: dict[str, Any]
    command: str | None
    host: str
    pid: int
    heartbeat_at: datetime | None


@dataclass(frozen=True)
class SeriesFile:
    """Where a series is, and what must be true of the file."""

    kind: str
    path: str  # relative to the results folder
    format: str
    n_rows: int
    sha256: str
    columns: dict[str, str]  # name: unit


@dataclass(frozen=True)
class SweepStatus:
    """How far a sweep is. Each trial counts once, by its last attempt in this sweep."""

    sweep_id: int
    name: str
    planned: int
    counts: dict[str, int]  # status: number of trials, those found finished before included
    reused: int  # trials that another sweep had done already, or is doing
    failed: list[RunSummary]  # failed, diverged and interrupted ones
    finished_at: datetime | None


@dataclass(frozen=True)
class Answer:
    """Rows of a query, with the names of their columns."""

    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


@dataclass(frozen=True)
class SweepSummary:
    """One row of `sweep`. Times are UTC."""

    id: int
    name: str
    command: str
    overrides: list[str]
    planned: int
    started_at: datetime
    finished_at: datetime | None
    host: str
    pid: int


@dataclass(frozen=True)
class Problem:
    """Something in a logbook that is not as it should be."""

    where: str
    what: str


@dataclass(frozen=True)
class Verification:
    """How many runs and series files were looked at, and what was found wrong."""

    runs: int
    series: int
    problems: list[Problem]
    leftovers: list[Path]  # files that no row points to, of programs that were killed: no harm


@dataclass(frozen=True)
class Pruned:
    """How many runs and files were deleted, and the files that could not be."""

    runs: int
    files: int
    left: list[str]


# What a database can hold: numbers without NaN, text without NUL, JSON without either.


def number(value: Any) -> float | None:
    """`value` as a float; NaN and None as None (NULL)."""
    if value is None:
        return None
    as_float = float(value)
    return None if math.isnan(as_float) else as_float


def integer(value: Any) -> int | None:
    """`value` as an int of Python's own; None as None."""
    return None if value is None else int(value)


def text(value: str) -> str:
    """`value` without what PostgreSQL refuses in text: NUL and halves of surrogate pairs."""
    return value.replace("\x00", "\\x00").encode("utf-8", "backslashreplace").decode("utf-8")


def plain(value: Any) -> Any:
    """`value` as what JSON knows; NaN becomes null, an infinite number the text "inf" or "-inf"."""
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return text(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else str(value)
    if isinstance(value, Mapping):
        return {text(str(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return text(str(value))
