"""A trial: excite -> identify -> validate -> deploy; each stage returns results, which add up.

The seed of the trial spawns independent random streams for the excitation, the measurement noise,
the disturbance and the identifier. The weather does not depend on the identifier or the controller.
So all methods are compared in the same weather, and the nominal and the identified model in pairs.
"""

import logging
from dataclasses import replace
from time import perf_counter

import numpy as np

from seatrial.models.diagnostics import TRAINING_TIME, Diagnostic
from seatrial.models.errors import Diverged
from seatrial.models.identification.auto import identified as protected
from seatrial.models.identification.calibration import NO_MODEL_ERROR, calibrated
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import Identified, Problem, lack_of_fit, with_interval
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.simulation.voyage import recording_of
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.coefficient_rows import coefficients
from seatrial.runner.record.rows import Results
from seatrial.runner.trials.checks import check as check
from seatrial.runner.trials.checks import measured
from seatrial.runner.trials.checks import skipped as skipped
from seatrial.runner.trials.closed_loop import ExcitationData, Streams, drawn, prepare, warn
from seatrial.runner.trials.closed_loop import TrialDiverged as TrialDiverged
from seatrial.runner.trials.deployment_metrics import UNPHYSICAL, deploy, of_design
from seatrial.runner.trials.excitation_results import of_excitation
from seatrial.runner.trials.time_series import SeriesColumns
from seatrial.runner.trials.validation_metrics import validate

log = logging.getLogger(__name__)


def run(trial: Trial) -> Results:
    """Run a checked trial; raises TrialDiverged with the results that are valid all the same."""
    streams, results = Streams(trial.seed), Results()
    trial = drawn(trial, streams)
    warn("vessel: nothing resists a motion in {} alone, expected damping", trial.vessel.undamped)
    try:
        excited = excite(trial, streams)
        problem = Problem(
            training=excited.recording.part(excited.training),
            validation=excited.recording.part(excited.testing),
            nominal=trial.vessel.nominal(),
            thruster=trial.vessel.thruster,
        )
        results += of_excitation(trial, problem, excited)
        identified = identify(trial, problem, streams)
        results += of_identification(problem, identified, excited)
        results += validate(trial, problem, identified, excited.truth)
        results += deploy(trial, streams, problem.nominal, identified, excited.truth)
    except TrialDiverged as error:
        error.results = replace(results + error.results, drawn=streams.drawn())
        raise
    return replace(results, drawn=streams.drawn())


def excite(trial: Trial, seeds: Streams) -> ExcitationData:
    """Simulate the excitation with the nominal model, or read the recorded file.

    Raises TrialDiverged with the results of the controller's design.
    """
    vessel, excitation = trial.vessel, trial.excitation
    if isinstance(excitation, RecordedFile):
        recording, truth, sailed = measured(trial, excitation), None, None
        split = excitation.split(recording.t, recording.file)
    else:
        prepared = prepare(trial, seeds, vessel.nominal(), excitation)
        design = of_design(prepared.design, "nominal", "excitation: ")
        try:
            sailed = prepared.sail()
        except Diverged as error:
            raise TrialDiverged(error, design) from error
        recording = recording_of(sailed.voyage, sailed.voyage.weather)
        truth = trial.plant.scale * vessel.nominal() + trial.disturbance.table(vessel.dofs)
        split = excitation.split(recording.t)
    train, test = (mask & (np.cumsum(mask) <= (trial.samples or np.inf)) for mask in split)
    return ExcitationData(recording.with_thruster(vessel.thruster), train, test, truth, sailed)


def identify(trial: Trial, problem: Problem, seeds: Streams) -> Identified:
    """Identify the model; a diagnostic says what of it is physically impossible."""
    identifier, rng = trial.identifier, seeds.generator("identifier")
    began = perf_counter()
    result = protected(identifier, problem, rng)
    seconds = Diagnostic(TRAINING_TIME, "all", perf_counter() - began, "s")
    if trial.model_error:
        result = calibrated(identifier, problem, result)
    identified = with_interval(
        identifier, replace(result, diagnostics=(*result.diagnostics, seconds))
    )
    for note in identified.notes:
        log.info("identification: %s", note)
    warn("identification: {}", identified.warnings)
    unknown = [one.label for one in identified.diagnostics if one.name == NO_MODEL_ERROR]
    warn("intervals do not include the model error: {}", unknown)
    if (flaw := unphysical(identified.model, problem.nominal, problem.training.nu)) is None:
        return identified
    diagnostic = Diagnostic(UNPHYSICAL, "all", 1.0, label=flaw)
    return replace(identified, diagnostics=(*identified.diagnostics, diagnostic))


def of_identification(problem: Problem, identified: Identified, excited: ExcitationData) -> Results:
    """The coefficients, beside the nominal and the true ones, and the residual they explain.

    The series has the commanded force, and its residual for every model, over the recording.
    """
    recording = excited.recording
    columns = SeriesColumns(recording.dofs, recording.t)
    columns.add(excited.training, {"train": ""})
    columns.add(recording.tau, columns.force, "tau_{}")
    models = {"nominal": problem.nominal, "identified": identified.model, "plant": excited.truth}
    for name, model in models.items():
        if model is not None:
            residual = lack_of_fit(recording, model, "commanded")
            columns.add(residual, columns.force, f"residual_{name}_{{}}")
    return Results(
        coefficients=coefficients(problem.nominal, identified, excited.truth),
        diagnostics=identified.diagnostics,
        series=[columns.series("residual")],
    )
