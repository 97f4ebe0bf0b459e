"""Measures of standard manoeuvres in the files that are tested on, measured and predicted.

The findings `recorded_manoeuvre_QUANTITY`, such as `recorded_manoeuvre_tactical_diameter`, have
the file as i and as j one of `COMPARED`. The interval holds 90 % of the predictions by models drawn
from the spread of what was identified, by its covariance or a bootstrap. All have the
recorded helm, also in a zig-zag.
"""

import logging
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError, RecordingError
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.validation import prediction
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_measures import Track
from seatrial.models.simulation.manoeuvre_sheet import (
    COMPARED,
    FINDING,
    intervals,
    sheet,
    track_of,
)
from seatrial.models.vessel.table import Vessel

log = logging.getLogger(__name__)
HELM = "delta"
DRAWS = 100  # models of an interval


def manoeuvres(problem: Problem, identified: Identified, length_m: float | None) -> list[Finding]:
    """Measure the manoeuvre of each file that is tested on; none for a vessel without a rudder.

    A file that holds no manoeuvre has no findings.
    """
    known = {"surge", "sway", "yaw"} <= set(problem.nominal.dofs)
    if length_m is None or HELM not in problem.nominal.inputs or not known:
        return []
    findings: list[Finding] = []
    parts = problem.validation.by_file() or {_name(problem.validation): problem.validation}
    for i, (name, part) in enumerate(parts.items()):
        try:
            findings.extend(_of_file(i, name, part, problem, identified, length_m))
        except (RecordingError, ConfigurationError) as error:
            log.debug("%s: no manoeuvre: %s", name, error)
    return findings


def _name(recording: Recording) -> str:
    """The name of the only file of a recording; empty if it is not known."""
    return "" if recording.file is None else recording.file_names[int(recording.file[0])]


def _of_file(
    i: int, name: str, part: Recording, problem: Problem, identified: Identified, length_m: float
) -> Iterator[Finding]:
    sail = partial(_predicted, part=part, problem=problem, length_m=length_m)
    measured = sheet(track_of(part, HELM, length_m))
    models = (problem.nominal, identified.model)
    tracks = [sail(model) for model in models]
    own = [sheet(track, measured.manoeuvre).entries if track else () for track in tracks]
    drawn = [track for track in map(sail, identified.draws(DRAWS)) if track is not None]
    bounds = intervals(drawn, lambda track: track, measured.manoeuvre)
    for k, entry in enumerate(measured.entries):
        values = [entry.value, *(each[k].value if k < len(each) else None for each in own)]
        values += bounds.get(entry.quantity, ())
        quantity = entry.quantity.replace(", ", "_").replace(" ", "_")
        for j, value in enumerate(values):
            label = f"{name}, {COMPARED[j]}"
            yield Finding(f"{FINDING}{quantity}", "all", value, entry.unit, i, j, label)


def _predicted(model: Vessel, part: Recording, problem: Problem, length_m: float) -> Track | None:
    """The track of a free run of a model under the inputs of a file; None if it diverges."""
    try:
        motion = prediction(model, part, problem.thruster).motion()
    except IdentificationError:
        return None
    if not np.all(np.isfinite(motion)):
        return None
    n = len(part.dofs)
    return track_of(replace(part, eta=motion[:, :n], nu=motion[:, n:]), HELM, length_m)
