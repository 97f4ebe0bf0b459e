"""The optimal control problem of `nmpc` as a nonlinear program, by direct multiple shooting.

    min  sum |y_k - y_d,k|^2_Q + |u_k - u_{k-1}|^2_P + w' (s_k + s_k^2)
    x_{k+1} = f(x_k, u_k),    x = (eta, nu, what acts, u_{k-1})
    n' (p + R(psi) v) >= d - s_1    for every line (n, d) and corner v of the hull
    |nu| <= (1 + s_2) limit,    |u_k - u_{k-1}| <= limit of the rate,    |u_k| <= 1

u and what acts are shares of the limits; f is a step of the classical Runge-Kutta method with the
force at its start, middle and end, which follows the held u by a first-order lag. Bock and Plitt
(1984); free space as in Martinsen et al. (2019). All numbers are parameters, so that one program
holds for all tables of the same terms. It is compiled once and kept with the kernels' machine code.
"""

import hashlib
import logging
import os
import shutil
import subprocess
import tempfile
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

from seatrial.models.compiled import cache_folder
from seatrial.models.simulation.casadi_rates import coefficients, rates_function
from seatrial.models.source_digest import replace_file
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.plant_table import PlantTable
from seatrial.models.vessel.pose import kinematics_of

if TYPE_CHECKING:
    ca: Any
else:
    import lazy_loader

    ca = lazy_loader.load("casadi")  # an extra

log = logging.getLogger(__name__)
FLAGS = "-O1", "-march=native", "-fPIC", "-shared"
ROUNDING = 1e-3  # of magnitudes [m/s, rad/s]; without it their kinks stop the iterations
NUMBERS = "entries", "inverse_inertia", "parameters"  # of a table, which are parameters
SOLVERS: dict[str, dict[str, Any]] = {
    "fatrop": {"print_level": 0, "tolerance": 1e-6, "mu_init": 1e-2, "max_iter": 100},
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-6, "mu_init": 1e-2, "max_iter": 200},
}
# derivatives of a step by whole Jacobians without common subexpressions
WHOLE = {"cse": True, "never_inline": True, "jac_penalty": 0}


class ProgramStructure(NamedTuple):
    """What a program is compiled for."""

    dofs: tuple[str, ...]
    lagging: bool  # what acts follows the command by a lag
    steps: int
    lines: int  # between hull and obstacles at every step
    corners: int  # of the hull
    limited_speed: bool
    limited_rate: bool
    solver: str


_KNOWN: dict[str, Any] = {}  # solvers, by the digest of their program


class Program:
    """Sizes and functions of a program; `plant` is a table with its terms."""

    def __init__(self, structure: ProgramStructure, plant: PlantTable) -> None:
        self.structure, self.plant = structure, plant
        self.n = n = len(structure.dofs)
        self.kinematics = kinematics_of(structure.dofs)
        self.states = 3 * n + n * structure.lagging
        limits = {"distance": structure.lines > 0, "speed": structure.limited_speed}
        self.slacks = [name for name, limited in limits.items() if limited]
        self.unknowns = n + len(self.slacks)
        self.paths = structure.lines * structure.corners + 2 * n * structure.limited_speed
        self.rates = n * structure.limited_rate
        self.stage = n, n, 2, 3 * structure.lines  # target, force in NED, wind, lines
        self.shared = (  # step, decay, limits, weights, speeds, hull, coefficients
            1, 1, n, n, n, len(self.slacks), n, 2 * structure.corners, len(coefficients(plant)),
        )  # fmt: skip

    @property
    def width(self) -> int:
        """Number of unknowns of a stage with its state."""
        return self.states + self.unknowns

    @property
    def length(self) -> int:
        """Number of all unknowns."""
        return self.structure.steps * self.width + self.states

    @property
    def rows(self) -> list[int]:
        """Number of constraints of every stage, without those of the step."""
        own = self.paths + self.rates
        return [self.states + own, *[own] * (self.structure.steps - 1), 0]

    def functions(self) -> tuple[Any, Any, Any]:
        """A step f, the cost and the constraints of a stage, of (x, unknowns, stage, shared)."""
        n, lagging = self.n, self.structure.lagging
        x, w = ca.SX.sym("x", self.states), ca.SX.sym("w", self.unknowns)
        q, c = ca.SX.sym("q", sum(self.stage)), ca.SX.sym("c", sum(self.shared))
        h, decay, scale, error, change, weight, speed, hull, numbers = _split(c, self.shared)
        target, force, wind, lines = _split(q, self.stage)
        moved, last, u, s = x[: 2 * n], x[self.states - n :], w[:n, 0], w[n:, 0]
        acting = [u, u, u]
        if lagging:
            acting[0] = x[2 * n : 3 * n]
            for i in range(2):
                acting[i + 1] = decay * acting[i] + (1.0 - decay) * u
        model = rates_function(self.kinematics, self.plant, ROUNDING)

        def rate(at: Any, share: Any) -> Any:
            still = ca.SX(2, 1)
            return ca.vertcat(*model(at[:n], at[n:], share * scale, force, wind, still, numbers))

        k1 = rate(moved, acting[0])
        k2 = rate(moved + 0.5 * h * k1, acting[1])
        k3 = rate(moved + 0.5 * h * k2, acting[1])
        k4 = rate(moved + h * k3, acting[2])
        ahead = moved + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        after = ca.vertcat(ahead, *[acting[2]][: int(lagging)], u)
        cost = ca.sum1(error * (x[:n] - target) ** 2) + ca.sum1(change * (u - last) ** 2)
        cost += ca.sum1(weight * (s + s**2))
        rows = self._lines(x, lines, hull, s)
        if self.structure.limited_speed:
            share = x[n : 2 * n] / speed
            rows += [1.0 - share + s[-1], 1.0 + share + s[-1]]
        if self.structure.limited_rate:
            rows.append(u - last)
        of, known = [x, w, q, c], {"is_diff_in": [True, True, False, False]}
        jacobian = {"jacobian_options": WHOLE | {"jacobian_options": {"cse": True}}}
        return (
            ca.Function("f", of, [ca.cse(after)], {**known, **WHOLE, **jacobian}),
            ca.Function("cost", of, [cost], known),
            ca.Function("path", of, [ca.vertcat(*rows)], known),
        )

    @cached_property
    def step(self) -> Any:
        """A step f of (x, unknowns, stage, shared)."""
        return self.functions()[0]

    def _lines(self, x: Any, lines: Any, hull: Any, slack: Any) -> list[Any]:
        """Distances of the corners of the hull from the lines, which must not be negative."""
        rows = []
        for i in range(self.structure.lines):
            north, east, least = lines[3 * i], lines[3 * i + 1], lines[3 * i + 2]
            ahead = north * ca.cos(x[2]) + east * ca.sin(x[2])
            aside = east * ca.cos(x[2]) - north * ca.sin(x[2])
            centre = north * x[0] + east * x[1] - least + slack[0]
            for j in range(self.structure.corners):
                rows.append(centre + ahead * hull[2 * j] + aside * hull[2 * j + 1])
        return rows

    def problem(self) -> dict[str, Any]:
        """The program for CasADi: unknowns (x_0, w_0, ..., x_N), parameters (x_0, shared, stages).

        The constraints are, stage after stage, the step, of the first the start, and the others.
        """
        steps, nx, stage = self.structure.steps, self.states, sum(self.stage)
        f, cost, path = self.functions()
        z, p = ca.MX.sym("z", self.length), ca.MX.sym("p", self.parameters)
        start, shared, stages = _split(p, (nx, sum(self.shared), stage * (steps + 1)))
        columns, last = ca.reshape(z[: steps * self.width], self.width, steps), z[-nx:]
        x, w = columns[:nx, :], columns[nx:, :]
        q = ca.reshape(stages, stage, steps + 1)
        of = x, w, q[:, :steps], ca.repmat(shared, 1, steps)
        gaps = ca.horzcat(x[:, 1:], last) - f.map(steps)(*of)
        end = cost(
            last, ca.vertcat(last[nx - self.n :], ca.DM(len(self.slacks), 1)), q[:, steps], shared
        )
        rows = path.map(steps)(*of) if self.paths + self.rates else ca.MX(0, steps)
        others = ca.vec(ca.vertcat(gaps[:, 1:], rows[:, 1:]))
        g = ca.vertcat(gaps[:, 0], x[:, 0] - start, rows[:, 0], others)
        return {"x": z, "p": p, "f": ca.sum2(cost.map(steps)(*of)) + end, "g": g}

    @property
    def parameters(self) -> int:
        """Number of all parameters."""
        return self.states + sum(self.shared) + sum(self.stage) * (self.structure.steps + 1)

    def stages(self, plan: Array) -> Array:
        """State and unknowns of all stages but the last, shape (steps, width)."""
        return plan[: -self.states].reshape(-1, self.width)

    def bounds(self, change: Array) -> dict[str, Array]:
        """Bounds of unknowns and constraints, for the largest changes of the command (n,)."""
        high, nx, n = np.full(self.length, np.inf), self.states, self.n
        low = -high
        self.stages(low)[:, nx : nx + n], self.stages(high)[:, nx : nx + n] = -1.0, 1.0
        self.stages(low)[:, nx + n :] = 0.0
        least = np.concatenate([np.zeros(self.paths), -change[: self.rates]])
        most = np.concatenate([np.full(self.paths, np.inf), change[: self.rates]])
        gap, later = np.zeros(nx), self.structure.steps - 1
        rows = (np.concatenate([gap, gap, o, *[gap, o] * later]) for o in (least, most))
        return dict(zip(("lbx", "ubx", "lbg", "ubg"), (low, high, *rows), strict=True))

    @cached_property
    def solver(self) -> Any:
        """The solver, made once in a process, on compiled functions if there is a C compiler."""
        if self.digest not in _KNOWN:
            name, steps = self.structure.solver, self.structure.steps
            options = {"print_time": False, "error_on_fail": False, name: SOLVERS[name]}
            if name == "fatrop":
                options |= {
                    "structure_detection": "manual", "N": steps, "ng": self.rows,
                    "nx": [self.states] * (steps + 1), "nu": [*[self.unknowns] * steps, 0],
                }  # fmt: skip
            library = self._library(options)
            _KNOWN[self.digest] = ca.nlpsol("nmpc", name, library or self.problem(), options)
        return _KNOWN[self.digest]

    @cached_property
    def digest(self) -> str:
        """Of all that the functions depend on, without the numbers of the table."""
        terms = {k: _plain(v) for k, v in self.plant._asdict().items() if k not in NUMBERS}
        key = self.structure, terms, len(self.plant.parameters), ca.__version__, FLAGS, ROUNDING
        return hashlib.sha256(repr((*key, get_host_cpu_name())).encode()).hexdigest()[:32]

    def _library(self, options: dict[str, Any]) -> str | None:
        """The file of the compiled functions; None without a C compiler."""
        file = cache_folder() / f"nmpc-{self.digest}.so"
        if file.exists():
            return str(file)
        compiler = os.environ.get("CC") or shutil.which("cc")
        if compiler is None:
            _say("no C compiler: CasADi interprets the program of nmpc, about ten times as slow")
            return None
        log.info("compiling the program of nmpc (about 20 s, once for these terms and horizon)")
        with tempfile.TemporaryDirectory() as folder:
            source, built = Path(folder) / "nmpc.c", Path(folder) / "nmpc.so"
            interpreted = ca.nlpsol("nmpc", self.structure.solver, self.problem(), options)
            source.write_text(_source(interpreted))
            command = [*compiler.split(), *FLAGS, str(source), "-o", str(built)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                _say(
                    f"{compiler} failed, CasADi interprets the program of nmpc: {done.stderr[:80]}"
                )
                return None
            replace_file(file, built.read_bytes())
        return str(file)


def _source(solver: Any) -> str:
    """The C code of the functions that a solver calls."""
    code = ca.CodeGenerator("nmpc")
    code.add(solver.oracle())
    for name in solver.get_function():
        code.add(solver.get_function(name))
    text: str = code.dump()
    return text


def _split(vector: Any, sizes: tuple[int, ...]) -> list[Any]:
    """The parts of a vector of these sizes."""
    parts: list[Any] = ca.vertsplit(vector, np.cumsum([0, *sizes]).tolist())
    return parts


def _plain(value: object) -> object:
    """An entry of a table, printed in full."""
    return value.tolist() if isinstance(value, np.ndarray) else value


@lru_cache
def _say(message: str) -> None:
    """Log a message, once."""
    log.warning(message)
