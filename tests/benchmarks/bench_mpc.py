"""One step of model predictive control, against other solvers and our own sparse formulation.

10,000 programs of a closed loop of the supply vessel, recorded once and solved again in their
order by everyone, so that each may start from its last solution. A step is what changes from one
sample to the next: the linear terms from theta, and the solution. About a minute and a half.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from seatrial.models.control import horizon
from seatrial.models.control.horizon import Horizon, Quadratic, Solver
from seatrial.models.vessel.basis import Array
from tests.benchmarks.programs import commands, one_by_one, problem_of, recorded

pytest.importorskip("osqp", reason="osqp is not installed: pip install '.[bench]'")
pytest.importorskip("quadprog", reason="quadprog is not installed: pip install '.[bench]'")

STEPS = 10
PROGRAMS = 10_000
OURS = "daqp, condensed"
AS_FAST = 0.83  # within 1.2 of the fastest

Solve = Callable[[Array], Array | None]


def scaled(problem: Quadratic) -> tuple[Array, Array]:
    """H and f with a mean curvature of one, as ours has them."""
    scale = 1.0 / float(np.mean(np.diag(problem.H)))
    return scale * problem.H, scale * problem.f


def quadprog_solver(problem: Quadratic) -> Solve:
    """quadprog on a condensed problem, the Cholesky factor of H given."""
    import quadprog

    H, f = scaled(problem)
    inverse = np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(H).T))
    eye = np.eye(len(H))
    rows, bound = np.hstack([eye, -eye]), -np.concatenate([problem.bound, problem.bound])

    def solve(theta: Array) -> Array | None:
        try:
            found = quadprog.solve_qp(inverse, -(f @ theta), rows, bound, 0, True)
        except ValueError:
            return None
        return np.asarray(found[0])

    return solve


def osqp_solver(problem: Quadratic) -> Solve:
    """OSQP at 1e-6, set up once, only its vectors updated, from the last solution."""
    import osqp  # pyright: ignore[reportMissingImports]
    from scipy.sparse import csc_matrix

    (H, f), size = scaled(problem), len(problem.H)
    rows = np.vstack([np.eye(size)[: problem.simple], problem.rows])
    solver = osqp.OSQP()
    solver.setup(
        P=csc_matrix(np.triu(H)), q=np.zeros(size), A=csc_matrix(rows), l=-problem.bound,
        u=problem.bound, eps_abs=1e-6, eps_rel=1e-6, warm_starting=True, verbose=False,
    )  # fmt: skip
    moving = bool(np.any(problem.shift != 0.0))

    def solve(theta: Array) -> Array | None:
        if moving:
            middle = problem.shift @ theta
            solver.update(q=f @ theta, l=middle - problem.bound, u=middle + problem.bound)
        else:
            solver.update(q=f @ theta)
        found = solver.solve(raise_error=False)
        return np.asarray(found.x) if found.info.status_val == 1 else None

    return solve


def slsqp_solver(problem: Quadratic) -> Solve:
    """SciPy's SLSQP on a condensed problem with its exact gradient, from the last solution."""
    from scipy.optimize import Bounds, minimize

    (H, f), last = scaled(problem), np.zeros(len(problem.H))
    within = Bounds(-problem.bound, problem.bound)

    def solve(theta: Array) -> Array | None:
        nonlocal last
        linear = f @ theta

        def cost(z: Array) -> tuple[float, Array]:
            along = H @ z
            return float(z @ (0.5 * along + linear)), along + linear

        found = minimize(
            cost, last, jac=True, method="SLSQP", bounds=within,
            options={"ftol": 1e-12, "maxiter": 200},
        )  # fmt: skip
        if not found.success:
            return None
        last = found.x
        return np.asarray(found.x)

    return solve


def sparse_solver(problem: Quadratic) -> Solve:
    """Our own solver on another formulation."""
    return Solver(problem).solve


# name, formulation, solver, tolerance of the command [share of a limit], calls a round
OTHERS: list[tuple[str, Callable[[Horizon], Quadratic], Callable[[Quadratic], Solve], float, int]]
OTHERS = [
    ("quadprog, condensed", horizon.condensed, quadprog_solver, 1e-9, 10_000),
    ("OSQP 1e-6, sparse (u, x)", horizon.reduced, osqp_solver, 2e-3, 1_000),
    ("OSQP 1e-6, condensed", horizon.condensed, osqp_solver, 1e-5, 5_000),
    ("SciPy SLSQP, condensed", horizon.condensed, slsqp_solver, 1e-5, 1_000),
    ("daqp, sparse (u, x, e, y)", horizon.standard, sparse_solver, 1e-9, 2_000),
]


@cache
def programs() -> tuple[Horizon, Array, float]:
    """The problem, what was recorded, and the share of programs at a limit."""
    return problem_of("condensed", STEPS), *recorded("condensed", STEPS, PROGRAMS)


@cache
def answers() -> dict[str, Array]:
    """The first command of every program by every solver."""
    problem, thetas, _ = programs()
    solvers = {OURS: Solver(horizon.condensed(problem)).solve}
    solvers |= {name: make(write(problem)) for name, write, make, _, _ in OTHERS}
    return {name: commands(solve, thetas, problem.sizes[1]) for name, solve in solvers.items()}


@pytest.mark.parametrize(
    ("name", "write", "make", "tolerance", "calls"), OTHERS, ids=[one[0] for one in OTHERS]
)
def test_a_step(
    in_turn: Any, name: str, write: Any, make: Any, tolerance: float, calls: int
) -> None:
    problem, thetas, limited = programs()
    solved = np.all(np.isfinite(answers()[name]), axis=1)
    np.testing.assert_allclose(
        answers()[name][solved], answers()[OURS][solved], rtol=0.0, atol=tolerance
    )
    in_turn(
        one_by_one(Solver(horizon.condensed(problem)).solve, thetas),
        one_by_one(make(write(problem)), thetas),
        item="4", what="MPC step, supply vessel, horizon 10 (30 variables)",
        name=OURS, peer_name=name, wanted=None if make is sparse_solver else AS_FAST,
        rounds=5, calls=10_000, peer_calls=calls,
        note=f"{100 * limited:.0f} % of the programs at a limit; "
        f"commands agree to {tolerance:.0e} of the limit",
    )  # fmt: skip


def test_failed_programs(stated: Any) -> None:
    def counted() -> dict[str, dict[str, Any]]:
        found = {}
        for name, first in answers().items():
            failed = int(np.sum(~np.all(np.isfinite(first), axis=1)))
            found[name] = {"shown": f"{failed} of {PROGRAMS}", "failed": failed}
        found[OURS] |= {"limit": "0"}
        if found[OURS]["failed"]:
            found[OURS]["short"] = f"{found[OURS]['failed']} failed"
        return found

    stated(counted, item="4", what="MPC programs without a solution")
