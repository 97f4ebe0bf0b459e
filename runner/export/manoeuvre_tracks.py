"""Tracks of manoeuvres, for their sheets and figures: of a stored run, and of a file of motion."""

from collections.abc import Mapping
from pathlib import Path
from typing import get_args

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR, Manoeuvre, OrderedManoeuvre
from seatrial.models.simulation import manoeuvre_sheet as manoeuvre_sheet
from seatrial.models.simulation.manoeuvre_sheet import Track, track_of
from seatrial.runner.configuration.config import build_as
from seatrial.runner.configuration.recording_map import read_map, reader_of
from seatrial.runner.configuration.vessel_options import HELM
from seatrial.runner.database.reader import LogbookReader
from seatrial.runner.record.vocabulary import Config

RECORDING = "recording"
NEEDED = ("t", "x", "y", "psi", "u", "v")
MANOEUVRES = get_args(Manoeuvre)
Recorded = tuple[Track, OrderedManoeuvre]  # a track, and what was ordered as far as it is known


def file_track(
    path: Path, map_file: Path | None, helm: str | None, length_m: float | None
) -> Recorded:
    """The motion of a file, by its map.

    Raises ConfigurationError without a map, a length or the helm.
    """
    if map_file is None or length_m is None:
        missing = "--map" if map_file is None else "--length"
        got = f"the file {path}" if path.exists() else f"{path}, which is neither run nor file"
        raise ConfigurationError(f"manoeuvres: got {got}, expected {missing}")
    reader = reader_of(path, read_map(map_file))
    if (name := helm or HELM) not in reader.columns.inputs:
        known = ", ".join(reader.columns.inputs) or "none"
        raise ConfigurationError(
            f"manoeuvres: {map_file}: got inputs {known}, expected the helm {name}, or --helm"
        )
    return track_of(reader.read(PLANAR), name, length_m), reader.manoeuvre


def stored(
    reader: LogbookReader, run: int, helm: str | None = None, length_m: float | None = None
) -> Recorded:
    """The recorded motion of a run; `helm` and the length are those of the run by default.

    Raises ConfigurationError if the recording has no helm or no pose in the plane.
    """
    config = reader.run(run).config
    mission, length = config.get("excitation") or {}, length_m or length_of(config)
    if length is None:
        raise ConfigurationError(f"run {run}: its vessel has no length, expected --length")
    columns = reader.series(run, RECORDING).columns
    needed = (*NEEDED, str(helm or mission.get("helm") or HELM))
    if missing := [column for column in needed if column not in columns]:
        raise ConfigurationError(
            f"run {run}: its recording has no {missing[0]}, expected a steered vessel in the plane"
        )
    t, north, east, psi, u, v, rudder = (columns[column] for column in needed)
    track = Track(t, north, east, np.unwrap(psi), rudder, np.hypot(u, v), length)
    return track, ordered_in(mission)


def ordered_in(mission: Config) -> OrderedManoeuvre:
    """The manoeuvre that the options of a mission name, or those of a recording state."""
    known = mission.get("manoeuvre")
    if isinstance(known, Mapping):
        return build_as(OrderedManoeuvre, known, "excitation.manoeuvre")
    return OrderedManoeuvre(known if known in MANOEUVRES else None)


def length_of(config: Config) -> float | None:
    """Length of the vessel of a stored configuration [m]; None if it states none."""
    vessel = config.get("vessel") or {}
    length_m = vessel.get("length_m") or (vessel.get("prime") or {}).get("length_m")
    return None if length_m is None else float(length_m)
