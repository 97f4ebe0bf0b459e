"""Results of a docking: contacts, clearance, errors in the berth, and the harbour."""

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.excitation.docking import Docking
from seatrial.models.planning.harbour import clearances, contacts
from seatrial.models.simulation import metrics as measure
from seatrial.runner.record.rows import Results, Series, metrics
from seatrial.runner.trials.closed_loop import SimulatedMission

TOLERANCE = 1e-3  # of contacts and of the smallest clearance [L]


def berthing_results(mission: object, sailed: SimulatedMission, model: str) -> Results:
    """Return the metrics of a docking, of the true pose, with its harbour; nothing for others.

    A vessel that is not in its berth at the end has no time to it. The series of the harbour has
    corners: polygon 0 is the hull in body axes, the others are convex parts of the land, NED.
    """
    if not isinstance(mission, Docking):
        return Results()
    [(name, place)], log, limits = mission.harbours.items(), sailed.voyage.log, sailed.design.limits
    length = mission.vessel.scales.length_m
    clearance = clearances(place.land, mission.hull, log.eta, TOLERANCE * length)[1]
    target = np.broadcast_to(mission.poses[-1], log.eta.shape)
    off = measure.position_error(target, log.eta) / length
    turned = np.degrees(np.abs(measure.heading_error(target, log.eta)))
    outside = (off > mission.within) | (turned > mission.within_deg)
    entered = int(np.max(np.flatnonzero(outside), initial=-1)) + 1
    values: dict[str, object] = {
        "contacts": contacts(clearance),
        "smallest_clearance": np.min(clearance) / length,
        "final_position_error": {"position": off[-1]},
        "final_heading_error": {"heading": turned[-1]},
        "time_to_berth": entered * sailed.period_s if entered < len(off) else np.nan,
    }
    if limits is not None:
        at_limit = np.abs(log.tau) >= np.array(limits) * (1.0 - 1e-9)
        values["saturated_share"] = np.mean(np.any(at_limit, axis=1))
    polygons = [mission.hull, *place.parts]
    x, y = np.vstack(polygons).T
    numbers = np.repeat(np.arange(len(polygons), dtype=np.float64), [*map(len, polygons)])
    corners = {"polygon": numbers, "x": x, "y": y}
    harbour = Series("harbour", corners, {"polygon": "", "x": "m", "y": "m"})
    return Results(
        metrics("deployment", model, (), values),
        diagnostics=[Diagnostic("harbour", "all", None, label=name)],
        series=[harbour] if model == "nominal" else [],
    )
