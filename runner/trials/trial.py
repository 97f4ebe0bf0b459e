"""A trial: excite -> identify -> validate -> deploy; each stage returns results, which add up.

The seed of the trial spawns independent random streams for the excitation, the measurement noise,
the disturbance and the identifier. The weather does not depend on the identifier or the controller.
So all methods are compared in the same weather, and the nominal and the identified model in pairs.
"""

import logging
from collections.abc import Iterable
from dataclasses import replace
from time import perf_counter

import numpy as np

from seatrial.models.diagnostics import TRAINING_TIME, Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.information import persistence
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.auto import identified as protected
from seatrial.models.identification.calibration import NO_MODEL_ERROR, calibrated
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import Identified, Problem, with_interval
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.devices import validity
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record import coefficient_rows, own_metrics
from seatrial.runner.record.coefficient_rows import numbered
from seatrial.runner.record.rows import Results
from seatrial.runner.trials import (
    berthing,
    deployment_metrics,
    excitation_results,
    manoeuvre_results,
    time_series,
    validation_metrics,
)
from seatrial.runner.trials.checks import check as check
from seatrial.runner.trials.checks import measured, skipped
from seatrial.runner.trials.closed_loop import (
    ExcitationData,
    MissionSetup,
    SimulatedMission,
    Streams,
    drawn,
    prepare,
)
from seatrial.runner.trials.tracking_intervals import tracking_intervals

log = logging.getLogger(__name__)
SAILED_AS_IDENTIFIED = "measured recording: the plant of the deployment is the identified model"
WITHHELD = "the identified model is not deployed: {}; deploy_unphysical=true deploys it"


class TrialDiverged(Diverged):
    """A simulation diverged; `results` are those that are valid all the same."""

    def __init__(self, error: Diverged, results: Results) -> None:
        super().__init__(str(error), error.time_s, error.quantity)
        self.results = results


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
        identified, impossible = identify(trial, problem, streams)
        results += of_identification(problem, identified, excited)
        results += validate(trial, problem, identified, excited)
        results += deploy(trial, streams, problem.nominal, identified, impossible, excited.truth)
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
        design = of_design(prepared, "nominal", "excitation: ")
        try:
            sailed = prepared.sail()
        except Diverged as error:
            raise TrialDiverged(error, design) from error
        recording = recording_of(sailed.voyage, sailed.voyage.weather)
        truth = trial.plant.scale * vessel.nominal() + trial.disturbance.table(vessel.dofs)
        split = excitation.split(recording.t)
    train, test = (mask & (np.cumsum(mask) <= (trial.samples or np.inf)) for mask in split)
    return ExcitationData(recording.with_thruster(vessel.thruster), train, test, truth, sailed)


def of_excitation(trial: Trial, problem: Problem, excited: ExcitationData) -> Results:
    """The data: how well they tell the terms apart, what was out of reach, a file's quality."""
    recording, sailed = excited.recording, excited.sailed
    reports = persistence(problem.training, problem.nominal, recording)
    warn("excitation: {}", filter(None, (report.warning() for report in reports)))
    results = Results(
        diagnostics=[
            *excitation_results.excitation_report(reports),
            *_outside_of_devices(problem.nominal, excited),
        ],
        series=[time_series.recording_series(recording, excited.training, sailed)],
    )
    if sailed is not None:
        unreached = deployment_metrics.unreached(sailed.voyage, "identification", "plant")
        shares = [row.value for row in unreached if row.value]
        warn(f"excitation: {deployment_metrics.UNREACHED}", shares)
        results += Results(unreached)
    if isinstance(file := trial.excitation, RecordedFile):
        results += excitation_results.of_file(file, recording)
    return results + excitation_results.mix_results(trial.excitation, excited)


def _outside_of_devices(nominal: Vessel, excited: ExcitationData) -> list[Diagnostic]:
    """Report where devices were outside of their data, for how long [s] and how far; warn of it."""
    recording = excited.recording
    if not nominal.devices or recording.inputs is None:
        return []
    x = recording.variables()
    excesses = validity.excesses(nominal.devices, x, recording.period_s)
    warn("excitation: {}", validity.doubts(nominal.devices, x))
    warn("excitation: {}", (excess.text for excess in excesses))
    return [Diagnostic("outside", "all", one.seconds, "s", label=one.text) for one in excesses]


def identify(trial: Trial, problem: Problem, seeds: Streams) -> tuple[Identified, str | None]:
    """Identify the model, and say what of it is physically impossible, with a diagnostic."""
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
    impossible = unphysical(identified.model, problem.nominal, problem.training.nu)
    if impossible:
        diagnostic = Diagnostic("unphysical", "all", 1.0, label=impossible)
        identified = replace(identified, diagnostics=(*identified.diagnostics, diagnostic))
    return identified, impossible


def of_identification(problem: Problem, identified: Identified, excited: ExcitationData) -> Results:
    """The coefficients, beside the nominal and the true ones, and the residual they explain."""
    return Results(
        coefficients=[
            *coefficient_rows.coefficients(problem.nominal, identified, excited.truth),
            *coefficient_rows.table_coefficients(numbered("stage", identified.stages)),
            *coefficient_rows.state_space_coefficients(identified),
        ],
        diagnostics=identified.diagnostics,
        series=[time_series.residual_series(excited, problem.nominal, identified)],
    )


def validate(
    trial: Trial, problem: Problem, identified: Identified, excited: ExcitationData
) -> Results:
    """Predict what was not trained on: accelerations, free runs, and manoeuvres."""
    tested, truth = problem.validation, excited.truth
    metrics = validation_metrics.validation(tested, problem.nominal, identified, truth)
    predicted = validation_metrics.predictions(problem, identified, truth, trial.horizons_s or ())
    deviation, unknown = validation_metrics.deviation(problem, identified)
    warn("prediction: {}", (one.label for one in (*predicted.diagnostics, *unknown)))
    models = {"nominal": problem.nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    own = own_metrics.validation_rows(trial.metrics, tested, models)
    diagnostics = [
        *predicted.diagnostics,
        *unknown,
        *validation_metrics.per_file(problem, identified),
    ]
    if isinstance(file := trial.excitation, RecordedFile):
        diagnostics += manoeuvre_results.recorded_manoeuvres(
            problem, identified, trial.vessel.scales.length_m, file.manoeuvre
        )
    return Results(
        [*metrics, *predicted.metrics, *own, *manoeuvre_results.own_manoeuvres(trial, models)],
        diagnostics=diagnostics,
        series=[time_series.prediction_series(tested, predicted, deviation)],
    )


def deploy(
    trial: Trial,
    seeds: Streams,
    nominal: Vessel,
    identified: Identified,
    impossible: str | None,
    truth: Vessel | None,
) -> Results:
    """Simulate the evaluation with a controller built on the nominal and on the identified model.

    Both are simulated in the same weather; an identified model that is physically impossible is
    withheld. With `update`, a third simulation adapts the nominal model. After a measured recording
    the plant is the identified model, as the true one is not known. Raises TrialDiverged.
    `impossible` says why a model is physically impossible; `truth` is the plant, if it is known.
    """
    if (note := skipped(trial)) is not None:
        return Results(note=note)
    if withhold := impossible is not None and not trial.deploy_unphysical:
        note = WITHHELD.format(impossible)
        log.warning(note)
    true = None
    if truth is None:
        if withhold:
            return Results(note=note)
        try:
            identified.model.plant_table()
        except ConfigurationError as error:
            log.warning("deployment is skipped: %s", error)
            return Results(note=f"measured recording: deployment is skipped: {error}")
        true, note = identified.model, SAILED_AS_IDENTIFIED
    controller, mission = trial.controller, evaluated(trial)
    assert controller is not None
    models: dict[str, Vessel | StateSpace] = {"nominal": nominal}
    if not withhold:
        linear = identified.control_model if controller.takes_state_space else None
        models["identified"] = identified.model if linear is None else linear
    if trial.update is not None:
        models["adaptive"] = nominal
    results, failure = Results(note=note), None
    for name, model in models.items():
        prepared = prepare(trial, seeds, model, mission, deployed=True, true=true)
        results += of_design(prepared, name)
        try:
            sailed = prepared.sail(adaptive=name == "adaptive")
        except Diverged as error:
            failure = Diverged(f"{name} model: {error}", error.time_s, error.quantity)
            continue
        results += of_voyage(trial, sailed, name)
        results += berthing.berthing_results(mission, sailed, name)
        if name == "identified" and true is not None:
            intervals = tracking_intervals(trial, seeds, identified, mission, sailed)
            results += Results(diagnostics=intervals)
    if withhold:
        results += Results(deployment_metrics.withheld(results.metrics))
    if failure is not None:
        raise TrialDiverged(failure, results)
    return results


def evaluated(trial: Trial) -> Mission:
    """The mission of the evaluation, which may be that of the excitation once more."""
    evaluation, excitation = trial.evaluation, trial.excitation
    assert evaluation is not None
    if isinstance(evaluation, Mission):
        return evaluation
    assert isinstance(excitation, Mission)
    return evaluation.mission(excitation)


def of_design(prepared: MissionSetup, model: str, where: str = "") -> Results:
    """The properties of a controller's design on a model; warn of those that ask for it."""
    results, warnings = deployment_metrics.of_design(prepared.design, model)
    warn(f"{where}{{}}", warnings)
    return results


def of_voyage(trial: Trial, sailed: SimulatedMission, model: str) -> Results:
    """How well a mission was tracked by a controller built on a model, and what that took."""
    voyage, adapter = sailed.voyage, sailed.adapter
    losses = deployment_metrics.losses(sailed, model)
    warn("{}", losses)
    results = Results(
        [
            *deployment_metrics.tracking_metrics(voyage, model, trial.sample_time_s),
            *deployment_metrics.response_metrics(sailed, model),
            *own_metrics.deployment_rows(trial.metrics, voyage, model),
        ],
        diagnostics=[
            *deployment_metrics.warning_rows(losses),
            *(replace(finding, label=model) for finding in sailed.findings),
        ],
        series=[time_series.deployment_series(sailed, model)],
    )
    if adapter is not None:
        versions = numbered("adaptive", (model for _, model, _ in adapter.versions))
        rows = coefficient_rows.table_coefficients(versions)
        results += Results(coefficients=rows, diagnostics=adapter.diagnostics())
    return results


def warn(text: str, reasons: Iterable[object]) -> None:
    """Log a warning for each reason."""
    for reason in reasons:
        log.warning(text.format(reason))
