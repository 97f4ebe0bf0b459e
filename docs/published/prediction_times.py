"""Computing time of n predictions without JIT, with JIT, and in packs. Hoyer (2021), section 7.6.

Each way is timed in a separate process with an empty cache of machine code, so that the time of
the first call includes the compilation. `many at once` predicts packs of candidates in one compiled
call; the thesis started one thread per candidate.
"""

import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.free_run import (
    METRICS,
    Course,
    course_of,
    predict,
    predicted_layout,
    prediction_errors,
)
from seatrial.models.identification.problem import Identified, Identifier, NoIdentifier, Problem
from seatrial.models.vessel.plant_table import PlantTable

WAYS = ("without JIT", "with JIT", "with JIT, many at once")
LIMIT = 10.0  # of the rates, Hoyer (2021), section 6.4
LONGEST_S = 600.0
SHORT_S, REPEATS = 0.1, 5  # shorter times are repeated, since other processes disturb them


class Task(NamedTuple):
    """The predictions to time: the nominal model and the recording, as arrays, and how often."""

    way: str
    plant: PlantTable
    course: Course
    calls: tuple[int, ...]


@dataclass(frozen=True)
class PredictionTimes(Identifier):
    """Time n predictions of the training part by the nominal model, which is returned unchanged.

    `calls` are the numbers n with JIT, `interpreted_calls` the numbers without JIT.
    """

    calls: tuple[int, ...]
    interpreted_calls: tuple[int, ...]

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model, with the times as diagnostics `prediction_time` (i = n, label = way).

        Raises:
            IdentificationError: a process fails.
        """
        nominal = problem.nominal
        plan = predicted_layout(nominal, nominal.theta != 0.0)
        course = course_of(problem.training, problem.thruster, None, None, LIMIT, nominal.attitude)
        inverse, _ = plan.inverse_inertia(nominal.theta[None])
        plant = plan.plant(nominal.theta, inverse[..., 0])
        found = []
        for way in WAYS:
            calls = self.interpreted_calls if way == WAYS[0] else self.calls
            for n, compilation, later in _run_in_subprocess(Task(way, plant, course, calls)):
                times = {"prediction_time": compilation + later, "prediction_time_compiled": later}
                found += [
                    Diagnostic(name, "all", s, "s", n, label=way) for name, s in times.items()
                ]
        same = NoIdentifier().identify(problem, rng)
        return Identified(same.model, same.residual, None, tuple(found))


def _run_in_subprocess(task: Task) -> list[tuple[int, float, float]]:
    """Rows (n, seconds of compilation, seconds without) measured by `main`."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"SEATRIAL_CACHE": folder}
        if task.way == WAYS[0]:
            environment["NUMBA_DISABLE_JIT"] = "1"
        process = subprocess.run(
            [sys.executable, "-m", __name__],
            input=pickle.dumps(task),
            capture_output=True,
            env=environment,
            timeout=LONGEST_S,
            check=False,
        )
    if process.returncode:
        message = process.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise IdentificationError(f"prediction times, {task.way}: {' '.join(message)}")
    return [(int(n), *map(float, times)) for n, *times in json.loads(process.stdout)]


def timed(task: Task) -> list[tuple[int, float, float]]:
    """Rows (n, seconds of compilation, seconds without) for each n."""
    predictions = at_once if task.way == WAYS[2] else one_by_one
    first = _seconds(predictions, task, 1)
    compilation = max(first - _shortest_seconds(predictions, task, 1), 0.0)
    return [(n, compilation, _shortest_seconds(predictions, task, n)) for n in task.calls]


def _seconds(predicted: Callable[[Task, int], None], task: Task, n: int) -> float:
    begin = time.perf_counter()
    predicted(task, n)
    return time.perf_counter() - begin


def _shortest_seconds(predicted: Callable[[Task, int], None], task: Task, n: int) -> float:
    """The shortest of several measured times if they are short, else one time [s]."""
    first = _seconds(predicted, task, n)
    repeats = REPEATS if first < SHORT_S else 0
    return min([first, *(_seconds(predicted, task, n) for _ in range(repeats))])


def one_by_one(task: Task, n: int) -> None:
    """Compute n predictions one after the other."""
    states = np.empty_like(task.course.reached)
    for _ in range(n):
        predict(task.plant, task.course, True, states)


def at_once(task: Task, n: int) -> None:
    """Predict n candidates in one call."""
    plant, course = task.plant, task.course
    entries = np.repeat(plant.entries[:, None], n, axis=1)
    inverse = np.repeat(plant.inverse_inertia[:, :, None], n, axis=2)
    parameters = np.repeat(plant.parameters[:, None], n, axis=1)
    errors, limited = np.empty((n, course.measured.shape[1])), np.empty(n)
    prediction_errors(
        plant, entries, inverse, parameters, course, True, METRICS.index("mae"), errors, limited
    )


if __name__ == "__main__":
    json.dump(timed(pickle.load(sys.stdin.buffer)), sys.stdout)
