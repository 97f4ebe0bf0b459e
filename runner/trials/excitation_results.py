"""Results of the excitation of a trial.

They are the identifiability of the terms from the recording, the quality of a measured
file, and the counts and the plan of a mix of manoeuvres.
"""

from collections.abc import Iterable
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.excitation.information import Persistence, log_det
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.planning.planner import PlannedPath
from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording
from seatrial.runner.record.rows import Results, Series, metric
from seatrial.runner.trials import recording_checks

if TYPE_CHECKING:
    from seatrial.runner.trials.closed_loop import ExcitationData


def of_file(file: RecordedFile, recording: Recording) -> Results:
    """The quality of a measured file, and its problems.

    The quality are the largest errors of the velocity integrated, and of the position
    differentiated.
    """
    quality = [
        metric(f"{check}_error_max", "identification", "plant", dof, float(error))
        for check, (measured, calculated) in quality_checks(recording).items()
        for dof, error in zip(
            recording.dofs, np.max(np.abs(measured - calculated), axis=0), strict=True
        )
    ]
    return Results(quality, diagnostics=recording_checks.diagnostics(file, recording.dofs))


PASSAGE = -1.0  # in the column `manoeuvre` of the series `plan`
ROLES = {"none": 0.0, "training": 1.0, "testing": 2.0}


def mix_results(mix: object, excited: "ExcitationData") -> Results:
    """Return the counts of a mix of manoeuvres and its plan; empty for any other excitation."""
    if not isinstance(mix, OptimalDesign):
        return Results()
    results = Results(diagnostics=_count_diagnostics(mix))
    return results if mix.plan is None else results + _plan_results(mix, mix.plan, excited)


def _count_diagnostics(mix: OptimalDesign) -> list[Diagnostic]:
    """Return the count of every candidate, and how close the counts are to the optimum."""
    counts = mix.counts
    value = log_det(mix.gammas, np.array(list(counts.values())))
    diagnostics = [
        Diagnostic("mix_count", "all", float(n), i=i, label=name)
        for i, (name, n) in enumerate(counts.items())
    ]
    if np.isfinite(value):
        diagnostics.append(Diagnostic("mix_log_det", "all", value))
    if mix.design == "optimal":
        shares, gap = mix.weights
        diagnostics += [
            Diagnostic("mix_share", "all", float(share), i=i, label=name)
            for i, name, share in zip(count(), counts, shares, strict=False)
        ]
        best = log_det(mix.gammas, shares)
        diagnostics.append(Diagnostic("mix_gap", "all", gap))
        diagnostics.append(Diagnostic("mix_log_det_optimal", "all", best))
    return diagnostics


def _plan_results(mix: OptimalDesign, plan: PlannedPath, excited: "ExcitationData") -> Results:
    """Return the planned poses, the waters, and how closely the vessel followed the plan.

    The series `plan` has the manoeuvre between each pose and the next, the series `waters` the
    corners of the area (polygon 0) and of the obstacles, and the clearance.
    """
    waters, poses, names = mix.route.waters, plan.poses, list(mix.candidates)
    parts = mix.schedule.phases
    numbers = [PASSAGE if p.kind == "passage" else float(names.index(p.name)) for p in parts]
    lengths, roles = [part.count for part in parts], [ROLES[part.role] for part in parts]
    path = {
        "t": mix.period_s * np.arange(len(poses), dtype=np.float64),
        **dict(zip(("x", "y", "psi"), poses.T, strict=False)),
        "manoeuvre": np.append(np.repeat(numbers, lengths), PASSAGE),
        "role": np.append(np.repeat(roles, lengths), 0.0),
    }
    units = {"t": "s", "x": "m", "y": "m", "psi": "rad", "manoeuvre": "", "role": ""}
    polygons = list(waters.named.values())
    corners = np.array([corner for polygon in polygons for corner in polygon], dtype=np.float64)
    area = {
        "polygon": np.repeat(np.arange(len(polygons), dtype=np.float64), [*map(len, polygons)]),
        "x": corners[:, 0],
        "y": corners[:, 1],
        "clearance": np.full(len(corners), mix.route.clearance_m),
    }
    area_units = {"polygon": "", "x": "m", "y": "m", "clearance": "m"}
    sailed = excited.recording.eta[:, :2]
    off = np.max(np.hypot(*(sailed - poses[: len(sailed), :2]).T))
    return Results(
        diagnostics=[
            Diagnostic("plan_duration", "all", (len(poses) - 1) * mix.period_s, "s"),
            Diagnostic("plan_clearance", "all", float(np.min(waters.distance(poses[:, :2]))), "m"),
            Diagnostic("plan_deviation", "all", float(off), "m"),
            Diagnostic("sailed_clearance", "all", float(np.min(waters.distance(sailed))), "m"),
        ],
        series=[Series("plan", path, units), Series("waters", area, area_units)],
    )


def excitation_report(reports: Iterable[Persistence]) -> list[Diagnostic]:
    """Return how well the training data distinguish the terms of the nominal model."""
    diagnostics = []
    for report in reports:
        numbers = {
            "regressor_condition": report.condition,
            "regressor_rank": float(report.rank),
            "regressor_unknowns": float(len(report.terms)),
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
