"""What the models of a trial do in its manoeuvre, and predict of those in the files tested on.

The metrics `manoeuvre_QUANTITY` are of a model that carries out the manoeuvre of the excitation in
calm water.

The diagnostics `recorded_manoeuvre_QUANTITY`, such as `recorded_manoeuvre_tactical_diameter`, have
the file as i and as j one of `COMPARED`. There the models have the recorded helm, also in a
zig-zag. The intervals are of first order: quantiles over runs that are drawn from the joint
distribution of what was identified and of its model error, near it. Without a model error
(`no_model_error`) they hold what the data leave open of the parameters alone, as far as its
standard errors do (`interval_of_estimate`).
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged, IdentificationError, RecordingError
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.calibration import drawn_runs, nearby_runs
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.validation import Prediction, prediction
from seatrial.models.notation import PLANAR, OrderedManoeuvre
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation import manoeuvre_sheet as sheets
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.disturbance import Disturbance
from seatrial.runner.configuration.config import Trial
from seatrial.runner.configuration.vessel_options import HELM
from seatrial.runner.record.catalogue import metric_of_measure
from seatrial.runner.record.rows import Metric, metric
from seatrial.runner.trials.closed_loop import Streams, prepare

INTERVAL_DRAWS = 100  # models of an interval
UNABLE = (ConfigurationError, Diverged, IdentificationError, RecordingError)


def own_manoeuvres(trial: Trial, models: Mapping[str, Vessel]) -> list[Metric]:
    """Return the measures of each model that can carry out the manoeuvre.

    Empty unless the excitation is a standard manoeuvre of a steered vessel in the plane.
    """
    mission, kind = trial.excitation, getattr(trial.excitation, "manoeuvre", None)
    metrics, in_plane = list[Metric](), {*PLANAR} <= {*trial.vessel.dofs}
    if not (isinstance(mission, SteeredMission) and kind in sheets.MEASURED and in_plane):
        return metrics
    calm, length_m = replace(trial, disturbance=Disturbance()), trial.vessel.scales.length_m
    for name, model in models.items():
        with suppress(*UNABLE):
            track = sheets.track_of(sailed(calm, mission, model), mission.helm, length_m)
            metrics += [
                metric(metric_of_measure(quantity), "validation", name, "all", value)
                for quantity, value in sheets.sheet(track, OrderedManoeuvre(kind)).values.items()
                if np.isfinite(value)
            ]
    return metrics


def sailed(calm: Trial, mission: Mission, model: Vessel) -> Recording:
    """Return the recording of a model that carries out the mission."""
    seeds, nominal = Streams(calm.seed), calm.vessel.nominal()
    voyage = prepare(calm, seeds, nominal, mission, true=model).sail().voyage
    return recording_of(voyage, voyage.weather)


def recorded_manoeuvres(
    problem: Problem, identified: Identified, length_m: float, ordered: OrderedManoeuvre
) -> list[Diagnostic]:
    """Measure the manoeuvre of each file that is tested on; none for a vessel without a rudder.

    A file that holds no manoeuvre has no diagnostics.
    """
    found, tested = list[Diagnostic](), problem.validation
    if HELM not in problem.nominal.inputs or not {*PLANAR} <= {*problem.nominal.dofs}:
        return found
    only = "" if tested.file is None else tested.file_names[int(tested.file[0])]
    for i, (name, part) in enumerate((tested.by_file() or {only: tested}).items()):
        with suppress(RecordingError, ConfigurationError):
            of_file = replace(problem, validation=part)
            for entry, values in _compared(of_file, identified, length_m, ordered):
                measure = sheets.DIAGNOSTIC + entry.quantity.replace(",", "").replace(" ", "_")
                found += [
                    Diagnostic(measure, "all", value, entry.unit, i, j, f"{name}, {of}")
                    for j, (of, value) in enumerate(zip(sheets.COMPARED, values, strict=False))
                ]
    return found


def _compared(
    problem: Problem, identified: Identified, length_m: float, ordered: OrderedManoeuvre
) -> Iterator[tuple[sheets.SheetEntry, list[float | None]]]:
    """Yield each measure of a file, those of both models under its helm, and the bounds."""
    file = problem.validation

    def track(run: Prediction) -> sheets.Track | None:  # None: it diverges
        motion, n = run.motion(), len(file.dofs)
        if not np.all(np.isfinite(motion)):
            return None
        return sheets.track_of(replace(file, eta=motion[:, :n], nu=motion[:, n:]), HELM, length_m)

    measured = sheets.measured_sheet(sheets.track_of(file, HELM, length_m), ordered)
    own: list[sheets.Measures] = [{}, {}]
    for k, model in enumerate((problem.nominal, identified.model)):
        with suppress(IdentificationError):
            if run := track(prediction(model, file, problem.thruster)):
                own[k] = sheets.sheet(run, measured.ordered).values
    bounds: dict[str, tuple[float, float]] = {}
    if own[1]:
        near = nearby_runs(identified.model, file, problem.thruster)
        tracks = filter(None, map(track, drawn_runs(identified, near, INTERVAL_DRAWS)))
        drawn = sheets.drawn_values(own[1], tracks, measured.ordered)
        bounds = {name: sheets.interval(own[1][name], values) for name, values in drawn.items()}
    for entry in measured.entries:
        both = (values.get(entry.quantity) for values in own)
        yield entry, [entry.value, *both, *bounds.get(entry.quantity, ())]
