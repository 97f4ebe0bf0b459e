"""Results of a docking: contacts, clearance, errors in the berth, and the harbour."""

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.excitation.docking import DrawnDocking
from seatrial.models.planning import harbour as geometry
from seatrial.models.simulation import metrics as measure
from seatrial.runner.record.rows import Metric, Results, Series, metric
from seatrial.runner.trials.closed_loop import SimulatedMission

TOLERANCE = 1e-3  # of contacts and of the smallest clearance [L]


def berthing_results(mission: object, sailed: SimulatedMission, model: str) -> Results:
    """Return the metrics of a docking, of the true pose, with its harbour; nothing for others."""
    if not isinstance(mission, DrawnDocking):
        return Results()
    return Results(
        berthing_metrics(mission, sailed, model),
        diagnostics=[Diagnostic("harbour", "all", None, label=mission.name)],
        series=[harbour_series(mission)] if model == "nominal" else [],
    )


def berthing_metrics(mission: DrawnDocking, sailed: SimulatedMission, model: str) -> list[Metric]:
    """Compute the metrics; a vessel that is not in its berth at the end has no time to it."""
    docking, log, limits = mission.options, sailed.voyage.log, sailed.design.limits
    land, length = mission.harbour.land, docking.length_m
    clearance = geometry.clearances(land, docking.hull, log.eta, TOLERANCE * length)[1]
    target = np.broadcast_to(mission.poses[-1], log.eta.shape)
    off = measure.position_error(target, log.eta) / length
    turned = np.degrees(np.abs(measure.heading_error(target, log.eta)))
    outside = np.flatnonzero((off > docking.within) | (turned > docking.within_deg))
    entered = 0 if not len(outside) else int(outside[-1]) + 1
    values = {
        "contacts": ("all", geometry.contacts(clearance)),
        "smallest_clearance": ("all", np.min(clearance) / length),
        "final_position_error": ("position", off[-1]),
        "final_heading_error": ("heading", turned[-1]),
        "time_to_berth": ("all", entered * sailed.period_s if entered < len(off) else np.nan),
    }
    if limits is not None:
        at_limit = np.abs(log.tau) >= np.array(limits) * (1.0 - 1e-9)
        values["saturated_share"] = "all", np.mean(np.any(at_limit, axis=1))
    return [metric(name, "deployment", model, dof, value) for name, (dof, value) in values.items()]


def harbour_series(mission: DrawnDocking) -> Series:
    """Return corners: polygon 0 is the hull in body axes, the others are parts of the land, NED."""
    polygons = [mission.options.hull, *mission.obstacles]
    corners = np.vstack(polygons)
    numbers = np.repeat(np.arange(len(polygons), dtype=np.float64), list(map(len, polygons)))
    columns = {"polygon": numbers, "x": corners[:, 0], "y": corners[:, 1]}
    return Series("harbour", columns, {"polygon": "", "x": "m", "y": "m"})
