"""What is stored of an informative mix: its counts, its simulation error, its plan."""

from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from models.errors import IdentificationError
from models.excitation.mix import Mix
from models.identification.instruments import simulated_motion
from models.identification.problem import Identified, Problem
from models.planning.planner import Plan
from models.recording import Recording
from models.vessel import Vessel
from runner.database.records import Diagnostic, Metric, Results, Series

if TYPE_CHECKING:
    from runner.trial import Excited

PASSAGE = -1.0  # in the column `manoeuvre` of the series `plan`
ROLES = {"none": 0.0, "training": 1.0, "testing": 2.0}


def results(mix: object, excited: "Excited", problem: Problem, identified: Identified) -> Results:
    """Rows of a mix; none of another excitation."""
    if not isinstance(mix, Mix):
        return Results()
    models = {"nominal": problem.nominal, "identified": identified.model}
    if excited.truth is not None:
        models["plant"] = excited.truth
    metrics = [
        Metric("validation", name, "all", "simulation_rmse", error, "")
        for name, model in models.items()
        if (error := simulation_error(problem.validation, model)) is not None
    ]
    found, plan = _mixed(mix), mix.plan
    if plan is None:
        return Results(metrics=metrics, diagnostics=found)
    return Results(
        metrics=metrics,
        diagnostics=[*found, *_planned(mix, plan, excited.recording)],
        series=[_plan_series(mix, plan), _waters_series(mix)],
    )


def simulation_error(held_out: Recording, model: Vessel) -> float | None:
    """sqrt((1/N) sum e_u^2 + e_v^2 + e_r^2) [m/s, rad/s]; Ljungberg (slides), "Results".

    Of a simulation of every manoeuvre from rest, as it begins, under the commanded force, against
    the measured velocities; None where the model cannot be simulated. (From the measured velocity
    its noise is simulated too, which a hull that does not keep its course never forgets.)
    """
    begins = np.diff(held_out.t, prepend=-np.inf) > 1.5 * held_out.period_s
    resting = replace(held_out, nu=np.where(begins[:, None], 0.0, held_out.nu))
    try:
        motion, _ = simulated_motion(resting, model, None, None)
    except IdentificationError:
        return None
    return float(np.sqrt(np.mean(np.sum((motion.nu - held_out.nu) ** 2, axis=1))))


def _finding(name: str, value: float, unit: str = "", label: str | None = None, i: int | None = None
             ) -> Diagnostic:  # fmt: skip
    return Diagnostic(name, "all", i, None, label, value, unit)


def _mixed(mix: Mix) -> list[Diagnostic]:
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


def _planned(mix: Mix, plan: Plan, recording: Recording) -> list[Diagnostic]:
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
