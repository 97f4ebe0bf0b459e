"""An optimal control problem over a receding horizon, in four formulations as a QP.

    J = 1/2 sum_{i=1..N} (y_i - r_i)' Q (y_i - r_i) + u_{i-1}' P u_{i-1}
    x_{i+1} = A x_i + B (u_i + d_i),    y_i = C x_i

standard   z = (u, x, e, y)    Bargouth (2022), (3.47)-(3.74)
reduced    z = (u, x)          (3.75)-(3.86), with the signs of appendix I
condensed  z = u               (3.87)-(3.96)
increments z = Delta u         (3.97)-(3.111), on the model of increments

The first three formulations are equivalent. The data that change from sample to sample enter
linearly, through

    theta = (x_0, r_1 ... r_N, d_0 ... d_{N-1}, u_{-1})

with inputs as fractions of their limits. In the formulation `increments` x_0 is
(Delta x_0, y_{-1}) and d are increments; only this formulation uses the last command u_{-1}.

`Solver` solves a sequence of such programs, which differ in their linear terms, with daqp. The
matrices are factorised once, and every solve starts from the active set of the last one. daqp is
a dual active-set method (Arnstrom, Bemporad and Axehill (2022)) and needs a positive definite H.
To a problem with equalities E z = e and a singular H the term rho/2 |E z - e|^2 is added. It is
zero at every feasible point, so the solution is the same.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import daqp
import numpy as np
import scipy

from seatrial.models.vessel.basis import Array


@dataclass(frozen=True, eq=False)
class Horizon:
    """The optimal control problem: model, weights, number of steps and limit of the increments."""

    A: Array  # (n, n)
    B: Array  # (n, r)
    C: Array  # (m, n)
    Q: Array  # (m, m)
    P: Array  # (r, r)
    steps: int
    rate: Array | None = None  # (r,) largest increment per step, as a fraction of the limits

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of states n, inputs r and outputs m."""
        return self.A.shape[0], self.B.shape[1], self.C.shape[0]

    @property
    def parameters(self) -> tuple[slice, slice, slice, slice]:
        """Slices of x_0, r, d and the last command in theta."""
        n, r, m = self.sizes
        edges = np.cumsum([0, n, self.steps * m, self.steps * r, r]).tolist()
        state, reference, known, last = (slice(a, b) for a, b in pairwise(edges))
        return state, reference, known, last

    @property
    def width(self) -> int:
        """Number of parameters theta."""
        return int(self.parameters[-1].stop)

    @cached_property
    def prediction(self) -> tuple[Array, Array]:
        """Matrices O (N m, n) and F (N m, N r) of y = O x_0 + F (u + d), (3.89)-(3.91)."""
        free, reached, (_, r, m), N = [self.C @ self.A], [self.B], self.sizes, self.steps
        for _ in range(1, N):
            free.append(free[-1] @ self.A)
            reached.append(self.A @ reached[-1])
        ago = np.subtract.outer(np.arange(N), np.arange(N))[..., None, None]
        response = np.array([self.C @ each for each in reached])[ago[..., 0, 0]]
        F = np.where(ago >= 0, response, 0.0)  # (N, N, m, r)
        return np.vstack(free), F.swapaxes(1, 2).reshape(N * m, N * r)

    def over(self, weight: Array) -> Array:
        """Block-diagonal matrix of a weight, repeated for each step of the horizon."""
        return np.asarray(np.kron(np.eye(self.steps), weight), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """1/2 z' H z + (f theta)' z  subject to  |rows z - shift theta| <= bound.

    A bound of zero is an equality. The first `simple` constraints bound the first variables
    directly. The first r variables are the command (or its increment).
    """

    H: Array  # (nz, nz)
    f: Array  # (nz, width)
    rows: Array  # general constraints, (nc, nz)
    shift: Array  # (simple + nc, width)
    bound: Array  # (simple + nc,)
    simple: int

    @property
    def equal(self) -> Array:
        """Mask of the constraints that are equalities, shape (simple + nc,)."""
        return np.asarray(self.bound == 0.0)


def standard(h: Horizon) -> Quadratic:
    """z = (u, x, e, y), with model, output and error equations as equality constraints."""
    (n, r, m), N = h.sizes, h.steps
    nu, nx, ny = N * r, N * n, N * m
    model, shift = _model_rows(h)
    one, none = np.eye(ny), np.zeros((ny, ny))
    rows = np.block([
        [model, np.zeros((nx, 2 * ny))],
        [np.zeros((ny, nu)), -h.over(h.C), none, one],
        [np.zeros((ny, nu + nx)), one, -one],
    ])  # fmt: skip
    reference = np.zeros((ny, h.width))
    reference[:, h.parameters[1]] = -one
    shift = np.vstack([np.zeros((nu, h.width)), shift, np.zeros((ny, h.width)), reference])
    H = scipy.linalg.block_diag(h.over(h.P), np.zeros((nx, nx)), h.over(h.Q), none)
    bound = np.concatenate([np.ones(nu), np.zeros(len(rows))])
    return Quadratic(H, np.zeros((len(H), h.width)), rows, shift, bound, nu)


def reduced(h: Horizon) -> Quadratic:
    """z = (u, x), with the model equation as equality constraint."""
    (n, r, _), N = h.sizes, h.steps
    nu, nx = N * r, N * n
    rows, shift = _model_rows(h)
    f = np.zeros((nu + nx, h.width))
    f[nu:, h.parameters[1]] = -h.over(h.C.T @ h.Q)
    H = scipy.linalg.block_diag(h.over(h.P), h.over(h.C.T @ h.Q @ h.C))
    bound = np.concatenate([np.ones(nu), np.zeros(nx)])
    return Quadratic(H, f, rows, np.vstack([np.zeros((nu, h.width)), shift]), bound, nu)


def condensed(h: Horizon) -> Quadratic:
    """z = u: H = F' Q F + P, f = F' Q (O x_0 + F d - r)."""
    nu = h.steps * h.sizes[1]
    H, f = _condensed_cost(h)
    return Quadratic(H, f, np.zeros((0, nu)), np.zeros((nu, h.width)), np.ones(nu), nu)


def increments(h: Horizon) -> Quadratic:
    """z = Delta u on the model of increments: |S Delta u + c u_{-1}| <= 1, |Delta u| <= rate."""
    r, N = h.sizes[1], h.steps
    H, f = _condensed_cost(h)
    summed = np.asarray(np.kron(np.tril(np.ones((N, N))), np.eye(r)))  # S, (3.105)
    shift = np.zeros((N * r, h.width))
    shift[:, h.parameters[3]] = -np.kron(np.ones((N, 1)), np.eye(r))  # -c, (3.106)
    if h.rate is None:
        return Quadratic(H, f, summed, shift, np.ones(N * r), 0)
    bound = np.concatenate([np.tile(h.rate, N), np.ones(N * r)])
    return Quadratic(H, f, summed, np.vstack([np.zeros_like(shift), shift]), bound, N * r)


def unconstrained_gain(h: Horizon, problem: Quadratic) -> Array:
    """Gain G of u_0 = G theta without limits, from the optimality conditions; shape (r, width)."""
    keep = problem.equal[problem.simple :]
    E, e = problem.rows[keep], problem.shift[problem.simple :][keep]
    nz, ne = len(problem.H), len(E)
    conditions = np.block([[problem.H, E.T], [E, np.zeros((ne, ne))]])
    solution = np.linalg.solve(conditions, np.vstack([-problem.f, e]))
    return np.ascontiguousarray(solution[:nz][: h.sizes[1]])


def _model_rows(h: Horizon) -> tuple[Array, Array]:
    """x_{i+1} - A x_i - B u_i = B d_i over (u, x), and the right-hand side over theta."""
    (n, _, _), N = h.sizes, h.steps
    rows = np.hstack([-h.over(h.B), np.eye(N * n) - np.kron(np.eye(N, k=-1), h.A)])
    right = np.zeros((N * n, h.width))
    right[:n, h.parameters[0]] = h.A
    right[:, h.parameters[2]] = h.over(h.B)
    return rows, right


def _condensed_cost(h: Horizon) -> tuple[Array, Array]:
    O, F = h.prediction  # noqa: E741 - the literature's name
    weighted = F.T @ h.over(h.Q)
    f = np.zeros((F.shape[1], h.width))
    state, reference, known, _ = h.parameters
    f[:, state], f[:, reference], f[:, known] = weighted @ O, -weighted, weighted @ F
    return weighted @ F + h.over(h.P), f


OPTIMAL = 1
EQUALITY = 5  # daqp's code of an equality constraint
CONSTRAINT_TOLERANCE = 1e-9  # of the constraints, as a fraction of the limits


class Solver:
    """Solve a quadratic program repeatedly, for different parameters theta."""

    def __init__(self, problem: Quadratic) -> None:
        equal = problem.equal
        E, e = problem.rows[equal[problem.simple :]], problem.shift[equal]
        rho = float(np.max(np.abs(problem.H))) / max(float(np.linalg.norm(E, 2)) ** 2, 1.0)
        rho = rho if len(E) else 0.0
        scale = 1.0 / float(np.mean(np.abs(np.diag(problem.H))))
        self.H = scale * (problem.H + rho * E.T @ E)  # an attribute: daqp does not copy it
        self.f = scale * (problem.f - rho * E.T @ e)
        self.shift, self.bound = problem.shift, problem.bound
        self.moving = bool(np.any(self.shift != 0.0))
        self.rows = np.ascontiguousarray(problem.rows)
        sense = np.where(equal, EQUALITY, 0).astype(np.int32)
        self.model = daqp.Model()
        self.model.settings = {"primal_tol": CONSTRAINT_TOLERANCE}
        flag, _ = self.model.setup(
            self.H, np.zeros(len(self.H)), self.rows, self.bound, -self.bound, sense
        )
        self.ready = flag >= 0

    def solve(self, theta: Array) -> Array | None:
        """The solution z (nz,) for parameters theta (width,); None if the solver found none."""
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
