"""A population's predictions; about two minutes.

The evaluation is that of Hoyer (2021), chapter 6: every candidate predicts the recording by Euler
with limited rates, and gives the mean error of pose and velocity and the share of rates that had
to be limited, which the objectives need. All on one core.
"""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from seatrial.models.identification.free_run import deviations, predict
from seatrial.models.identification.nsga2 import Nsga2
from seatrial.models.identification.predictor import Predictor
from seatrial.models.identification.problem import Problem
from seatrial.models.vessel.basis import Array
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite
from tests.trials import composed

STEPS, CANDIDATES, FERRIES = 3000, 10_000, 256
POPULATION, GENERATIONS = 1000, 60
BOX = np.array([[10.0, 1.0], [120.0, 40.0]])  # inertia [kg] and drag [kg/s]


def sailed(*overrides: str) -> tuple[Nsga2, Problem]:
    """NSGA-II and the 3,000 samples to identify from, measured with noise."""
    trial = composed(
        "identifier=nsga2", "disturbance=noise", "evaluation=none",
        f"identifier.population={POPULATION}", f"identifier.generations={GENERATIONS}",
        "identifier.threshold=1e-12", "identifier.objective_floor=0", *overrides,
    )  # fmt: skip
    excited = excite(trial, Streams(trial.seed))
    training, testing = (excited.recording.part(p) for p in (excited.training, excited.testing))
    assert len(training) == STEPS
    nominal, thruster = trial.vessel.nominal(), trial.vessel.thruster
    return trial.identifier, Problem(training, testing, nominal, thruster)


def surge(vessel: str, *overrides: str) -> tuple[Nsga2, Problem]:
    """Ten minutes of many sines, half of them for training."""
    mission = ("excitation=many_sine", "excitation.length_s=600", "controller=none")
    return sailed(f"vessel={vessel}", *mission, *overrides)


def numpy_errors(predictor: Predictor, points: Array) -> tuple[Array, Array]:
    """All candidates side by side, in place; errors (n, 2) and how many rates were limited."""
    course, n = predictor.course, len(points)
    m, d = np.ascontiguousarray(points.T)
    over_m, h, limit = 1.0 / m, course.step_s, course.limit
    x, u = np.full((2, n), course.start[0, :, None])
    x_error, u_error, wanted, speed, rate = np.zeros((5, n))
    changed, count = np.zeros(n, dtype=bool), np.zeros(n, dtype=np.uint16)
    for k, (x_k, u_k) in enumerate(course.measured):
        if k > 0:
            np.multiply(d, u, out=wanted)
            np.subtract(course.acting[k - 1, 0, 0], wanted, out=wanted)
            np.multiply(wanted, over_m, out=wanted)
            for free, held in ((u, speed), (wanted, rate)):
                np.minimum(free, limit, out=held)
                np.maximum(held, -limit, out=held)
                np.not_equal(free, held, out=changed)
                np.add(count, changed, out=count)
                np.multiply(held, h, out=held)
            np.add(x, speed, out=x)
            np.add(u, rate, out=u)
        for measured, state, error in ((x_k, x, x_error), (u_k, u, u_error)):
            np.subtract(measured, state, out=wanted)
            np.abs(wanted, out=wanted)
            np.add(error, wanted, out=error)
    return np.column_stack([x_error, u_error]) / len(course.measured), count


@numba.njit(error_model="numpy")
def _one(
    m: float, d: float, force: Array, measured: Array, h: float, limit: float
) -> tuple[float, float, int]:
    """One candidate, written for this model alone."""
    x, u = measured[0, 0], measured[0, 1]  # so that the first error is zero
    x_error, u_error, count = 0.0, 0.0, 0
    for k in range(1, len(measured)):
        wanted = (force[k - 1] - d * u) / m
        rate, speed = max(min(wanted, limit), -limit), max(min(u, limit), -limit)
        count += (rate != wanted) + (speed != u)
        x, u = x + h * speed, u + h * rate
        x_error += abs(measured[k, 0] - x)
        u_error += abs(measured[k, 1] - u)
    return x_error / len(measured), u_error / len(measured), count


@numba.njit(error_model="numpy")
def _one_by_one(
    points: Array, force: Array, measured: Array, h: float, limit: float, found: Array
) -> None:
    for i in range(len(points)):
        found[i, 0], found[i, 1], found[i, 2] = _one(
            points[i, 0], points[i, 1], force, measured, h, limit
        )


def jit_errors(predictor: Predictor, points: Array) -> tuple[Array, Array]:
    """One candidate after the other in compiled code."""
    course, found = predictor.course, np.empty((len(points), 3))
    force = np.ascontiguousarray(course.acting[:, 0, 0])
    _one_by_one(points, force, course.measured, course.step_s, course.limit, found)
    return found[:, :2], found[:, 2]


def population() -> tuple[Predictor, Array]:
    """Candidates of a linear surge model, spread over the box."""
    identifier, problem = surge("surge_linear", "identifier.integrator=euler")
    points = np.random.default_rng(0).uniform(*BOX, (CANDIDATES, 2))
    return identifier.predictor(problem), points


Way = Callable[[Predictor, Array], tuple[Array, Array]]


def beside(in_turn: Any, way: Way, **says: Any) -> None:
    """Ours beside another way to evaluate the population, once both agree."""
    predictor, points = population()
    errors, limited, realistic = predictor.errors(points, "mae")
    other, count = way(predictor, points)
    assert np.all(realistic)
    assert 0.0 < np.mean(limited > 0.0) < 0.1
    np.testing.assert_allclose(errors, other, rtol=1e-9)
    np.testing.assert_allclose(limited, count / predictor.course.measured.size, rtol=1e-9)
    in_turn(
        lambda: predictor.errors(points, "mae"), lambda: way(predictor, points),
        what="NSGA-II evaluation, surge by Euler, 10,000 candidates x 3,000 steps",
        name="packs of candidates", wanted=4.0, **says,
    )  # fmt: skip


def test_packs_beside_one_candidate(in_turn: Any) -> None:
    beside(
        in_turn, jit_errors, item="3a", peer_name="numba, one candidate at a time", rounds=15,
        note="the other is written for this model alone; errors agree to 1e-9; one core each",
        why="one candidate stays in registers; a pack gains the vector width, less what its memory "
        "costs",
    )  # fmt: skip


def test_packs_beside_numpy(in_turn: Any) -> None:
    beside(
        in_turn, numpy_errors, item="3b", peer_name="NumPy across the population", rounds=15,
        note="in place, without temporaries; errors agree to 1e-9; one core each",
        why="NumPy's loops are as vectorised as ours; what is gained is that a pack stays in the "
        "first-level cache",
    )  # fmt: skip


def test_packs_of_ferries(in_turn: Any) -> None:
    identifier, problem = sailed("vessel=milliampere", "excitation.interval_s=50")
    predictor = identifier.predictor(problem)
    factors = np.random.default_rng(0).uniform(0.8, 1.25, (FERRIES, len(predictor.free)))
    points, course = predictor.free.values * factors, predictor.course
    tables = predictor.free.tables(points)
    inverse, _ = predictor.plan.inverse_inertia(tables)
    plants = [predictor.plan.plant(tables[i], inverse[..., i]) for i in range(FERRIES)]
    states = np.empty_like(course.reached)

    def one_by_one() -> Array:
        errors = np.empty((FERRIES, 6))
        for i, plant in enumerate(plants):
            predict(plant, course, False, states)
            e = deviations(course.kinematics, course.reached, states)
            errors[i] = np.mean(np.abs(e), axis=0)
        return errors

    np.testing.assert_allclose(predictor.errors(points, "mae")[0], one_by_one(), rtol=1e-9)
    in_turn(
        lambda: predictor.errors(points, "mae"), one_by_one, item="3c", rounds=9,
        what=f"NSGA-II evaluation, milliAmpere by RK4, {FERRIES} candidates x 3,000 steps",
        name="packs of candidates", peer_name="numba, one candidate at a time", wanted=4.0,
        note="the other is the readable equation, compiled for any table; errors agree to 1e-9",
    )  # fmt: skip
