"""What is stored of the excitation of a trial.

Whether its recording tells the terms apart, the statistics and quality of a measured file, the
counts and the plan of a mix of manoeuvres."""

from collections.abc import Iterable
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.excitation.information import Persistence
from seatrial.models.excitation.mix import Mix
from seatrial.models.findings import Finding
from seatrial.models.planning.planner import Plan
from seatrial.models.recording.preprocessing import quality_checks, quality_series
from seatrial.models.recording.readers import Reader
from seatrial.models.recording.recording import Recording
from seatrial.runner.database.records import Metric, Results, Series
from seatrial.runner.record.metric_rows import metric

if TYPE_CHECKING:
    from seatrial.runner.closed_loop import Excited


STATISTICS = ("count", "mean", "std", "median", "minimum", "maximum")


def column_statistics(excitation: Reader) -> list[Finding]:
    """Descriptive statistics of the file's columns in the window, as recorded; i is the column."""
    return [
        Finding(f"statistic_{name}", "all", getattr(column, name), i=i, label=column.name)
        for i, column in enumerate(excitation.describe())
        for name in STATISTICS
    ]


def outlier_counts(excitation: Reader, dofs: tuple[str, ...]) -> list[Finding]:
    """How many samples of each column in use the file's outlier rule names."""
    counts = excitation.outlier_counts(dofs)
    return [
        Finding("outliers", "all", count, i=i, label=column)
        for i, (column, count) in enumerate(counts.items())
    ]


def recording_quality(recording: Recording) -> tuple[list[Metric], Series]:
    """Largest error of velocity against position, both ways, and the errors over time."""
    checks = quality_checks(recording)
    metrics = [
        metric(f"{one.check}_error_max", "identification", "plant", one.dof, one.maximum)
        for one in checks
    ]
    columns, units = quality_series(checks)
    return metrics, Series("quality", {"t": recording.t, **columns}, {"t": "s", **units})


PASSAGE = -1.0  # in the column `manoeuvre` of the series `plan`
ROLES = {"none": 0.0, "training": 1.0, "testing": 2.0}


def mix_results(mix: object, excited: "Excited") -> Results:
    """Rows of a mix; none of another excitation."""
    if not isinstance(mix, Mix):
        return Results()
    found, plan = _mixed(mix), mix.plan
    if plan is None:
        return Results(diagnostics=found)
    return Results(
        diagnostics=[*found, *_planned(mix, plan, excited.recording)],
        series=[_plan_series(mix, plan), _waters_series(mix)],
    )


def _finding(name: str, value: float, unit: str = "", label: str | None = None, i: int | None = None
             ) -> Finding:  # fmt: skip
    return Finding(name, "all", value, unit, i=i, label=label)


def _mixed(mix: Mix) -> list[Finding]:
    """How many of every candidate, and how close to the optimum they are."""
    counts, design = mix.counts, mix.information
    whole = np.array(list(counts.values()), dtype=np.float64)
    found = [
        _finding("mix_count", float(n), label=name, i=i)
        for i, (name, n) in enumerate(counts.items())
    ]
    if np.isfinite(design.log_det(whole)):
        found.append(_finding("mix_log_det", design.log_det(whole)))
    if mix.design == "optimal":
        weights = design.weights
        found += [
            _finding("mix_share", float(share), label=name, i=i)
            for i, name, share in zip(count(), counts, weights.share, strict=False)
        ]
        found.append(_finding("mix_gap", weights.gap))
        found.append(_finding("mix_log_det_optimal", design.log_det(weights.share)))
    return found


def _planned(mix: Mix, plan: Plan, recording: Recording) -> list[Finding]:
    """Length of the plan, and how the vessel kept to it."""
    waters = mix.route.waters
    sailed, meant = recording.eta[:, :2], plan.poses[: len(recording), :2]
    return [
        _finding("plan_duration", (len(plan.poses) - 1) * mix.period_s, "s"),
        _finding("plan_clearance", float(np.min(waters.distance(plan.poses[:, :2]))), "m"),
        _finding("plan_deviation", float(np.max(np.hypot(*(sailed - meant).T))), "m"),
        _finding("sailed_clearance", float(np.min(waters.distance(sailed))), "m"),
    ]


def _plan_series(mix: Mix, plan: Plan) -> Series:
    """The planned poses, with what is sailed from each to the next."""
    schedule, names = mix.schedule, list(mix.candidates)
    what, role = [], []
    for part in schedule.parts:
        number = PASSAGE if part.kind == "passage" else float(names.index(part.name))
        what.append(np.full(part.count, number))
        role.append(np.full(part.count, ROLES[part.role]))
    poses = plan.poses
    columns = {
        "t": mix.period_s * np.arange(len(poses), dtype=np.float64),
        "x": poses[:, 0],
        "y": poses[:, 1],
        "psi": poses[:, 2],
        "manoeuvre": np.concatenate([*what, [PASSAGE]]),
        "role": np.concatenate([*role, [0.0]]),
    }
    units = {"t": "s", "x": "m", "y": "m", "psi": "rad", "manoeuvre": "", "role": ""}
    return Series("plan", columns, units)


def _waters_series(mix: Mix) -> Series:
    """Corners of the area (polygon 0) and of the obstacles, and the clearance kept from them."""
    polygons = list(mix.route.waters.named.values())
    corners = np.array([corner for one in polygons for corner in one], dtype=np.float64)
    numbers = np.repeat(np.arange(len(polygons), dtype=np.float64), [len(one) for one in polygons])
    columns = {
        "polygon": numbers,
        "x": corners[:, 0],
        "y": corners[:, 1],
        "clearance": np.full(len(corners), mix.route.clearance_m),
    }
    return Series("waters", columns, {"polygon": "", "x": "m", "y": "m", "clearance": "m"})


def excitation_report(reports: Iterable[Persistence]) -> list[Finding]:
    """What the training data can tell apart of the nominal model's terms."""
    found = []
    for one in reports:
        numbers = {
            "regressor_condition": one.condition,
            "regressor_rank": float(one.rank),
            "regressor_unknowns": float(one.unknowns),
            "spectral_lines": float(one.lines),
        }
        found += [
            Finding(name, one.dof, number)
            for name, number in numbers.items()
            if np.isfinite(number)
        ]
        groups = [(name,) for name in one.unexcited] + list(one.inseparable)
        found += [
            Finding("inseparable_terms", one.dof, 1.0 * len(group), i=i, label=" ".join(group))
            for i, group in enumerate(groups)
        ]
    return found
