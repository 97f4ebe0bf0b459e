"""Tracks of manoeuvres, for their sheets and figures: of a stored run, and of a file of motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.models.recording.columns_file import parse_columns, read_columns
from seatrial.models.simulation.manoeuvre_measures import Execution as Execution
from seatrial.models.simulation.manoeuvre_measures import Track as Track
from seatrial.models.simulation.manoeuvre_measures import Turn as Turn
from seatrial.models.simulation.manoeuvre_measures import ZigZag as ZigZag
from seatrial.models.simulation.manoeuvre_measures import way_from as way_from
from seatrial.models.simulation.manoeuvre_sheet import INSTANTS as INSTANTS
from seatrial.models.simulation.manoeuvre_sheet import Entry as Entry
from seatrial.models.simulation.manoeuvre_sheet import Manoeuvre as Manoeuvre
from seatrial.models.simulation.manoeuvre_sheet import Sheet as Sheet
from seatrial.models.simulation.manoeuvre_sheet import sheet as sheet
from seatrial.models.vessel.basis import Array
from seatrial.runner.database.reader import Reader
from seatrial.runner.database.records import Series

NEEDED = ("t", "x", "y", "psi", "u", "v")
MANOEUVRES = get_args(Manoeuvre)


@dataclass(frozen=True, eq=False)
class Recorded:
    """A track, and which manoeuvre it is if that is known."""

    track: Track
    manoeuvre: Manoeuvre | None


def file_track(path: Path, columns: str | None, length_m: float | None) -> Track:
    """The motion of a file; raises ConfigurationError without columns or length."""
    if columns is None or length_m is None:
        missing = "--columns" if columns is None else "--length"
        raise ConfigurationError(f"manoeuvres: {path} is a file, expected {missing}")
    return track_of_columns(read_columns(path, parse_columns(columns)), length_m)


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


def mission_of(config: Mapping[str, Any], kind: str) -> Mapping[str, Any]:
    """The mission that a series of a run shows."""
    mission = config.get("evaluation" if kind.startswith("deployment") else "excitation")
    return mission if isinstance(mission, Mapping) else {}


def manoeuvre_in(mission: Mapping[str, Any]) -> Manoeuvre | None:
    """The manoeuvre that the options of a mission name; None if it is none."""
    return next((kind for kind in MANOEUVRES if kind == mission.get("manoeuvre")), None)


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
