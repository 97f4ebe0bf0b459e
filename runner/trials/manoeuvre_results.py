"""What the models of a trial predict of its manoeuvre, and of those in the files tested on.

Every model carries out the manoeuvre of the excitation in calm water. The intervals are of first
order: quantiles over runs that are drawn from the joint distribution of what was identified and of
its model error, near it. Without a model error (`no_model_error`) they hold what the data leave
open of the parameters alone, as far as its standard errors do (`interval_of_estimate`).

The diagnostics `recorded_manoeuvre_QUANTITY`, such as `recorded_manoeuvre_tactical_diameter`, have
the file as i and as j one of `COMPARED`. There the models have the recorded helm, also in a
zig-zag.
"""

import logging
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import get_args

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged, IdentificationError, RecordingError
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.calibration import (
    drawn_runs,
    nearby_runs,
    squared_accelerations,
)
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.validation import Prediction, prediction
from seatrial.models.notation import MEASURES, PLANAR, Manoeuvre, OrderedManoeuvre
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_measures import Measures, Track
from seatrial.models.simulation.manoeuvre_sheet import (
    COMPARED,
    DEVIATION_SHARE,
    DIAGNOSTIC,
    intervals,
    measured_sheet,
    sheet,
    track_of,
)
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.disturbance import Disturbance
from seatrial.runner.configuration.config import Trial
from seatrial.runner.configuration.vessel_options import HELM
from seatrial.runner.record.catalogue import MEASURE_HIGH, MEASURE_LOW, metric_of_measure
from seatrial.runner.record.rows import Metric, Results, metric
from seatrial.runner.trials.closed_loop import Streams, prepare

log = logging.getLogger(__name__)
INTERVAL_DRAWS = 100  # models of an interval
MIN_DRAWS = 20  # of them that carry the manoeuvre out
UNABLE = (ConfigurationError, Diverged, IdentificationError, RecordingError)
KINDS: tuple[Manoeuvre, ...] = get_args(Manoeuvre)


def manoeuvre_results(
    trial: Trial, models: Mapping[str, Vessel], identified: Identified
) -> Results:
    """Return the measures of each model, and the intervals of the identified one.

    Empty unless the excitation is a standard manoeuvre of a steered vessel in the plane. A model
    that cannot carry it out has no measures, and too few draws that can give no intervals.
    """
    mission, length = trial.excitation, length_of(trial)
    kind = next((k for k in KINDS if k == getattr(mission, "manoeuvre", None)), None)
    if not isinstance(mission, SteeredMission) or length is None or kind is None:
        return Results()
    if not {*PLANAR} <= {*trial.vessel.dofs}:
        return Results()
    calm, ordered = replace(trial, disturbance=Disturbance()), OrderedManoeuvre(kind)
    metrics, diagnostics = list[Metric](), list[Diagnostic]()
    for name, model in models.items():
        try:
            run = sailed(calm, mission, model)
            own = sheet(track_of(run, mission.helm, length), ordered).values
        except UNABLE:
            continue
        metrics.extend(
            metric(metric_of_measure(quantity), "validation", name, "all", value)
            for quantity, value in own.items()
            if np.isfinite(value)
        )
        if name == "identified":
            tracks = _drawn_tracks(calm, mission, identified, run, length)
            bounds = intervals(own, tracks, ordered) if len(tracks) >= MIN_DRAWS else {}
            diagnostics.extend(
                Diagnostic(bound, "all", value, MEASURES[quantity], label=quantity)
                for quantity, both in bounds.items()
                for bound, value in zip((MEASURE_LOW, MEASURE_HIGH), both, strict=True)
                if np.isfinite(value)
            )
    return Results(metrics, diagnostics=diagnostics)


def length_of(trial: Trial) -> float | None:
    """Return the length of the vessel [m] if it is configured."""
    vessel = trial.vessel
    return vessel.length_m or (None if vessel.prime is None else vessel.prime.length_m)


def sailed(
    calm: Trial, mission: Mission, model: Vessel, accelerations: Array | None = None
) -> Recording:
    """Return the recording of a model that carries out the mission, under accelerations (N, n)."""
    prepared = prepare(calm, Streams(calm.seed), calm.vessel.nominal(), mission, true=model)
    if accelerations is not None:
        weather = prepared.weather._replace(process=accelerations)
        prepared = replace(prepared, weather=weather)
    voyage = prepared.sail().voyage
    return recording_of(voyage, voyage.weather)


def _drawn_tracks(
    calm: Trial, mission: SteeredMission, identified: Identified, own: Recording, length_m: float
) -> list[Track]:
    """Return what drawn models do near the identified one's run, as far as they can sail it."""
    assert own.inputs is not None
    error, accelerations = identified.model_error, None
    rho2 = squared_accelerations(identified.model, own.nu, own.attitude, own.inputs, None)
    tracks = []
    for i, model in enumerate(identified.draws(INTERVAL_DRAWS, DEVIATION_SHARE)):
        if error is not None:
            drawn = error.accelerations(rho2, own.period_s, np.random.default_rng(i))
            accelerations = DEVIATION_SHARE * drawn
        with suppress(*UNABLE):
            run = sailed(calm, mission, model, accelerations)
            tracks.append(track_of(run, mission.helm, length_m))
    return tracks


def manoeuvres(
    problem: Problem, identified: Identified, length_m: float | None, ordered: OrderedManoeuvre
) -> list[Diagnostic]:
    """Measure the manoeuvre of each file that is tested on; none for a vessel without a rudder.

    A file that holds no manoeuvre has no diagnostics.
    """
    if length_m is None or HELM not in problem.nominal.inputs:
        return []
    if not {*PLANAR} <= {*problem.nominal.dofs}:
        return []
    diagnostics: list[Diagnostic] = []
    tested = problem.validation
    only = "" if tested.file is None else tested.file_names[int(tested.file[0])]
    for i, (name, part) in enumerate((tested.by_file() or {only: tested}).items()):
        try:
            diagnostics += _of_file(i, name, part, problem, identified, length_m, ordered)
        except (RecordingError, ConfigurationError) as error:
            log.debug("%s: no manoeuvre: %s", name, error)
    return diagnostics


def _of_file(
    i: int,
    name: str,
    part: Recording,
    problem: Problem,
    identified: Identified,
    length_m: float,
    ordered: OrderedManoeuvre,
) -> list[Diagnostic]:
    """Return the measures of a file, of both models under its helm, and their bounds."""

    def track(run: Prediction) -> Track | None:  # None: it diverges
        motion, n = run.motion(), len(part.dofs)
        if not np.all(np.isfinite(motion)):
            return None
        return track_of(replace(part, eta=motion[:, :n], nu=motion[:, n:]), HELM, length_m)

    measured = measured_sheet(track_of(part, HELM, length_m), ordered)
    turn_deg, meant = measured.turn_deg, replace(ordered, kind=measured.manoeuvre)
    own: list[Measures] = []
    for model in (problem.nominal, identified.model):
        own.append({})
        with suppress(IdentificationError):
            if run := track(prediction(model, part, problem.thruster)):
                own[-1] = sheet(run, meant, turn_deg=turn_deg).values
    bounds: dict[str, tuple[float, float]] = {}
    if own[1]:
        near = nearby_runs(identified.model, part, problem.thruster)
        drawn = drawn_runs(identified, near, INTERVAL_DRAWS)
        bounds = intervals(own[1], filter(None, map(track, drawn)), meant, turn_deg)
    found = []
    for entry in measured.entries:
        values = [entry.value, *(each.get(entry.quantity) for each in own)]
        values += bounds.get(entry.quantity, ())
        quantity = entry.quantity.replace(", ", "_").replace(" ", "_")
        for j, value in enumerate(values):
            label = f"{name}, {COMPARED[j]}"
            found.append(
                Diagnostic(f"{DIAGNOSTIC}{quantity}", "all", value, entry.unit, i, j, label)
            )
    return found
