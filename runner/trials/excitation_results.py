"""Results of the excitation of a trial.

They are the identifiability of the terms from the recording, the statistics and quality of a
measured file, and the counts and the plan of a mix of manoeuvres.
"""

from collections.abc import Iterable
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.excitation.information import Persistence
from seatrial.models.excitation.mix import Mix
from seatrial.models.planning.planner import PlannedPath
from seatrial.models.recording.preprocessing import quality_checks
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording
from seatrial.runner.record.rows import Metric, Results, Series, metric

if TYPE_CHECKING:
    from seatrial.runner.trials.closed_loop import ExcitationData


def column_statistics(excitation: RecordedFile) -> list[Diagnostic]:
    """Compute descriptive statistics of each recorded column in the window; i is the column."""
    return [
        Diagnostic(f"statistic_{name}", "all", value, i=i, label=column)
        for i, (column, values) in enumerate(excitation.describe().items())
        for name, value in values.items()
    ]


def outlier_counts(excitation: RecordedFile, dofs: tuple[str, ...]) -> list[Diagnostic]:
    """Count the outliers of each column in use, by the outlier rule of the file."""
    counts = excitation.outlier_counts(dofs)
    return [
        Diagnostic("outliers", "all", count, i=i, label=column)
        for i, (column, count) in enumerate(counts.items())
    ]


def recording_quality(recording: Recording) -> list[Metric]:
    """Compute the largest errors of the velocity integrated, and of the position differentiated."""
    return [
        metric(f"{check.check}_error_max", "identification", "plant", check.dof, check.maximum)
        for check in quality_checks(recording)
    ]


PASSAGE = -1.0  # in the column `manoeuvre` of the series `plan`
ROLES = {"none": 0.0, "training": 1.0, "testing": 2.0}


def mix_results(mix: object, excited: "ExcitationData") -> Results:
    """Return the results of a mix of manoeuvres; empty for any other excitation."""
    if not isinstance(mix, Mix):
        return Results()
    diagnostics, plan = _count_diagnostics(mix), mix.plan
    if plan is None:
        return Results(diagnostics=diagnostics)
    return Results(
        diagnostics=[*diagnostics, *_plan_diagnostics(mix, plan, excited.recording)],
        series=[_plan_series(mix, plan), _waters_series(mix)],
    )


def _diagnostic(
    name: str, value: float, unit: str = "", label: str | None = None, i: int | None = None
) -> Diagnostic:
    return Diagnostic(name, "all", value, unit, i=i, label=label)


def _count_diagnostics(mix: Mix) -> list[Diagnostic]:
    """Return the count of every candidate, and how close the counts are to the optimum."""
    counts, design = mix.counts, mix.information
    totals = np.array(list(counts.values()), dtype=np.float64)
    diagnostics = [
        _diagnostic("mix_count", float(n), label=name, i=i)
        for i, (name, n) in enumerate(counts.items())
    ]
    if np.isfinite(design.log_det(totals)):
        diagnostics.append(_diagnostic("mix_log_det", design.log_det(totals)))
    if mix.design == "optimal":
        weights = design.weights
        diagnostics += [
            _diagnostic("mix_share", float(share), label=name, i=i)
            for i, name, share in zip(count(), counts, weights.share, strict=False)
        ]
        diagnostics.append(_diagnostic("mix_gap", weights.gap))
        diagnostics.append(_diagnostic("mix_log_det_optimal", design.log_det(weights.share)))
    return diagnostics


def _plan_diagnostics(mix: Mix, plan: PlannedPath, recording: Recording) -> list[Diagnostic]:
    """Return the duration of the plan, and how closely the vessel followed it."""
    waters = mix.route.waters
    positions, planned = recording.eta[:, :2], plan.poses[: len(recording), :2]
    return [
        _diagnostic("plan_duration", (len(plan.poses) - 1) * mix.period_s, "s"),
        _diagnostic("plan_clearance", float(np.min(waters.distance(plan.poses[:, :2]))), "m"),
        _diagnostic("plan_deviation", float(np.max(np.hypot(*(positions - planned).T))), "m"),
        _diagnostic("sailed_clearance", float(np.min(waters.distance(positions))), "m"),
    ]


def _plan_series(mix: Mix, plan: PlannedPath) -> Series:
    """Return the planned poses, with the manoeuvre between each pose and the next."""
    schedule, names = mix.schedule, list(mix.candidates)
    manoeuvres, roles = [], []
    for part in schedule.parts:
        number = PASSAGE if part.kind == "passage" else float(names.index(part.name))
        manoeuvres.append(np.full(part.count, number))
        roles.append(np.full(part.count, ROLES[part.role]))
    poses = plan.poses
    columns = {
        "t": mix.period_s * np.arange(len(poses), dtype=np.float64),
        "x": poses[:, 0],
        "y": poses[:, 1],
        "psi": poses[:, 2],
        "manoeuvre": np.concatenate([*manoeuvres, [PASSAGE]]),
        "role": np.concatenate([*roles, [0.0]]),
    }
    units = {"t": "s", "x": "m", "y": "m", "psi": "rad", "manoeuvre": "", "role": ""}
    return Series("plan", columns, units)


def _waters_series(mix: Mix) -> Series:
    """Return the corners of the area (polygon 0) and of the obstacles, and the clearance [m]."""
    polygons = list(mix.route.waters.named.values())
    corners = np.array([corner for polygon in polygons for corner in polygon], dtype=np.float64)
    numbers = np.repeat(
        np.arange(len(polygons), dtype=np.float64), [len(polygon) for polygon in polygons]
    )
    columns = {
        "polygon": numbers,
        "x": corners[:, 0],
        "y": corners[:, 1],
        "clearance": np.full(len(corners), mix.route.clearance_m),
    }
    return Series("waters", columns, {"polygon": "", "x": "m", "y": "m", "clearance": "m"})


def excitation_report(reports: Iterable[Persistence]) -> list[Diagnostic]:
    """Return how well the training data distinguish the terms of the nominal model."""
    diagnostics = []
    for report in reports:
        numbers = {
            "regressor_condition": report.condition,
            "regressor_rank": float(report.rank),
            "regressor_unknowns": float(report.unknowns),
            "spectral_lines": float(report.lines),
        }
        diagnostics += [
            Diagnostic(name, report.dof, number)
            for name, number in numbers.items()
            if np.isfinite(number)
        ]
        groups = [(name,) for name in report.unexcited] + list(report.inseparable)
        diagnostics += [
            Diagnostic(
                "inseparable_terms", report.dof, 1.0 * len(group), i=i, label=" ".join(group)
            )
            for i, group in enumerate(groups)
        ]
    return diagnostics
