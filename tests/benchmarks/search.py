"""How long a prediction of a whole population takes, and a search by NSGA-II.

    python tests/benchmarks/search.py

Processor time, the best of some turns: 3,000 Euler steps of linear surge for 10,000 candidates in
one compiled call, and 60 generations of 1,000 on ZDT1 beside pymoo's own class. That the results
are right is what the tests say; nothing is asserted here.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from models.derivatives import from_derivatives
from models.identification.free_parameters import free_parameters
from models.identification.genetic import Nsga2Search, Operators
from models.identification.prediction import course_of
from models.identification.predictor import Predictor
from models.identification.structure import layout
from models.recording import Recording

STEPS, CANDIDATES, TURNS = 3000, 10_000, 5
POPULATION, GENERATIONS = 1000, 60


def seconds(work: Callable[[], object], turns: int) -> float:
    """Least processor time of some turns, after one that compiles."""
    work()
    taken = []
    for _ in range(turns):
        begun = time.process_time()
        work()
        taken.append(time.process_time() - begun)
    return min(taken)


def population() -> Callable[[], object]:
    """Prediction errors of many candidates of a surge model."""
    tau = np.where(np.arange(STEPS) % 400 < 200, 30.0, 0.0)[:, None]
    still, t = np.zeros_like(tau), 0.1 * np.arange(STEPS)
    recording = Recording(("surge",), t, still, still, still, tau, np.zeros((STEPS, 3)))
    model = from_derivatives("surge", ("surge",), np.array([[60.0]]), {"X_u": -20.0})
    free = free_parameters(model, None, "tied", False)
    plan = layout(free.nominal.terms, model.dofs, free.support, "euler")
    predictor = Predictor(free, plan, course_of(recording, None, None, None, 10.0))
    points = np.random.default_rng(0).uniform([10.0, 1.0], [120.0, 40.0], (CANDIDATES, 2))
    return lambda: predictor.errors(points, "mae")


def zdt1(points: np.ndarray) -> np.ndarray:
    """Two objectives in three variables."""
    g = 1.0 + 9.0 * points[:, 1:].mean(axis=1)
    return np.column_stack([points[:, 0], g * (1.0 - np.sqrt(points[:, 0] / g))])


def ours() -> None:
    """The search on arrays."""
    operators = Operators(POPULATION, 15.0, 0.9, 15.0, 1.0 / 3.0)
    search = Nsga2Search(operators, 3, np.random.default_rng(0))
    for _ in range(GENERATIONS):
        search.tell(zdt1(search.ask()))


def theirs() -> None:
    """The same by pymoo's class."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.problem import Problem
    from pymoo.core.termination import NoTermination
    from pymoo.operators.crossover.sbx import SBX
    from pymoo.operators.mutation.pm import PM

    class Zdt(Problem):  # type: ignore[misc]
        def _evaluate(self, x: np.ndarray, out: dict[str, np.ndarray], *_: object) -> None:
            out["F"] = zdt1(x)

    algorithm = NSGA2(
        pop_size=POPULATION,
        crossover=SBX(eta=15.0, prob=0.9),
        mutation=PM(eta=15.0, prob=1.0, prob_var=1.0 / 3.0),
    )
    problem = Zdt(n_var=3, n_obj=2, xl=0.0, xu=1.0)
    algorithm.setup(problem, seed=0, termination=NoTermination())
    for _ in range(GENERATIONS):
        algorithm.next()


def main() -> None:
    """Measure and print."""
    each = 1e6 * seconds(population(), TURNS) / CANDIDATES
    print(f"prediction of {STEPS} steps, {CANDIDATES} candidates: {each:.2f} us each")
    own, peer = seconds(ours, 2), seconds(theirs, 1)
    print(f"{GENERATIONS} generations of {POPULATION}: {own:.2f} s, pymoo's class {peer:.2f} s")


if __name__ == "__main__":
    main()
