"""A trial: excite -> identify -> validate -> deploy, and the results that it stores.

The seed of the trial spawns independent random streams for the excitation, the measurement noise,
the disturbance and the identifier. The weather does not depend on the identifier or the controller.
So all methods are compared in the same weather, and the nominal and the identified model in pairs.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter

import numpy as np

from seatrial.models.control.controller import Controller
from seatrial.models.diagnostics import TRAINING_TIME, Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged, RecordingError
from seatrial.models.excitation.information import persistence
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.calibration import NO_MODEL_ERROR, calibrated
from seatrial.models.identification.fallback import identified as protected
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import (
    MIN_SAMPLES,
    Identified,
    Problem,
    check_needs,
    with_interval,
)
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording, check_cutoff
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.devices import validity
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record import coefficient_rows, own_metrics
from seatrial.runner.record.coefficient_rows import numbered
from seatrial.runner.record.rows import Metric, Results
from seatrial.runner.trials import (
    budget,
    deployment_metrics,
    excitation_results,
    manoeuvre_results,
    recording_checks,
    time_series,
    validation_metrics,
)
from seatrial.runner.trials.closed_loop import (
    ExcitationData,
    MissionSetup,
    SimulatedMission,
    Streams,
    commanded,
    prepare,
)
from seatrial.runner.trials.tracking_intervals import tracking_intervals

log = logging.getLogger(__name__)
MEASURED = "measured recording: plant simulation and deployment are skipped"
SAILED_AS_IDENTIFIED = "measured recording: the plant of the deployment is the identified model"
WITHHELD = "the identified model is not deployed: {}; deploy_unphysical=true deploys it"
NOT_DEPLOYED = "no {0} ({0}=none): deployment is skipped"


class TrialDiverged(Diverged):
    """A simulation diverged; `results` are those that are valid all the same."""

    def __init__(self, error: Diverged, results: Results) -> None:
        super().__init__(str(error), error.time_s, error.quantity)
        self.results = results


def check(trial: Trial) -> None:
    """Check a trial before it is run; raises ConfigurationError for an invalid combination."""
    budget.check(trial)
    excitation, dofs = trial.excitation, trial.vessel.dofs
    named(trial, "excitation", lambda: excitation.check(dofs))
    nominal, thruster = trial.vessel.nominal(), trial.vessel.thruster
    trial.identifier.check(nominal, thruster, isinstance(excitation, RecordedFile))
    recording, period = None, trial.sample_time_s
    if isinstance(excitation, RecordedFile):
        for option, path in excitation.files().items():
            if not path.exists():
                raise ConfigurationError(f"excitation.{option}: {path}: there is no such file")
        if skipped(trial) is None:
            evaluation = trial.evaluation
            assert isinstance(evaluation, Mission)
            _check_length(trial, "evaluation", evaluation)
            named(trial, "disturbance", lambda: trial.disturbance.check(dofs, longest_s(trial)))
            named(trial, "evaluation", lambda: evaluation.check(dofs))
        recording = measured(trial, excitation)
        period = recording.period_s
    else:
        _check_mission(trial, excitation)
    needs = trial.identifier.needs()
    check_cutoff(needs.lowpass_hz, period)
    model_period = trial.identifier.model_period_s(period)
    controller = trial.controller
    if controller is not None:
        controller.build(commanded(nominal, controller), trial.sample_time_s)
        if model_period is not None and skipped(trial) is None:
            check_periods(trial, controller, model_period)
    check_needs(needs, trial.vessel.name, thruster, recording)


def measured(trial: Trial, file: RecordedFile) -> Recording:
    """Read a recording; raises RecordingError if it cannot be read, trusted, or trained on."""
    recording = file.read(trial.vessel.dofs)
    _check_samples(trial, file, recording)
    recording_checks.refuse(file, trial.vessel.dofs)
    return recording


def _check_samples(trial: Trial, file: RecordedFile, recording: Recording) -> None:
    """Check that a recording has enough samples to train and to test; raises RecordingError."""
    name = ", ".join(map(str, file.files().values())) or type(file).__name__
    split = file.split(recording.t, recording.file)
    if (count := int(np.count_nonzero(split.test))) < MIN_SAMPLES:
        raise RecordingError(
            f"{name}: got {count} samples for testing, expected at least {MIN_SAMPLES}"
        )
    training, nominal = recording.part(split.train), trial.vessel.nominal()
    try:
        trial.identifier.check_samples(training, nominal)
    except RecordingError as error:
        raise RecordingError(f"{name}: {error}") from error


def _check_mission(trial: Trial, excitation: Mission) -> None:
    """Check that the vessel and the controller can carry out the mission in this weather."""
    dofs = trial.vessel.dofs
    if trial.controller is None and not excitation.open_loop:
        raise ConfigurationError(
            f"controller=none: excitation={trial.names['excitation']} needs a controller"
        )
    for group, mission in (("excitation", excitation), ("evaluation", trial.evaluation)):
        if isinstance(mission, Mission):
            _check_length(trial, group, mission)
    named(trial, "disturbance", lambda: trial.disturbance.check(dofs, longest_s(trial)))
    _check_commands(trial)
    excitation.check_limits(trial.vessel.limits_by_dof, trial.sample_time_s)
    evaluation = trial.evaluation
    if evaluation is not None:
        named(trial, "evaluation", lambda: evaluation.check(dofs))


def _check_commands(trial: Trial) -> None:
    """Check that missions and controller command what the vessel takes: inputs, or forces."""
    vessel = trial.vessel
    takes = f"is commanded by {', '.join(vessel.inputs) or 'forces'}"
    known = {bool(vessel.inputs)} | ({False} if vessel.positioning else set())
    for group, part in (
        ("excitation", trial.excitation),
        ("controller", trial.controller),
        ("evaluation", trial.evaluation),
    ):
        if isinstance(part, Mission | Controller) and part.commands_inputs not in known:
            raise ConfigurationError(
                f"{group}={trial.names[group]}: {vessel.name} {takes}, which it does not give"
            )
    controller = trial.controller
    for group in ("excitation", "evaluation"):
        mission = getattr(trial, group)
        if controller is None or not isinstance(mission, Mission) or mission.open_loop:
            continue
        if mission.commands_inputs != controller.commands_inputs:
            kinds = {True: "inputs", False: "forces"}
            raise ConfigurationError(
                f"{group}={trial.names[group]}: is sailed by {kinds[mission.commands_inputs]}, but "
                f"controller={trial.names['controller']} commands "
                f"{kinds[controller.commands_inputs]}"
            )


def _check_length(trial: Trial, group: str, mission: Mission) -> None:
    """Check that a mission has samples for training and for testing."""
    seconds, period = mission.length().seconds, trial.sample_time_s
    count, fewest = round(seconds / period), 2 * MIN_SAMPLES
    if count < fewest:
        raise ConfigurationError(
            f"{group}={trial.names[group]}: got {seconds:g} s, {count} samples of"
            f" sample_time_s={period:g}; expected at least {fewest}"
        )


def named(trial: Trial, group: str, check: Callable[[], None]) -> None:
    """Run a check, and put the option chosen from the group before its error message."""
    try:
        check()
    except ConfigurationError as error:
        name = f"{group}={trial.names[group]}"
        if str(error).startswith(name):
            raise
        raise ConfigurationError(f"{name}: {error}") from error


def longest_s(trial: Trial) -> float:
    """Return the time [s] of the last simulated instant, of the excitation or the evaluation."""
    missions = (trial.excitation, trial.evaluation)
    durations = [mission.duration_s for mission in missions if isinstance(mission, Mission)]
    return max(durations) - trial.sample_time_s if durations else 0.0


def check_periods(trial: Trial, controller: Controller, model_period: float) -> None:
    """Check that the controller's period is a multiple of the identified model's period [s]."""
    if not controller.takes_state_space:
        return
    sample_time = trial.sample_time_s
    period = controller.command_rows(sample_time) * sample_time
    multiple = round(period / model_period)
    if multiple < 1 or abs(multiple * model_period - period) > 1e-9 * period:
        raise ConfigurationError(
            f"controller.period_s: got {period:g} s, expected a multiple of identifier.period_s, "
            f"{model_period:g} s: a state-space model is valid at its own sample time only"
        )


def run(trial: Trial) -> Results:
    """Run a checked trial; raises TrialDiverged with the results that are valid all the same."""
    streams = Streams(trial.seed)
    try:
        return replace(_run(trial, streams), drawn=streams.drawn())
    except TrialDiverged as error:
        error.results = replace(error.results, drawn=streams.drawn())
        raise


def _run(trial: Trial, seeds: Streams) -> Results:
    excited = excite(trial, seeds)
    problem = Problem(
        training=excited.recording.part(excited.training),
        validation=excited.recording.part(excited.testing),
        nominal=trial.vessel.nominal(),
        thruster=trial.vessel.thruster,
    )
    identified, impossible = identify(trial, problem, seeds)
    validation = validation_metrics.validation(
        problem.validation, problem.nominal, identified, excited.truth
    )
    predicted = validation_metrics.predictions(problem, identified, excited.truth, trial.horizons_s)
    deviation, unknown = validation_metrics.deviation(problem, identified)
    for reason in (*predicted.diagnostics, *unknown):
        log.warning("prediction: %s", reason.label)
    models = {"nominal": problem.nominal, "identified": identified.model}
    if excited.truth is not None:
        models["plant"] = excited.truth
    mix = excitation_results.mix_results(trial.excitation, excited)
    sheets = manoeuvre_results.manoeuvre_results(trial, models, identified)
    results = Results(
        metrics=[
            *validation,
            *predicted.metrics,
            *unreached(excited),
            *mix.metrics,
            *own_metrics.validation_rows(trial.metrics, problem.validation, models),
            *sheets.metrics,
        ],
        coefficients=[
            *coefficient_rows.coefficients(problem.nominal, identified, excited.truth),
            *coefficient_rows.table_coefficients(numbered("stage", identified.stages)),
            *coefficient_rows.state_space_coefficients(identified),
        ],
        diagnostics=[
            *identified.diagnostics,
            *predicted.diagnostics,
            *unknown,
            *validation_metrics.per_file(problem, identified),
            *measured_manoeuvres(trial, problem, identified),
            *excitation_report(problem, excited.recording),
            *device_report(problem.nominal, excited.recording),
            *deployment_metrics.loop_diagnostics(excited.sailed, "excitation"),
            *mix.diagnostics,
            *sheets.diagnostics,
        ],
        series=[
            time_series.recording_series(excited.recording, excited.training, excited.sailed),
            time_series.residual_series(excited, problem.nominal, identified),
            time_series.prediction_series(problem.validation, predicted, deviation),
            *mix.series,
        ],
        note=skipped(trial),
    )
    if isinstance(trial.excitation, RecordedFile):
        results = with_quality(results, trial.excitation, excited.recording)
    if results.note:
        return results
    return _with_deployment(trial, seeds, problem.nominal, identified, impossible, excited, results)


def _with_deployment(
    trial: Trial, seeds: Streams, nominal: Vessel, identified: Identified, impossible: str | None,
    excited: ExcitationData, results: Results,
) -> Results:  # fmt: skip
    """Sail the evaluation with what was identified, unless it is impossible or has no plant."""
    deployed: Identified | None = identified
    if impossible and not trial.deploy_unphysical:
        deployed, results = None, replace(results, note=WITHHELD.format(impossible))
        log.warning(results.note)
    true = None
    if excited.truth is None and deployed is not None:
        true, note = as_plant(identified.model)
        results = replace(results, note=note)
    if excited.truth is None and true is None:
        return results
    return deploy(trial, seeds, nominal, deployed, results, true)


def measured_manoeuvres(trial: Trial, problem: Problem, identified: Identified) -> list[Diagnostic]:
    """Return the measures of the manoeuvres that were recorded, beside the predicted ones."""
    if not isinstance(trial.excitation, RecordedFile):
        return []
    length_m = manoeuvre_results.length_of(trial)
    return manoeuvre_results.manoeuvres(problem, identified, length_m)


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
    for warning in identified.warnings:
        log.warning("identification: %s", warning)
    for diagnostic in identified.diagnostics:
        if diagnostic.name == NO_MODEL_ERROR:
            log.warning("intervals hold no model error: %s", diagnostic.label)
    impossible = unphysical(identified.model, problem.nominal, problem.training.nu)
    if impossible:
        diagnostic = Diagnostic("unphysical", "all", 1.0, label=impossible)
        identified = replace(identified, diagnostics=(*identified.diagnostics, diagnostic))
    return identified, impossible


def as_plant(identified: Vessel) -> tuple[Vessel | None, str]:
    """Return the model that is sailed after a measured recording, and a note on it.

    It is the identified one, since the true one is not known; None if it cannot be simulated.
    """
    try:
        identified.plant_table()
    except ConfigurationError as error:
        log.warning("deployment is skipped: %s", error)
        return None, f"measured recording: deployment is skipped: {error}"
    return identified, SAILED_AS_IDENTIFIED


def with_quality(results: Results, file: RecordedFile, recording: Recording) -> Results:
    """Add the statistics and quality checks of a measured recording to the results."""
    diagnostics = [
        *excitation_results.column_statistics(file),
        *excitation_results.outlier_counts(file, recording.dofs),
        *recording_checks.diagnostics(file, recording.dofs),
    ]
    return replace(
        results,
        metrics=[*results.metrics, *excitation_results.recording_quality(recording)],
        diagnostics=[*results.diagnostics, *diagnostics],
    )


def excitation_report(problem: Problem, recording: Recording) -> list[Diagnostic]:
    """Report how well the training data distinguish the nominal terms; warn where they do not."""
    reports = persistence(problem.training, problem.nominal, recording)
    for warning in filter(None, (report.warning() for report in reports)):
        log.warning("excitation: %s", warning)
    return excitation_results.excitation_report(reports)


def device_report(nominal: Vessel, recording: Recording) -> list[Diagnostic]:
    """Report where devices were outside of their data, for how long [s] and how far; warn of it."""
    if not nominal.devices or recording.inputs is None:
        return []
    x = recording.variables()
    for doubt in validity.doubts(nominal.devices, x):
        log.warning("excitation: %s", doubt)
    found = validity.excesses(nominal.devices, x, recording.period_s)
    for excess in found:
        log.warning("excitation: %s", excess.text)
    return [Diagnostic("outside", "all", one.seconds, "s", label=one.text) for one in found]


def unreached(excited: ExcitationData) -> list[Metric]:
    """Compute the share of commands that the thrusters could not produce; warn if it is not 0."""
    if excited.sailed is None:
        return []
    rows = deployment_metrics.unreached(excited.sailed.voyage, "identification", "plant")
    for share in (row.value for row in rows if row.value):
        log.warning("excitation: %s", deployment_metrics.UNREACHED.format(share))
    return rows


def skipped(trial: Trial) -> str | None:
    """Return why a trial has no deployment, or None if it has one."""
    if isinstance(
        trial.excitation, RecordedFile
    ):  # its reference is not known, so it has no replay
        missing = trial.controller is None or not isinstance(trial.evaluation, Mission)
        return MEASURED if missing else None
    if trial.controller is None:
        return NOT_DEPLOYED.format("controller")
    if trial.evaluation is None:
        return NOT_DEPLOYED.format("evaluation")
    return trial.evaluation.skip_reason(trial.excitation)


def excite(trial: Trial, seeds: Streams) -> ExcitationData:
    """Simulate the excitation with the nominal model, or read the recorded file."""
    vessel = trial.vessel
    if isinstance(trial.excitation, RecordedFile):
        recording, truth, sailed = measured(trial, trial.excitation), None, None
    else:
        model = vessel.nominal()
        sailed = sailed_excitation(prepare(trial, seeds, model, trial.excitation))
        recording = recording_of(sailed.voyage, sailed.voyage.weather)
        truth = trial.plant_scale * model + trial.disturbance.table(vessel.dofs)
    split = (
        trial.excitation.split(recording.t, recording.file)
        if isinstance(trial.excitation, RecordedFile)
        else trial.excitation.split(recording.t)
    )
    recording = recording.with_thruster(vessel.thruster)
    train, test = (mask & (np.cumsum(mask) <= (trial.samples or np.inf)) for mask in split)
    return ExcitationData(recording, train, test, truth, sailed)


def sailed_excitation(prepared: MissionSetup) -> SimulatedMission:
    """Simulate the excitation, after the warnings of the controller's design are logged.

    Raises TrialDiverged with the results of the design.
    """
    design = prepared.design
    for warning in deployment_metrics.design_warnings(design, "nominal"):
        log.warning("excitation: %s", warning)
    try:
        return prepared.sail()
    except Diverged as error:
        results = Results(
            deployment_metrics.design_metrics(design, "nominal"),
            diagnostics=deployment_metrics.design_diagnostics(design, "nominal"),
        )
        raise TrialDiverged(error, results) from error


def controlled(controller: Controller, identified: Identified) -> Vessel | StateSpace:
    """Return the identified model in the form that the controller takes."""
    linear = identified.control_model if controller.takes_state_space else None
    return identified.model if linear is None else linear


def deploy(
    trial: Trial,
    seeds: Streams,
    nominal: Vessel,
    identified: Identified | None,
    results: Results,
    true: Vessel | None = None,
) -> Results:
    """Simulate the evaluation with a controller built on the nominal and on the identified model.

    Both are simulated in the same weather; an identified model that is withheld is None. With
    `update`, a third simulation adapts the nominal model. `true` is the model of the plant, if that
    is not the scaled nominal one. Returns `results` with these added; raises TrialDiverged.
    """
    controller, evaluation, excitation = trial.controller, trial.evaluation, trial.excitation
    assert controller is not None
    assert evaluation is not None
    if isinstance(evaluation, Mission):
        mission: Mission = evaluation
    else:
        assert isinstance(excitation, Mission)
        mission = evaluation.mission(excitation)
    metrics, series = list(results.metrics), list(results.series)
    diagnostics, coefficients = list(results.diagnostics), list(results.coefficients)
    failure: Diverged | None = None
    models: dict[str, Vessel | StateSpace] = {"nominal": nominal}
    if identified is not None:
        models["identified"] = controlled(controller, identified)
    if trial.update is not None:
        models["adaptive"] = nominal
    for name, model in models.items():
        prepared = prepare(trial, seeds, model, mission, deployed=True, true=true)
        for warning in deployment_metrics.design_warnings(prepared.design, name):
            log.warning(warning)
        metrics += deployment_metrics.design_metrics(prepared.design, name)
        diagnostics += deployment_metrics.design_diagnostics(prepared.design, name)
        try:
            sailed = prepared.sail(adaptive=name == "adaptive")
        except Diverged as error:
            failure = Diverged(f"{name} model: {error}", error.time_s, error.quantity)
            continue
        metrics += deployment_metrics.tracking_metrics(sailed.voyage, name, trial.sample_time_s)
        metrics += deployment_metrics.response_metrics(sailed, name)
        metrics += own_metrics.deployment_rows(trial.metrics, sailed.voyage, name)
        series.append(time_series.voyage_series(sailed, name))
        if name == "identified" and identified is not None and true is not None:
            diagnostics += tracking_intervals(trial, seeds, identified, mission, sailed)
        if sailed.adapter is not None:
            versions = numbered("adaptive", (model for _, model, _ in sailed.adapter.versions))
            coefficients += coefficient_rows.table_coefficients(versions)
            diagnostics += sailed.adapter.diagnostics()
        for warning in (warnings := deployment_metrics.losses(sailed, name)):
            log.warning(warning)
        diagnostics += deployment_metrics.warning_rows(warnings)
        diagnostics += deployment_metrics.loop_diagnostics(sailed, name)
    metrics += deployment_metrics.withheld(metrics) if identified is None else []
    complete = Results(metrics, coefficients, diagnostics, series, note=results.note)
    if failure is not None:
        raise TrialDiverged(failure, complete)
    return complete
