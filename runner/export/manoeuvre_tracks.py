"""Tracks of manoeuvres, for their sheets and figures: of a stored run, and of a file of motion."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.models.notation import MEASURES, PLANAR, OrderedManoeuvre
from seatrial.models.notation import Manoeuvre as Manoeuvre
from seatrial.models.simulation.manoeuvre_measures import Track as Track
from seatrial.models.simulation.manoeuvre_measures import executions as executions
from seatrial.models.simulation.manoeuvre_measures import way_from as way_from
from seatrial.models.simulation.manoeuvre_sheet import COMPARED as COMPARED
from seatrial.models.simulation.manoeuvre_sheet import DIAGNOSTIC as DIAGNOSTIC
from seatrial.models.simulation.manoeuvre_sheet import Sheet as Sheet
from seatrial.models.simulation.manoeuvre_sheet import measured_sheet as measured_sheet
from seatrial.models.simulation.manoeuvre_sheet import track_of as track_of
from seatrial.runner.configuration.config import build_as
from seatrial.runner.configuration.recording_map import read_map, reader_of
from seatrial.runner.configuration.vessel_options import HELM
from seatrial.runner.database.reader import LogbookReader
from seatrial.runner.record.catalogue import MEASURE_HIGH, MEASURE_LOW, metric_of_measure
from seatrial.runner.record.vocabulary import Config

NEEDED = ("t", "x", "y", "psi", "u", "v")
MANOEUVRES = get_args(Manoeuvre)
BOUNDS = (MEASURE_LOW, MEASURE_HIGH)
PredictedMeasure = tuple[float, float, float]  # value and its 90 % interval; NaN where none is


class Recorded(NamedTuple):
    """A track, what was ordered as far as it is known, and what the identified model predicts."""

    track: Track
    ordered: OrderedManoeuvre
    predicted: Mapping[str, PredictedMeasure]  # by quantity


def file_track(
    path: Path, map_file: Path | None, helm: str | None, length_m: float | None
) -> tuple[Track, OrderedManoeuvre]:
    """The motion of a file and what was ordered, by its map.

    Raises ConfigurationError without a map or a length, or for a map without the helm.
    """
    if map_file is None or length_m is None:
        missing = "--map" if map_file is None else "--length"
        raise ConfigurationError(f"manoeuvres: {path} is a file, expected {missing}")
    reader = reader_of(path, read_map(map_file))
    name = helm or HELM
    if name not in reader.columns.inputs:
        known = ", ".join(reader.columns.inputs) or "none"
        raise ConfigurationError(
            f"manoeuvres: {map_file}: got inputs {known}, expected the helm {name}, or --helm"
        )
    return track_of(reader.read(PLANAR), name, length_m), reader.manoeuvre


def stored(
    reader: LogbookReader,
    run: int,
    kind: str,
    helm: str | None = None,
    length_m: float | None = None,
) -> Recorded:
    """The motion of a run's series; `helm` and the length are those of the run by default.

    Raises ConfigurationError if the run has no such series, or the series no helm.
    """
    config = reader.run(run).config
    if kind not in {file.kind for file in reader.series_files(run)}:
        raise ConfigurationError(f"run {run} has no series {kind}")
    mission = config.get("evaluation" if kind.startswith("deployment") else "excitation")
    mission = mission if isinstance(mission, Mapping) else {}
    name = str(helm or mission.get("helm") or HELM)
    length = length_m or length_of(config)
    if length is None:
        raise ConfigurationError(
            f"run {run}: the length of its vessel is not stored, give --length"
        )
    columns = reader.series(run, kind).columns
    if missing := [column for column in (*NEEDED, name) if column not in columns]:
        raise ConfigurationError(
            f"run {run}: its series {kind} has no {missing[0]}, expected a steered vessel in the "
            "plane"
        )
    t, north, east, psi, u, v = (columns[column] for column in NEEDED)
    track = Track(t, north, east, np.unwrap(psi), columns[name], np.hypot(u, v), length)
    predicted = predicted_by(reader, run) if mission is config.get("excitation") else {}
    return Recorded(track, ordered_in(mission), predicted)


def predicted_by(reader: LogbookReader, run: int) -> dict[str, PredictedMeasure]:
    """What the identified model of a run predicts of its manoeuvre, by quantity."""
    values = {row.name: row.value for row in reader.metrics(run) if row.model == "identified"}
    bounds = {(row.name, row.label): row.value for row in reader.diagnostics(run)}
    found: dict[str, PredictedMeasure] = {}
    for quantity in MEASURES:
        if (name := metric_of_measure(quantity)) in values:
            numbers = values[name], *(bounds.get((bound, quantity)) for bound in BOUNDS)
            value, low, high = (np.nan if n is None else n for n in numbers)
            found[quantity] = value, low, high
    return found


def ordered_in(mission: Config) -> OrderedManoeuvre:
    """The manoeuvre that the options of a mission name, or those of a recording state."""
    known = mission.get("manoeuvre")
    if isinstance(known, Mapping):
        return build_as(OrderedManoeuvre, known, "excitation.manoeuvre")
    return OrderedManoeuvre(next((kind for kind in MANOEUVRES if kind == known), None))


def length_of(config: Config) -> float | None:
    """Length of the vessel of a stored configuration [m]; None if it states none."""
    vessel = config.get("vessel")
    if not isinstance(vessel, Mapping):
        raise LogbookError("vessel: the stored configuration has none")
    prime = vessel.get("prime") or {}
    value = vessel.get("length_m") or prime.get("length_m")
    return None if value is None else float(value)
