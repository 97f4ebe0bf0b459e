"""What the models of a trial predict of its manoeuvre, and of those in the files tested on.

Every model carries out the manoeuvre of the excitation in calm water. The intervals are of first
order: quantiles over models that are drawn from the joint distribution of what was identified, near
it. They hold as far as its standard errors do (diagnostic `interval_of_estimate`).

The diagnostics `recorded_manoeuvre_QUANTITY`, such as `recorded_manoeuvre_tactical_diameter`, have
the file as i and as j one of `COMPARED`. There the models have the recorded helm, also in a
zig-zag.
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import get_args

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged, IdentificationError, RecordingError
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.validation import prediction
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_measures import Track
from seatrial.models.simulation.manoeuvre_sheet import (
    COMPARED,
    DEVIATION_SHARE,
    DIAGNOSTIC,
    Manoeuvre,
    intervals,
    sheet,
    track_of,
)
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.disturbance import Disturbance
from seatrial.runner.closed_loop import Streams, prepare
from seatrial.runner.config import Trial
from seatrial.runner.record.catalogue import MEASURE_HIGH, MEASURE_LOW, MEASURES, metric_of_measure
from seatrial.runner.record.rows import Metric, Results, metric

log = logging.getLogger(__name__)
HELM = "delta"
DRAWS = 100  # models of an interval
MIN_DRAWS = 20  # of them that carry the manoeuvre out
UNABLE = (ConfigurationError, Diverged, IdentificationError, RecordingError)


def manoeuvre_results(
    trial: Trial, models: Mapping[str, Vessel], identified: Identified
) -> Results:
    """Return the measures of each model, and the intervals of the identified one.

    Empty unless the excitation is a standard manoeuvre of a steered vessel in the plane. A model
    that cannot carry it out has no measures.
    """
    mission, length = trial.excitation, length_of(trial)
    kind = next((k for k in KINDS if k == getattr(mission, "manoeuvre", None)), None)
    if not isinstance(mission, SteeredMission) or length is None or kind is None:
        return Results()
    if not {*PLANAR} <= {*trial.vessel.dofs}:
        return Results()
    calm = replace(trial, disturbance=Disturbance())
    metrics: list[Metric] = []
    for name, model in models.items():
        try:
            result = sheet(sailed(calm, mission, model, length), kind)
        except UNABLE:
            continue
        metrics += [
            metric(metric_of_measure(entry.quantity), "validation", name, "all", entry.value)
            for entry in result.entries
            if np.isfinite(entry.value)
        ]
    found = _intervals(calm, mission, identified, kind, length)
    return Results(metrics, diagnostics=found)


KINDS: tuple[Manoeuvre, ...] = get_args(Manoeuvre)


def length_of(trial: Trial) -> float | None:
    """Return the length of the vessel [m] if it is configured."""
    vessel = trial.vessel
    return vessel.length_m or (None if vessel.prime is None else vessel.prime.length_m)


def sailed(calm: Trial, mission: SteeredMission, model: Vessel, length_m: float) -> Track:
    """Return the track of a model that carries out the mission."""
    prepared = prepare(calm, Streams(calm.seed), calm.vessel.nominal(), mission, true=model)
    voyage = prepared.sail().voyage
    return track_of(recording_of(voyage, voyage.weather), mission.helm, length_m)


def _intervals(
    calm: Trial, mission: SteeredMission, identified: Identified, kind: Manoeuvre, length_m: float
) -> list[Diagnostic]:
    """Return the bounds of each quantity; none if too few of the drawn models can be simulated."""
    sail = partial(_track_if_able, calm, mission, length_m)
    own = sail(identified.model)
    tracks = [
        track for track in map(sail, identified.draws(DRAWS, DEVIATION_SHARE)) if track is not None
    ]
    if own is None or len(tracks) < MIN_DRAWS:
        return []
    bounds = intervals(own, tracks, kind)
    return [
        Diagnostic(name, "all", value, MEASURES[quantity], label=quantity)
        for quantity, both in bounds.items()
        for name, value in zip((MEASURE_LOW, MEASURE_HIGH), both, strict=True)
        if np.isfinite(value)
    ]


def _track_if_able(
    calm: Trial, mission: SteeredMission, length_m: float, model: Vessel
) -> Track | None:
    """Return the track of a model; None if it cannot be simulated."""
    try:
        return sailed(calm, mission, model, length_m)
    except UNABLE:
        return None


def manoeuvres(
    problem: Problem, identified: Identified, length_m: float | None
) -> list[Diagnostic]:
    """Measure the manoeuvre of each file that is tested on; none for a vessel without a rudder.

    A file that holds no manoeuvre has no diagnostics.
    """
    known = {"surge", "sway", "yaw"} <= set(problem.nominal.dofs)
    if length_m is None or HELM not in problem.nominal.inputs or not known:
        return []
    diagnostics: list[Diagnostic] = []
    parts = problem.validation.by_file() or {_name(problem.validation): problem.validation}
    for i, (name, part) in enumerate(parts.items()):
        try:
            diagnostics.extend(_of_file(i, name, part, problem, identified, length_m))
        except (RecordingError, ConfigurationError) as error:
            log.debug("%s: no manoeuvre: %s", name, error)
    return diagnostics


def _name(recording: Recording) -> str:
    """The name of the only file of a recording; empty if it is not known."""
    return "" if recording.file is None else recording.file_names[int(recording.file[0])]


def _of_file(
    i: int, name: str, part: Recording, problem: Problem, identified: Identified, length_m: float
) -> Iterator[Diagnostic]:
    sail = partial(_predicted, part=part, problem=problem, length_m=length_m)
    measured = sheet(track_of(part, HELM, length_m))
    models = (problem.nominal, identified.model)
    tracks = [sail(model) for model in models]
    kind, turn_deg = measured.manoeuvre, measured.turn_deg
    own = [sheet(track, kind, turn_deg=turn_deg).values if track else {} for track in tracks]
    drawn = [
        track for track in map(sail, identified.draws(DRAWS, DEVIATION_SHARE)) if track is not None
    ]
    bounds = intervals(tracks[1], drawn, kind, turn_deg=turn_deg) if tracks[1] else {}
    for entry in measured.entries:
        values = [entry.value, *(each.get(entry.quantity) for each in own)]
        values += bounds.get(entry.quantity, ())
        quantity = entry.quantity.replace(", ", "_").replace(" ", "_")
        for j, value in enumerate(values):
            label = f"{name}, {COMPARED[j]}"
            yield Diagnostic(f"{DIAGNOSTIC}{quantity}", "all", value, entry.unit, i, j, label)


def _predicted(model: Vessel, part: Recording, problem: Problem, length_m: float) -> Track | None:
    """The track of a free run of a model under the inputs of a file; None if it diverges."""
    try:
        motion = prediction(model, part, problem.thruster).motion()
    except IdentificationError:
        return None
    if not np.all(np.isfinite(motion)):
        return None
    n = len(part.dofs)
    return track_of(replace(part, eta=motion[:, :n], nu=motion[:, n:]), HELM, length_m)
