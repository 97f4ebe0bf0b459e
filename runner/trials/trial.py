"""A trial: excite -> identify -> validate -> deploy; each stage returns results, which add up.

The seed of the trial spawns independent random streams for the excitation, the measurement noise,
the disturbance and the identifier. The weather does not depend on the identifier or the controller.
So all methods are compared in the same weather, and the nominal and the identified model in pairs.
"""

import logging
from dataclasses import replace
from time import perf_counter

import numpy as np

from seatrial.models.diagnostics import TRAINING_TIME, Diagnostic, nominal_equations
from seatrial.models.errors import Diverged
from seatrial.models.excitation.information import Persistence, log_det, persistence
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.identification.auto import identified as protected
from seatrial.models.identification.calibration import NO_MODEL_ERROR, calibrated
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import Identified, Problem, lack_of_fit, with_interval
from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.device import doubts, excesses
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.coefficient_rows import coefficients
from seatrial.runner.record.rows import Results, Series, metrics
from seatrial.runner.record.vocabulary import UNPHYSICAL
from seatrial.runner.trials import recording_checks
from seatrial.runner.trials.checks import check as check
from seatrial.runner.trials.checks import measured
from seatrial.runner.trials.checks import skipped as skipped
from seatrial.runner.trials.closed_loop import (
    ExcitationData,
    SeriesColumns,
    Streams,
    drawn,
    prepare,
    recording_series,
    warn,
)
from seatrial.runner.trials.closed_loop import TrialDiverged as TrialDiverged
from seatrial.runner.trials.deployment_metrics import UNREACHED, deploy, of_design, unreached
from seatrial.runner.trials.validation_metrics import validate

log = logging.getLogger(__name__)
PASSAGE = -1.0  # in the column `manoeuvre` of the series `plan`
ROLES = {"none": 0.0, "training": 1.0, "testing": 2.0}


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


def of_excitation(trial: Trial, problem: Problem, excited: ExcitationData) -> Results:
    """The data: how well they tell the terms apart, what was out of reach, a file's quality.

    The quality of a file are the largest errors of the velocity integrated, and of the position
    differentiated.
    """
    recording, excitation, devices = excited.recording, trial.excitation, problem.nominal.devices
    reports = persistence(problem.training, problem.nominal, recording)
    warn("excitation: {}", filter(None, (report.warning() for report in reports)))
    diagnostics = [row for report in reports for row in _identifiability(report)]
    if devices and recording.inputs is not None:  # how long [s] they were outside of their data
        x = recording.variables()
        found = excesses(devices, x, recording.period_s)
        warn("excitation: {}", [*doubts(devices, x), *(each.text for each in found)])
        diagnostics += [
            Diagnostic("outside", "all", each.seconds, "s", label=each.text) for each in found
        ]
    values: dict[str, object] = {}
    if excited.sailed is not None and (share := unreached(excited.sailed.voyage)) is not None:
        values["unreached_share"] = share
        warn("excitation: {}", [UNREACHED.format(share)] if share else [])
    if isinstance(excitation, RecordedFile):
        for check, (measured, calculated) in quality_checks(recording).items():
            values[f"{check}_error_max"] = np.max(np.abs(measured - calculated), axis=0)
        diagnostics += recording_checks.diagnostics(excitation, trial.vessel)
    rows = metrics("identification", "plant", recording.dofs, values)
    results = Results(rows, diagnostics=diagnostics, series=[recording_series(excited)])
    if isinstance(excitation, OptimalDesign):
        results += Results(diagnostics=_counts(excitation))
        if excitation.plan is not None:
            results += _plan(excitation, excitation.plan.poses, recording.eta)
    return results


def _identifiability(report: Persistence) -> list[Diagnostic]:
    """Return how well the training data distinguish the terms of the nominal model in one axis."""
    numbers = {
        "regressor_condition": report.condition,
        "regressor_rank": float(report.rank),
        "regressor_unknowns": float(len(report.terms)),
        "spectral_lines": float(report.lines),
    }
    groups = [(name,) for name in report.unexcited] + list(report.inseparable)
    return [
        *(Diagnostic(name, report.dof, n) for name, n in numbers.items() if np.isfinite(n)),
        *(Diagnostic("inseparable_terms", report.dof, 1.0 * len(group), i=i, label=" ".join(group))
          for i, group in enumerate(groups)),
    ]  # fmt: skip


def _counts(mix: OptimalDesign) -> list[Diagnostic]:
    """Return the count of every candidate, and how close the counts are to the optimum."""
    counts = mix.counts
    value = log_det(mix.gammas, np.array(list(counts.values())))
    numbers = {"mix_log_det": value} if np.isfinite(value) else {}
    columns = {"mix_count": list(counts.values())}
    if mix.design == "optimal":
        shares, gap = mix.weights
        columns["mix_share"] = shares.tolist()
        numbers["mix_gap"] = gap
        numbers["mix_log_det_optimal"] = log_det(mix.gammas, shares)
    return [
        *(Diagnostic(name, "all", float(n), i=i, label=candidate)
          for name, column in columns.items()
          for i, (candidate, n) in enumerate(zip(counts, column, strict=False))),
        *(Diagnostic(name, "all", number) for name, number in numbers.items()),
    ]  # fmt: skip


def _plan(mix: OptimalDesign, poses: Array, sailed: Array) -> Results:
    """Return the planned poses (N, 3), the waters, and how closely the vessel followed the plan.

    The series `plan` has the manoeuvre between each pose and the next, the series `waters` the
    corners of the area (polygon 0) and of the obstacles, and the clearance.
    """
    waters, names, parts = mix.route.waters, list(mix.candidates), mix.schedule.phases
    numbers = [PASSAGE if p.kind == "passage" else float(names.index(p.name)) for p in parts]
    lengths, roles = [part.count for part in parts], [ROLES[part.role] for part in parts]
    path = {
        "t": mix.period_s * np.arange(len(poses), dtype=np.float64),
        **dict(zip(("x", "y", "psi"), poses.T, strict=False)),
        "manoeuvre": np.append(np.repeat(numbers, lengths), PASSAGE),
        "role": np.append(np.repeat(roles, lengths), 0.0),
    }
    polygons = [np.array(corners, dtype=np.float64) for corners in waters.named.values()]
    x, y = np.vstack(polygons).T
    polygon = np.repeat(np.arange(1.0 * len(polygons)), [*map(len, polygons)])
    area = {"polygon": polygon, "x": x, "y": y, "clearance": np.full(len(x), mix.route.clearance_m)}
    units = {"t": "s", "x": "m", "y": "m", "psi": "rad", "clearance": "m"}
    planned, followed = poses[:, :2], sailed[:, :2]
    distances = {
        "plan_clearance": np.min(waters.distance(planned)),
        "plan_deviation": np.max(np.hypot(*(followed - planned[: len(sailed)]).T)),
        "sailed_clearance": np.min(waters.distance(followed)),
    }
    return Results(
        diagnostics=[
            Diagnostic("plan_duration", "all", (len(poses) - 1) * mix.period_s, "s"),
            *(Diagnostic(name, "all", float(d), "m") for name, d in distances.items()),
        ],
        series=[
            Series(kind, columns, {name: units.get(name, "") for name in columns})
            for kind, columns in (("plan", path), ("waters", area))
        ],
    )


def identify(trial: Trial, problem: Problem, seeds: Streams) -> Identified:
    """Identify the model; a diagnostic says what of it is physically impossible."""
    identifier, rng = trial.identifier, seeds.generator("identifier")
    began = perf_counter()
    result = protected(identifier, problem, rng)
    seconds = Diagnostic(TRAINING_TIME, "all", perf_counter() - began, "s")
    if trial.model_error:
        result = calibrated(identifier, problem, result)
    result = with_interval(identifier, replace(result, diagnostics=(*result.diagnostics, seconds)))
    for note in filter(None, (*result.notes, nominal_equations(result.diagnostics))):
        log.info("identification: %s", note)
    warn("identification: {}", result.warnings)
    unknown = [one.label for one in result.diagnostics if one.name == NO_MODEL_ERROR]
    warn("intervals do not include the model error: {}", unknown)
    if (flaw := unphysical(result.model, problem.nominal, problem.training.nu)) is None:
        return result
    diagnostic = Diagnostic(UNPHYSICAL, "all", 1.0, label=flaw)
    return replace(result, diagnostics=(*result.diagnostics, diagnostic))


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
