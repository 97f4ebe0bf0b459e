"""One identifier on one recording, in a process of its own, so that its peak memory is its own.

    python -m tests.benchmarks.identify FILE NAME [OVERRIDE ...]

prints a line of JSON: the time of `identify` [s], the peak memory of the process and what it held
before [MB], or the error. FILE is one of `write`'s.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from seatrial.models.errors import SeatrialError
from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.simulation.voyage import recording_of
from seatrial.runner.trials.closed_loop import Streams, prepare
from tests.benchmarks.memory import peak_megabytes
from tests.trials import composed

FIELDS = ("t", "eta", "nu", "nu_dot", "tau")
WARM = 1000  # samples of the first turn, which compiles and imports what there is
SPENT_S = 1.0  # short ones are measured again until so much time went


def write(folder: Path, sizes: list[int]) -> dict[int, Path]:
    """Recordings of the first samples of one voyage, the ferry on its laps with PRBS and noise."""
    trial = composed("disturbance=noise", "excitation=prbs_waypoints")
    lap, length = trial.excitation.base, max(sizes) * trial.sample_time_s
    waypoints = lap.waypoints * int(-(-length // lap.duration_s))
    base = replace(lap, waypoints=waypoints)
    mission = replace(trial.excitation, base=base, length_s=base.duration_s)
    sailed = prepare(trial, Streams(0), trial.vessel.nominal(), mission).sail().voyage
    whole = recording_of(sailed, sailed.weather)
    paths = {size: folder / f"{size}.npz" for size in sizes}
    for size, path in paths.items():
        np.savez(path, **{name: getattr(whole, name)[:size] for name in FIELDS})
    return paths


def problem(file: Path, trial: Any) -> Problem:
    """The whole recording to learn from; its last samples are looked at again."""
    with np.load(file) as held:
        arrays = {name: held[name] for name in FIELDS}
    dofs, thruster = trial.vessel.dofs, trial.vessel.thruster
    whole = Recording(dofs, attitude=attitude_of(dofs, arrays["eta"]), **arrays)
    whole = whole.with_thruster(thruster)
    return Problem(whole, whole.part(slice(-WARM, None)), trial.vessel.nominal(), thruster)


def measured(file: Path, trial: Any) -> dict[str, Any]:
    """What it took; the least of a few turns where they are short."""
    given = problem(file, trial)
    first = replace(given, training=given.training.part(slice(0, WARM)))
    try:
        trial.identifier.identify(first, np.random.default_rng(0))
    except SeatrialError as error:  # too short for this one: it compiled all the same
        if len(given.training) == WARM:
            return {"error": str(error)}
    before, times = peak_megabytes(), []
    while sum(times) < SPENT_S:
        begun = perf_counter()
        try:
            trial.identifier.identify(given, np.random.default_rng(0))
        except SeatrialError as error:
            return {"error": str(error)}
        times.append(perf_counter() - begun)
    return {"seconds": min(times), "megabytes": peak_megabytes(), "before": before}


if __name__ == "__main__":
    name, *overrides = sys.argv[2:]
    chosen = composed(f"identifier={name}", *overrides)
    print(json.dumps(measured(Path(sys.argv[1]), chosen)))
