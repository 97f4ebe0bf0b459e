"""A population's predictions, and a whole identification by NSGA-II; about three minutes.

The evaluation is that of Hoyer (2021), chapter 6: every candidate predicts the recording by Euler
with limited rates, and gives the mean error of pose and velocity and the share of rates that had
to be limited, which the objectives need. All on one core.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any
from unittest.mock import patch

import numba
import numpy as np

from seatrial.models.identification.free_run import deviations, predict
from seatrial.models.identification.multiobjective_search import (
    ParameterSpace,
    RunningMetric,
    SearchResult,
)
from seatrial.models.identification.nsga2 import Nsga2
from seatrial.models.identification.objectives import Objectives
from seatrial.models.identification.predictor import Predictor
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.vessel.basis import Array
from seatrial.runner.closed_loop import Streams
from seatrial.runner.trial import excite
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
    return sailed(
        f"vessel={vessel}",
        "excitation=many_sine",
        "excitation.length_s=600",
        "controller=none",
        *overrides,
    )


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


@dataclass(frozen=True)
class ByPymoo(Nsga2):
    """The same identification, searched by pymoo's NSGA2 with pymoo's defaults."""

    def _search(
        self, objectives: Objectives, space: ParameterSpace, rng: np.random.Generator
    ) -> SearchResult:
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.problem import Problem as PymooProblem
        from pymoo.optimize import minimize

        class Prediction(PymooProblem):  # type: ignore[misc]
            def _evaluate(self, x: Array, out: dict[str, Array], *_: Any, **__: Any) -> None:
                out["F"] = objectives(x)

        scale = objectives.floor
        box = {"xl": space.lower, "xu": space.upper}
        prediction = Prediction(n_var=len(space.lower), n_obj=len(scale), **box)
        seed = int(rng.integers(2**31))
        found = minimize(
            prediction, NSGA2(pop_size=self.population), ("n_gen", self.generations), seed=seed
        )
        metric = RunningMetric(scale, self.window, self.threshold)
        return SearchResult(found.X, found.F, metric, self.generations, "generations")


def front_of(found: Identified) -> Array:
    """The objectives of the points of the Pareto front, shape (n, 2)."""
    values = [f.value for f in found.diagnostics if f.name == "pareto_objective"]
    return np.array(values).reshape(-1, 2)


def hypervolumes(*fronts: Array) -> list[float]:
    """Share of the rectangle about all fronts, a tenth larger, that each dominates."""
    from pymoo.indicators.hv import HV

    everything = np.vstack(fronts)
    lowest, highest = everything.min(axis=0), everything.max(axis=0)
    volume = HV(ref_point=np.full(2, 1.1))
    return [float(volume((front - lowest) / (highest - lowest))) / 1.21 for front in fronts]


Identify = Callable[[], Identified]


def identifications() -> tuple[Identify, Identify]:
    """The same surge model with non-linear drag, three parameters, by ours and by pymoo's."""
    ours, problem = surge("surge_nonlinear")
    peer = ByPymoo(**vars(ours))
    return (
        lambda: ours.identify(problem, np.random.default_rng(0)),
        lambda: peer.identify(problem, np.random.default_rng(0)),
    )


def test_whole_identification(in_turn: Any) -> None:
    ours, peer = identifications()
    mine, other = ours(), peer()
    volumes = hypervolumes(front_of(mine), front_of(other))
    assert abs(volumes[0] - volumes[1]) <= 0.005 * volumes[1]
    np.testing.assert_allclose(mine.model.theta, other.model.theta, rtol=1e-6)
    in_turn(
        ours, peer, item="3d", what="identification by NSGA-II, population 1000, 60 generations",
        name="search on arrays", peer_name="pymoo's NSGA2, its defaults", wanted=1.5, rounds=5,
        warm=False,
        note="surge, three parameters, 3,000 samples, RK4, with decision and polish; hypervolumes "
        "of the fronts agree within 0.5 %, the polished coefficients to 1e-6",
    )  # fmt: skip


@contextmanager
def clocked(cls: type, method: str) -> Iterator[list[float]]:
    """Wall-clock times of the calls of a method [s]."""
    times: list[float] = []
    called = getattr(cls, method)

    def timed(*given: Any) -> Any:
        begun = perf_counter()
        found = called(*given)
        times.append(perf_counter() - begun)
        return found

    with patch.object(cls, method, timed):
        yield times


def own_share(cls: type, identify: Identify) -> dict[str, Any]:
    """The share of a search, without its evaluations, in a whole identification."""
    identify()
    with clocked(cls, "_search") as search, clocked(Objectives, "__call__") as evaluation:
        begun = perf_counter()
        identify()
        whole = perf_counter() - begun
    own = sum(search) - sum(evaluation[:GENERATIONS])
    return {"shown": f"{100.0 * own / whole:.0f} % of {whole:.2f} s"}


def test_share_of_the_search(stated: Any) -> None:
    ours, peer = identifications()
    stated(
        lambda: {
            "pymoo's NSGA2, its defaults": own_share(ByPymoo, peer),
            "search on arrays": own_share(Nsga2, ours),
        },
        item="3e", what="the search's own time in that identification",
        note="sampling, selection, crossover, mutation, survival and duplicates: two arrays in "
        "place of an object for each individual, and equal ones found by sorting",
    )  # fmt: skip
