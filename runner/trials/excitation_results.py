"""Results of the excitation of a trial: what its data tell, and what was out of reach.

They are the identifiability of the terms from the recording, the quality of a measured file, and
the counts and the plan of a mix of manoeuvres.
"""

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.excitation.information import Persistence, persistence
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.identification.problem import Problem
from seatrial.models.planning.planner import PlannedPath
from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices import validity
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.rows import Results, Series, metrics
from seatrial.runner.trials import recording_checks
from seatrial.runner.trials.closed_loop import ExcitationData, warn
from seatrial.runner.trials.deployment_metrics import UNREACHED, unreached
from seatrial.runner.trials.time_series import recording_series

PASSAGE = -1.0  # in the column `manoeuvre` of the series `plan`
ROLES = {"none": 0.0, "training": 1.0, "testing": 2.0}


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
        excesses = validity.excesses(devices, x, recording.period_s)
        warn("excitation: {}", [*validity.doubts(devices, x), *(each.text for each in excesses)])
        diagnostics += [
            Diagnostic("outside", "all", each.seconds, "s", label=each.text) for each in excesses
        ]
    values: dict[str, object] = {}
    if excited.sailed is not None and (share := unreached(excited.sailed.voyage)) is not None:
        values["unreached_share"] = share
        warn(f"excitation: {UNREACHED}", filter(None, [share]))
    if isinstance(excitation, RecordedFile):
        for check, (measured, calculated) in quality_checks(recording).items():
            values[f"{check}_error_max"] = np.max(np.abs(measured - calculated), axis=0)
        diagnostics += recording_checks.diagnostics(excitation, recording.dofs)
    series = [recording_series(excited)]
    if isinstance(excitation, OptimalDesign):
        diagnostics += _counts(excitation)
        if excitation.plan is not None:
            sailed = recording.eta[:, :2]
            diagnostics += _clearances(excitation, excitation.plan.poses[:, :2], sailed)
            series += _plan(excitation, excitation.plan)
    rows = metrics("identification", "plant", recording.dofs, values)
    return Results(rows, diagnostics=diagnostics, series=series)


def _identifiability(report: Persistence) -> list[Diagnostic]:
    """Return how well the training data distinguish the terms of the nominal model in one axis."""
    numbers = {
        "regressor_condition": report.condition,
        "regressor_rank": float(report.rank),
        "regressor_unknowns": float(report.unknowns),
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
    log_det = mix.log_det(np.array(list(counts.values()), dtype=np.float64))
    numbers = {"mix_log_det": log_det} if np.isfinite(log_det) else {}
    columns = {"mix_count": list(counts.values())}
    if mix.design == "optimal":
        weights = mix.weights
        columns["mix_share"] = weights.share.tolist()
        numbers["mix_gap"] = weights.gap
        numbers["mix_log_det_optimal"] = mix.log_det(weights.share)
    return [
        *(Diagnostic(name, "all", float(n), i=i, label=candidate)
          for name, column in columns.items()
          for i, (candidate, n) in enumerate(zip(counts, column, strict=False))),
        *(Diagnostic(name, "all", number) for name, number in numbers.items()),
    ]  # fmt: skip


def _clearances(mix: OptimalDesign, planned: Array, sailed: Array) -> list[Diagnostic]:
    """Return how long a plan takes, and how closely the vessel followed its positions (N, 2)."""
    waters = mix.route.waters
    off = np.max(np.hypot(*(sailed - planned[: len(sailed)]).T))
    lengths = {
        "plan_clearance": np.min(waters.distance(planned)),
        "plan_deviation": off,
        "sailed_clearance": np.min(waters.distance(sailed)),
    }
    return [
        Diagnostic("plan_duration", "all", (len(planned) - 1) * mix.period_s, "s"),
        *(Diagnostic(name, "all", float(length), "m") for name, length in lengths.items()),
    ]


def _plan(mix: OptimalDesign, plan: PlannedPath) -> list[Series]:
    """Return the planned poses and the waters.

    The series `plan` has the manoeuvre between each pose and the next, the series `waters` the
    corners of the area (polygon 0) and of the obstacles, and the clearance.
    """
    poses, names, parts = plan.poses, list(mix.candidates), mix.schedule.phases
    numbers = [PASSAGE if p.kind == "passage" else float(names.index(p.name)) for p in parts]
    lengths, roles = [part.count for part in parts], [ROLES[part.role] for part in parts]
    path = {
        "t": mix.period_s * np.arange(len(poses), dtype=np.float64),
        **dict(zip(("x", "y", "psi"), poses.T, strict=False)),
        "manoeuvre": np.append(np.repeat(numbers, lengths), PASSAGE),
        "role": np.append(np.repeat(roles, lengths), 0.0),
    }
    polygons = list(mix.route.waters.named.values())
    corners = np.array([corner for polygon in polygons for corner in polygon], dtype=np.float64)
    area = {
        "polygon": np.repeat(np.arange(len(polygons), dtype=np.float64), [*map(len, polygons)]),
        "x": corners[:, 0],
        "y": corners[:, 1],
        "clearance": np.full(len(corners), mix.route.clearance_m),
    }
    units = {"t": "s", "x": "m", "y": "m", "psi": "rad", "clearance": "m"}
    return [
        Series(kind, columns, {name: units.get(name, "") for name in columns})
        for kind, columns in (("plan", path), ("waters", area))
    ]
