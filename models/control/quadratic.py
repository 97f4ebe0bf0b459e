"""A sequence of quadratic programs that differ in their linear terms, solved by daqp.

The matrices are factorised once; every solve starts from the active set of the last. daqp is a
dual active-set method (Arnstrom, Bemporad and Axehill (2022)) and needs a positive definite H. A
problem with equalities E z = e and a singular H is made so by adding rho/2 |E z - e|^2, which is
zero at every feasible point: the solution is the same.
"""

from typing import Any

import numpy as np

from models.basis import Array
from models.control.horizon import Quadratic

OPTIMAL = 1
EQUALITY = 5  # daqp's code of a constraint that always holds
TOLERANCE = 1e-9  # of the constraints, in shares of the limits


class Solver:
    """Solves one problem again and again, for parameters theta."""

    def __init__(self, problem: Quadratic) -> None:
        import daqp

        equal = problem.equal
        E, e = problem.rows[equal[problem.simple :]], problem.shift[equal]
        rho = float(np.max(np.abs(problem.H))) / max(float(np.linalg.norm(E, 2)) ** 2, 1.0)
        rho = rho if len(E) else 0.0
        scale = 1.0 / float(np.mean(np.abs(np.diag(problem.H))))
        self.H = scale * (problem.H + rho * E.T @ E)  # kept: the solver reads them in place
        self.f = scale * (problem.f - rho * E.T @ e)
        self.shift, self.bound = problem.shift, problem.bound
        self.moving = bool(np.any(self.shift != 0.0))
        self.rows = np.ascontiguousarray(problem.rows)
        sense = np.where(equal, EQUALITY, 0).astype(np.int32)
        self.model: Any = daqp.Model()
        self.model.settings = {"primal_tol": TOLERANCE}
        flag, _ = self.model.setup(
            self.H, np.zeros(len(self.H)), self.rows, self.bound, -self.bound, sense
        )
        self.ready = flag >= 0

    def solve(self, theta: Array) -> Array | None:
        """The solution z for the parameters theta, or None when there is none to rely on."""
        if not (self.ready and np.all(np.isfinite(theta))):
            return None
        f = self.f @ theta
        if self.moving:
            middle = self.shift @ theta
            flag = self.model.update(f=f, bupper=middle + self.bound, blower=middle - self.bound)
        else:
            flag = self.model.update(f=f)
        if flag is not None and flag < 0:
            return None
        z, _, flag, _ = self.model.solve()
        return z if flag == OPTIMAL else None
