"""The sheet of a standard manoeuvre: of a stored run, or of a file of recorded motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.models.recording.columns_file import parse_columns, read_columns
from seatrial.models.simulation.manoeuvre_measures import Execution, Track
from seatrial.models.simulation.manoeuvre_sheet import INSTANTS, Entry, Manoeuvre, Sheet, sheet
from seatrial.models.vessel.basis import Array
from seatrial.runner.compare.grid import Grid, Scalar, grid_of, number_text
from seatrial.runner.compare.results import FINISHED, Results, Run, open_results
from seatrial.runner.database.reader import Reader
from seatrial.runner.database.records import Series

RECORDING = "recording"
MOST = 6  # manoeuvres in a report
NEEDED = ("t", "x", "y", "psi", "u", "v")


@dataclass(frozen=True)
class SheetRequest:
    """What `manoeuvres` was asked for."""

    subject: str  # number of a run, or path of a file
    execution: Execution
    manoeuvre: Manoeuvre | None
    helm: str | None
    length_m: float | None
    scale: float
    columns: str | None
    series: str


@dataclass(frozen=True, eq=False)
class Recorded:
    """A track, and which manoeuvre it is if that is known."""

    track: Track
    manoeuvre: Manoeuvre | None


def sheet_grid(request: SheetRequest, database: str, results_dir: Path | None) -> Grid:
    """The sheet of a run or a file as a table."""
    if request.subject.isdigit() and not Path(request.subject).exists():
        with open_results(database, results_dir) as results:
            recorded = stored(
                results.reader, int(request.subject), request.series, request.helm, request.length_m
            )
        title = f"Run {request.subject}"
    else:
        recorded, title = Recorded(file_track(request), None), request.subject
    manoeuvre = request.manoeuvre or recorded.manoeuvre
    return grid_of_sheet(sheet(recorded.track, manoeuvre, request.execution, request.scale), title)


def file_track(request: SheetRequest) -> Track:
    """The motion of a file; raises ConfigurationError without columns or length."""
    if request.columns is None or request.length_m is None:
        missing = "--columns" if request.columns is None else "--length"
        raise ConfigurationError(f"manoeuvres: {request.subject} is a file, expected {missing}")
    return track_of_columns(
        read_columns(Path(request.subject), parse_columns(request.columns)), request.length_m
    )


def stored(
    reader: Reader, run: int, kind: str, helm: str | None = None, length_m: float | None = None
) -> Recorded:
    """The motion of a run's series; `helm` and the length are those of the run by default.

    Raises ConfigurationError if the run has no such series, or the series no helm.
    """
    config = reader.run(run).config
    if kind not in {file.kind for file in reader.series_files(run)}:
        raise ConfigurationError(f"run {run} has no series {kind}")
    mission = mission_of(config, kind)
    name = helm or mission.get("helm") or "delta"
    length = length_m or _length(config)
    if length is None:
        raise ConfigurationError(
            f"run {run}: the length of its vessel is not stored, give --length"
        )
    track = track_of_series(reader.series(run, kind), str(name), length, f"run {run}")
    return Recorded(track, manoeuvre_in(mission))


def newest_manoeuvres(
    results: Results, runs: Sequence[Run], kinds: Sequence[str] = get_args(Manoeuvre)
) -> list[tuple[Run, Recorded]]:
    """The newest finished run of each vessel and excitation that is one of the manoeuvres."""
    finished = [run for run in runs if run.status == FINISHED]
    newest = {(run.levels["vessel"], run.levels["excitation"]): run for run in finished}
    chosen = sorted(newest.values(), key=lambda run: -run.id)
    configs = results.configs_of([run.id for run in chosen])
    key = "excitation.manoeuvre"
    found = [run for run in chosen if configs.get(run.id, {}).get(key) in kinds][:MOST]
    return [(run, stored(results.reader, run.id, RECORDING)) for run in found]


def mission_of(config: Mapping[str, Any], kind: str) -> Mapping[str, Any]:
    """The mission that a series of a run shows."""
    mission = config.get("evaluation" if kind.startswith("deployment") else "excitation")
    return mission if isinstance(mission, Mapping) else {}


def manoeuvre_in(mission: Mapping[str, Any]) -> Manoeuvre | None:
    """The manoeuvre that the options of a mission name; None if it is none."""
    return next((kind for kind in get_args(Manoeuvre) if kind == mission.get("manoeuvre")), None)


def track_of_series(series: Series, helm: str, length_m: float, name: str) -> Track:
    """The motion of a series with its helm."""
    missing = [column for column in (*NEEDED, helm) if column not in series.columns]
    if missing:
        raise ConfigurationError(
            f"{name}: its series {series.kind} has no {missing[0]}, expected a steered vessel in "
            "the plane"
        )
    columns = {column: series.columns[column] for column in NEEDED}
    return track_of_columns({**columns, "helm": series.columns[helm]}, length_m)


def track_of_columns(columns: Mapping[str, Array], length_m: float) -> Track:
    """The motion of columns by quantity; without velocities the speed follows from the path."""
    t, north, east = (np.asarray(columns[name], dtype=np.float64) for name in ("t", "x", "y"))
    if "u" in columns and "v" in columns:
        speed = np.hypot(columns["u"], columns["v"])
    else:
        speed = np.hypot(np.gradient(north, t), np.gradient(east, t))
    psi = np.unwrap(columns["psi"])
    return Track(t, north, east, psi, columns["helm"], speed, length_m)


def _length(config: Mapping[str, Any]) -> float | None:
    """Length of the vessel of a run [m]."""
    vessel = config.get("vessel")
    if not isinstance(vessel, Mapping):
        raise LogbookError("vessel: the stored configuration has none")
    prime = vessel.get("prime") or {}
    value = vessel.get("length_m") or prime.get("length_m")
    return None if value is None else float(value)


def grid_of_sheet(result: Sheet, title: str) -> Grid:
    """The sheet as a table with its definitions below."""
    rows = [_row(entry, result.length_m) for entry in result.entries]
    headers = ("quantity", "value", "unit", "metres", "limit", "MSC.137(76)")
    return grid_of(
        f"{title}: {result.manoeuvre.replace('_', ' ')}", headers, rows, notes=notes_of(result)
    )


def _row(entry: Entry, length_m: float) -> list[Scalar]:
    verdict = {True: "pass", False: "fail", None: None}[entry.passed]
    metres = entry.value * length_m if entry.unit == "L" else None
    return [entry.quantity, entry.value, entry.unit, metres, entry.limit, verdict]


def notes_of(result: Sheet) -> list[str]:
    """What the quantities are measured from."""
    instant = INSTANTS[result.execution]
    notes = [] if "spiral" in result.manoeuvre else [f"from {instant} ({result.execution})"]
    length, speed = number_text(result.length_m, 5), number_text(result.speed_m_s, 4)
    ratio = number_text(result.length_over_speed_s, 3)
    return [*notes, f"L = {length} m, approach at {speed} m/s, L/V at full scale {ratio} s"]
