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

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
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
    """The prediction to time: the nominal model and the recording, as arrays."""

    plant: PlantTable
    course: Course


@dataclass(frozen=True)
class PredictionTimes(Identifier):
    """Time n predictions of the training part by the nominal model, which is returned unchanged.

    `calls` are the numbers n with JIT, `interpreted_calls` the numbers without JIT.
    """

    calls: tuple[int, ...]
    interpreted_calls: tuple[int, ...]

    def __post_init__(self) -> None:
        for name in ("calls", "interpreted_calls"):
            numbers = getattr(self, name)
            if not numbers or list(numbers) != sorted({max(n, 1) for n in numbers}):
                raise ConfigurationError(
                    f"{name} must be increasing positive numbers, got {list(numbers)}"
                )

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model, with the times as findings `prediction_time` (i = n, label = way).

        Raises IdentificationError when a process fails.
        """
        nominal = problem.nominal
        plan = predicted_layout(nominal, nominal.theta != 0.0)
        course = course_of(problem.training, problem.thruster, None, None, LIMIT, nominal.attitude)
        inverse, _ = plan.inverse_inertia(nominal.theta[None])
        task = Task(plan.plant(nominal.theta, inverse[..., 0]), course)
        findings = []
        for way in WAYS:
            calls = self.interpreted_calls if way == WAYS[0] else self.calls
            for n, first, later in _run_in_subprocess(way, task, calls):
                findings.append(Finding("prediction_time", "all", first, "s", n, label=way))
                findings.append(
                    Finding("prediction_time_compiled", "all", later, "s", n, label=way)
                )
        same = NoIdentifier().identify(problem, rng)
        return Identified(same.model, same.residual, None, tuple(findings))


def _run_in_subprocess(
    way: str, task: Task, calls: tuple[int, ...]
) -> list[tuple[int, float, float]]:
    """Rows (n, seconds with compilation, seconds without) measured by `main`."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"SEATRIAL_CACHE": folder}
        if way == WAYS[0]:
            environment["NUMBA_DISABLE_JIT"] = "1"
        process = subprocess.run(
            [sys.executable, "-m", __name__],
            input=pickle.dumps((way, task, calls)),
            capture_output=True,
            env=environment,
            timeout=LONGEST_S,
            check=False,
        )
    if process.returncode:
        message = process.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise IdentificationError(f"prediction times, {way}: {' '.join(message)}")
    return [(int(n), float(first), float(later)) for n, first, later in json.loads(process.stdout)]


def timed(way: str, task: Task, calls: tuple[int, ...]) -> list[tuple[int, float, float]]:
    """Rows (n, seconds with compilation, seconds without) for each n."""
    predictions = at_once if way == WAYS[2] else one_by_one
    first_s = _seconds(predictions, task, 1)
    compilation = max(first_s - _shortest_seconds(predictions, task, 1), 0.0)
    seconds = [_shortest_seconds(predictions, task, n) for n in calls]
    return [(n, compilation + s, s) for n, s in zip(calls, seconds, strict=True)]


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


def main() -> None:
    """Time the pickled task from standard input; write the times as JSON to standard output."""
    way, task, calls = pickle.load(sys.stdin.buffer)
    json.dump(timed(way, task, calls), sys.stdout)


if __name__ == "__main__":
    main()
