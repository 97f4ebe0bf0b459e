"""A trial: excite -> identify -> validate -> deploy, and the rows that are stored of it.

One seed makes a trial. Its streams are spawned: excitation, measurement noise, disturbance,
identifier. The weather's streams do not depend on the identifier or the controller, so every
competitor meets the same weather, and the nominal and the identified model are compared in pairs.
"""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from seatrial.models.control.controller import Controller
from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.information import persistence
from seatrial.models.excitation.missions import (
    Evaluation,
    Mission,
)
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import Identified, Identifier, Problem, check_needs
from seatrial.models.recording.readers import Reader
from seatrial.models.recording.recording import Recording, check_cutoff
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.disturbance import Disturbance
from seatrial.runner.closed_loop import Excited, Prepared, Sailed, Streams, prepare, streams
from seatrial.runner.closed_loop import sail_mission as sail_mission
from seatrial.runner.config import Trial
from seatrial.runner.database.records import Metric, Results
from seatrial.runner.record import (
    coefficient_rows,
    deployment_metrics,
    excitation_results,
    own_metrics,
    time_series,
    validation_metrics,
)
from seatrial.runner.record.coefficient_rows import numbered

log = logging.getLogger(__name__)
MEASURED = "measured recording: plant simulation and deployment are skipped"
NOT_DEPLOYED = "no {0} ({0}=none): deployment is skipped"


class TrialDiverged(Diverged):
    """A voyage left the limits of the vessel; `results` are what still holds."""

    def __init__(self, error: Diverged, results: Results) -> None:
        super().__init__(str(error), error.time_s, error.quantity)
        self.results = results


def check(trial: Trial) -> None:
    """Raise ConfigurationError for a combination that cannot work, before any work."""
    _check_roles(trial)
    excitation, dofs = trial.excitation, trial.vessel.dofs
    named(trial, "excitation", lambda: excitation.check(dofs))
    recorded, period = None, trial.sample_time_s
    if isinstance(excitation, Reader):  # a damaged file is a wrong option, not a failed trial
        recorded = excitation.read(dofs)
        period = recorded.period_s
    else:
        _check_mission(trial, excitation)
    needs = trial.identifier.needs()
    check_cutoff(needs.lowpass_hz, period)
    controller = trial.controller
    if controller is not None:
        controller.build(trial.vessel.nominal(), trial.sample_time_s)
        check_periods(trial, controller)
    thruster = trial.vessel.thruster
    trial.identifier.check(trial.vessel.nominal(), thruster, recorded is not None)
    check_needs(needs, trial.vessel.name, thruster, recorded)


def _check_roles(trial: Trial) -> None:
    """Refuse an object that is not what its group holds: an option names a class by itself."""
    for group, (role, part) in {
        "vessel": (VesselParameters, trial.vessel),
        "disturbance": (Disturbance, trial.disturbance),
        "excitation": (Mission | Reader, trial.excitation),
        "identifier": (Identifier, trial.identifier),
        "controller": (Controller | None, trial.controller),
        "evaluation": (Evaluation | None, trial.evaluation),
    }.items():
        if not isinstance(part, role):
            raise ConfigurationError(
                f"{group}._target_: got {type(part).__name__}, expected a class for this group"
            )


def _check_mission(trial: Trial, excitation: Mission) -> None:
    """Refuse what cannot be sailed with this vessel in this weather."""
    dofs = trial.vessel.dofs
    if trial.controller is None and not excitation.open_loop:
        raise ConfigurationError(
            f"controller=none: excitation={trial.names['excitation']} is sailed by a controller"
        )
    named(trial, "disturbance", lambda: trial.disturbance.check(dofs, longest_s(trial)))
    excitation.check_limits(trial.vessel.limits_by_dof, trial.sample_time_s)
    evaluation = trial.evaluation
    if evaluation is not None:
        named(trial, "evaluation", lambda: evaluation.check(dofs))


def named(trial: Trial, group: str, check: Callable[[], None]) -> None:
    """Run a check; what it refuses is said with the option that was chosen of the group."""
    try:
        check()
    except ConfigurationError as error:
        name = f"{group}={trial.names[group]}"
        if str(error).startswith(name):
            raise
        raise ConfigurationError(f"{name}: {error}") from error


def longest_s(trial: Trial) -> float:
    """Time [s] of the last instant that is sailed, in the excitation or the evaluation."""
    missions = (trial.excitation, trial.evaluation)
    lengths = [one.duration_s for one in missions if isinstance(one, Mission)]
    return max(lengths) - trial.sample_time_s if lengths else 0.0


def check_periods(trial: Trial, controller: Controller) -> None:
    """Refuse a controller whose period is not a multiple of the model's it is to be built on."""
    sample_time = trial.sample_time_s
    model = trial.identifier.model_period_s(sample_time)
    if model is None or not controller.takes_state_space:
        return
    own = controller.command_rows(sample_time) * sample_time
    times = round(own / model)
    if times < 1 or abs(times * model - own) > 1e-9 * own:
        raise ConfigurationError(
            f"controller.period_s: got {own:g} s, expected a multiple of identifier.period_s, "
            f"{model:g} s: a state-space model holds at its own sample time"
        )


def run(trial: Trial) -> Results:
    """Run a trial that `check` accepts; raises TrialDiverged with the results that still hold."""
    seeds = streams(trial.seed)
    excited = excite(trial, seeds)
    problem = Problem(
        training=excited.recording.part(excited.training),
        validation=excited.recording.part(excited.testing),
        nominal=trial.vessel.nominal(),
        thruster=trial.vessel.thruster,
    )
    identified = trial.identifier.identify(problem, np.random.default_rng(seeds.identifier))
    validation = validation_metrics.validation(
        problem.validation, problem.nominal, identified, excited.truth
    )
    predicted, reasons = validation_metrics.prediction_metrics(problem, identified, excited.truth)
    for reason in reasons:
        log.warning("prediction: %s", reason.label)
    models = {"nominal": problem.nominal, "identified": identified.model}
    if excited.truth is not None:
        models["plant"] = excited.truth
    own = own_metrics.validation_rows(trial.metrics, problem.validation, models)
    mixed = excitation_results.mix_results(trial.excitation, excited)
    results = Results(
        metrics=[*validation, *predicted, *unreached(excited), *mixed.metrics, *own],
        coefficients=[
            *coefficient_rows.coefficients(problem.nominal, identified, excited.truth),
            *coefficient_rows.table_coefficients(numbered("stage", identified.stages)),
            *coefficient_rows.state_space_coefficients(identified),
        ],
        diagnostics=[
            *identified.findings,
            *reasons,
            *excitation_report(problem, excited.recording),
            *mixed.diagnostics,
        ],
        series=[
            time_series.recording_series(excited.recording, excited.training, excited.sailed),
            time_series.residual_series(excited, problem.nominal, identified),
            *mixed.series,
        ],
        note=skipped(trial),
    )
    if isinstance(trial.excitation, Reader):
        results = with_quality(results, trial.excitation, excited.recording)
    return results if results.note else deploy(trial, seeds, problem.nominal, identified, results)


def with_quality(results: Results, file: Reader, recording: Recording) -> Results:
    """The results of a measured recording, with its statistics and quality checks."""
    metrics, series = excitation_results.recording_quality(recording)
    found = [
        *excitation_results.column_statistics(file),
        *excitation_results.outlier_counts(file, recording.dofs),
    ]
    return replace(
        results,
        metrics=[*results.metrics, *metrics],
        diagnostics=[*results.diagnostics, *found],
        series=[*results.series, series],
    )


def excitation_report(problem: Problem, whole: Recording) -> list[Finding]:
    """Whether the training data tell the nominal model's terms apart; a warning where not."""
    reports = persistence(problem.training, problem.nominal, whole)
    for warning in filter(None, (one.warning() for one in reports)):
        log.warning("excitation: %s", warning)
    return excitation_results.excitation_report(reports)


def unreached(excited: Excited) -> list[Metric]:
    """How often the thrusters could not give what the excitation asked for; a warning where so."""
    if excited.sailed is None:
        return []
    found = deployment_metrics.unreached(excited.sailed.voyage, "identification", "plant")
    for share in (one.value for one in found if one.value):
        log.warning("excitation: %s", deployment_metrics.UNREACHED.format(share))
    return found


def skipped(trial: Trial) -> str | None:
    """Why a trial has no deployment, or None when it has one."""
    if isinstance(trial.excitation, Reader):
        return MEASURED
    if trial.controller is None:
        return NOT_DEPLOYED.format("controller")
    if trial.evaluation is None:
        return NOT_DEPLOYED.format("evaluation")
    return trial.evaluation.skip_reason(trial.excitation)


def excite(trial: Trial, seeds: Streams) -> Excited:
    """Sail the excitation with the nominal model, or read the recorded file."""
    vessel = trial.vessel
    if isinstance(trial.excitation, Reader):
        recording, truth, voyage = trial.excitation.read(vessel.dofs), None, None
    else:
        model = vessel.nominal()
        voyage = sailed_excitation(prepare(trial, seeds, model, trial.excitation))
        recording = recording_of(voyage.voyage, voyage.voyage.weather)
        truth = trial.plant_scale * model + trial.disturbance.table(vessel.dofs)
    split = trial.excitation.split(recording.t)
    recording = recording.with_thruster(vessel.thruster)
    return Excited(recording, split.train, split.test, truth, voyage)


def sailed_excitation(prepared: Prepared) -> Sailed:
    """The excitation sailed; what the controller's design shows to be wrong is said first."""
    design = prepared.design
    for warning in deployment_metrics.design_warnings(design, "nominal"):
        log.warning("excitation: %s", warning)
    try:
        return prepared.sail()
    except Diverged as error:
        rest = Results(
            deployment_metrics.design_metrics(design, "nominal"),
            diagnostics=deployment_metrics.design_findings(design, "nominal"),
        )
        raise TrialDiverged(error, rest) from error


def controlled(controller: Controller, identified: Identified) -> Vessel | StateSpace:
    """The identified model in the form that the controller takes."""
    linear = identified.control_model if controller.takes_state_space else None
    return identified.model if linear is None else linear


def deploy(
    trial: Trial, seeds: Streams, nominal: Vessel, identified: Identified, results: Results
) -> Results:
    """Sail the evaluation with the nominal and with the identified model, in the same weather."""
    controller, evaluation, excitation = trial.controller, trial.evaluation, trial.excitation
    assert controller is not None
    assert evaluation is not None
    assert isinstance(excitation, Mission)
    mission = evaluation.mission(excitation)
    metrics, series = list(results.metrics), list(results.series)
    diagnostics = list(results.diagnostics)
    failure: Diverged | None = None
    coefficients = list(results.coefficients)
    models: dict[str, Vessel | StateSpace] = {
        "nominal": nominal,
        "identified": controlled(controller, identified),
    }
    if trial.update is not None:
        models["adaptive"] = nominal
    for name, model in models.items():
        prepared = prepare(trial, seeds, model, mission, deployed=True)
        for warning in deployment_metrics.design_warnings(prepared.design, name):
            log.warning(warning)
        metrics += deployment_metrics.design_metrics(prepared.design, name)
        diagnostics += deployment_metrics.design_findings(prepared.design, name)
        try:
            one = prepared.sail(adaptive=name == "adaptive")
        except Diverged as error:
            failure = Diverged(f"{name} model: {error}", error.time_s, error.quantity)
            continue
        metrics += deployment_metrics.tracking_metrics(one.voyage, name, trial.sample_time_s)
        metrics += deployment_metrics.response_metrics(one, name)
        metrics += own_metrics.deployment_rows(trial.metrics, one.voyage, name)
        series.append(time_series.voyage_series(one, name))
        if one.adapter is not None:
            versions = numbered("adaptive", (model for _, model, _ in one.adapter.versions))
            coefficients += coefficient_rows.table_coefficients(versions)
            diagnostics += one.adapter.findings()
        lost = deployment_metrics.losses(one, name)
        diagnostics += deployment_metrics.warning_rows(lost)
        for warning in lost:
            log.warning(warning)
    complete = Results(metrics, coefficients, diagnostics, series, note=results.note)
    if failure is not None:
        raise TrialDiverged(failure, complete)
    return complete
