"""How long n predictions take without JIT, with it, and many at once. Hoyer (2021), section 7.6.

Each way is timed in a process of its own, with an empty cache of machine code, so that the time
of the first call includes the compilation. `many at once` predicts packs of candidates in one
compiled call, where the thesis started a thread for each.
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
SHORT_S, REPEATS = 0.1, 5  # a time below is measured again, for others use the machine too


class Task(NamedTuple):
    """What is predicted: the nominal model along a recording; arrays only."""

    plant: PlantTable
    course: Course


@dataclass(frozen=True)
class PredictionTimes(Identifier):
    """Times n predictions of the training part by the nominal model, which it gives back.

    `calls` are the numbers n, `interpreted_calls` those without JIT, which is slow.
    """

    calls: tuple[int, ...]
    interpreted_calls: tuple[int, ...]

    def __post_init__(self) -> None:
        for name in ("calls", "interpreted_calls"):
            numbers = getattr(self, name)
            if not numbers or list(numbers) != sorted({max(n, 1) for n in numbers}):
                raise ConfigurationError(
                    f"{name} must be rising numbers from 1 on, got {list(numbers)}"
                )

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model; the times as findings `prediction_time` (i = n, label = way)."""
        nominal = problem.nominal
        plan = predicted_layout(nominal.terms, nominal.dofs, nominal.theta != 0.0)
        course = course_of(problem.training, problem.thruster, None, None, LIMIT, nominal.attitude)
        inverse, _ = plan.inverse_inertia(nominal.theta[None])
        task = Task(plan.plant(nominal.theta, inverse[..., 0]), course)
        findings = []
        for way in WAYS:
            calls = self.interpreted_calls if way == WAYS[0] else self.calls
            for n, first, later in _in_a_new_process(way, task, calls):
                findings.append(Finding("prediction_time", "all", first, "s", n, label=way))
                findings.append(
                    Finding("prediction_time_compiled", "all", later, "s", n, label=way)
                )
        same = NoIdentifier().identify(problem, rng)
        return Identified(same.model, same.residual, None, tuple(findings))


def _in_a_new_process(
    way: str, task: Task, calls: tuple[int, ...]
) -> list[tuple[int, float, float]]:
    """(n, seconds with what is compiled first, seconds without) measured by `main`."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"SEATRIAL_CACHE": folder}
        if way == WAYS[0]:
            environment["NUMBA_DISABLE_JIT"] = "1"
        done = subprocess.run(
            [sys.executable, "-m", __name__],
            input=pickle.dumps((way, task, calls)),
            capture_output=True,
            env=environment,
            timeout=LONGEST_S,
            check=False,
        )
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise IdentificationError(f"prediction times, {way}: {' '.join(last)}")
    return [(int(n), float(first), float(later)) for n, first, later in json.loads(done.stdout)]


def timed(way: str, task: Task, calls: tuple[int, ...]) -> list[tuple[int, float, float]]:
    """(n, seconds with what is compiled first, seconds without) for each n."""
    once = at_once if way == WAYS[2] else one_by_one
    begin = _seconds(once, task, 1)
    compilation = max(begin - _least(once, task, 1), 0.0)
    later = [_least(once, task, n) for n in calls]
    return [(n, compilation + s, s) for n, s in zip(calls, later, strict=True)]


def _seconds(predicted: Callable[[Task, int], None], task: Task, n: int) -> float:
    begin = time.perf_counter()
    predicted(task, n)
    return time.perf_counter() - begin


def _least(predicted: Callable[[Task, int], None], task: Task, n: int) -> float:
    """The least of several times, where they are short."""
    first = _seconds(predicted, task, n)
    repeats = REPEATS if first < SHORT_S else 0
    return min([first, *(_seconds(predicted, task, n) for _ in range(repeats))])


def one_by_one(task: Task, n: int) -> None:
    """n predictions, one after the other."""
    states = np.empty_like(task.course.reached)
    for _ in range(n):
        predict(task.plant, task.course, True, states)


def at_once(task: Task, n: int) -> None:
    """n candidates in one call."""
    plant, course = task.plant, task.course
    entries = np.repeat(plant.entries[:, None], n, axis=1)
    inverse = np.repeat(plant.inverse_inertia[:, :, None], n, axis=2)
    errors, limited = np.empty((n, course.measured.shape[1])), np.empty(n)
    prediction_errors(plant, entries, inverse, course, True, METRICS.index("mae"), errors, limited)


def main() -> None:
    """Measure what stands, pickled, in standard input; JSON to standard output."""
    way, task, calls = pickle.load(sys.stdin.buffer)
    json.dump(timed(way, task, calls), sys.stdout)


if __name__ == "__main__":
    main()
