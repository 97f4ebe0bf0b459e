"""Nonlinear model predictive control of the pose, on the equation of motion of the model itself.

At every command this problem is solved from the estimated state and unknown force, with the
reference and the wind that are known in advance, by direct multiple shooting:

    min  sum |y_k - y_d,k|^2_Q + |u_k - u_{k-1}|^2_P + w (s_k + s_k^2)
    x_{k+1} = f(x_k, u_k),    x = (eta, nu, what acts, u_{k-1})
    n' (p + R(psi) v) >= d - s    for every line (n, d) and corner v of the hull
    |u_k - u_{k-1}| <= limit of the rate,    |u_k| <= 1

u and what acts are shares of the limits; f is a step of the classical Runge-Kutta method with the
force at its start, middle and end, which follows the held u by a first-order lag. Bock and Plitt
(1984); free space as in Martinsen et al. (2019). All numbers are parameters, so that one program
holds for all tables of the same terms. It is compiled once and kept with the kernels' machine code.

The gain of the estimate is that of `estimator`, the prediction that of the model itself. The last
plan, moved on by a step, is the first guess; where the mission has obstacles, each pose of it
gives the lines to the nearest ones (`separating_lines`), beyond which the hull stays; the slack s
keeps the problem feasible. If no solution is found, the command is that of the last plan.
"""

import hashlib
import logging
import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le
from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

from seatrial.models.compiled import cache_folder
from seatrial.models.control.controller import (
    Model,
    PythonController,
    PythonTable,
    Signals,
    table_of,
)
from seatrial.models.control.estimator import (
    Estimator,
    Kalman,
    Memory,
    Observer,
    correct,
    estimate,
    estimator_diagnostics,
    heading,
    memory,
    observer_of,
    to_axes,
)
from seatrial.models.control.linear_design import DesignModel, check_weights, design_model
from seatrial.models.control.mpc import Preview
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.harbour import separating_lines
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.simulation.symbolic_rates import n_acting, symbolic_rates
from seatrial.models.simulation.voyage import NO_OUTLOOK, Outlook
from seatrial.models.source_digest import replace_file
from seatrial.models.symbols import ENTRY, entries, evaluate
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned
from seatrial.models.vessel.plant_table import PlantTable
from seatrial.models.vessel.pose import Kinematics, Quaternion, kinematics_of
from seatrial.models.vessel.scales import GRAVITY
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.wind import WindForce

if TYPE_CHECKING:
    ca: Any
else:
    import lazy_loader

    ca = lazy_loader.load("casadi")  # an extra

log = logging.getLogger(__name__)
NOWHERE = 1e6  # [m] that a line without an obstacle is away
FLAGS = "-O1", "-march=native", "-fPIC", "-shared"
ROUNDING = 1e-3  # of magnitudes [m/s, rad/s]; without it their kinks stop the iterations
SMALLEST = 1e-24  # under a square root, whose derivative is then finite at rest
NUMBERS = "entries", "inverse_inertia", "parameters"  # of a table, which are parameters
SOLVERS: dict[str, dict[str, Any]] = {
    "fatrop": {"print_level": 0, "tolerance": 1e-6, "mu_init": 1e-2, "max_iter": 100},
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-6, "mu_init": 1e-2, "max_iter": 200},
}
# derivatives of a step by whole Jacobians without common subexpressions
WHOLE = {"cse": True, "never_inline": True, "jac_penalty": 0}
ARGUMENTS = "eta", "nu", "acting", "force", "wind", "current", "coefficients"
SPELLED = {
    "add": "plus", "subtract": "minus", "multiply": "times", "divide": "rdivide",
    "absolute": "fabs", "minimum": "fmin", "maximum": "fmax", "less": "lt", "less_equal": "le",
    "greater": "gt", "greater_equal": "ge", "where": "if_else", "arctan2": "atan2",
}  # fmt: skip


@lru_cache
def solver_of(wanted: str) -> str:
    """The solver by its name; ipopt where this build of CasADi lacks it, which is logged once.

    Raises ConfigurationError if CasADi is not installed.
    """
    try:
        known = ca.has_nlpsol(wanted)
    except ModuleNotFoundError as error:
        raise ConfigurationError("casadi is not installed: pip install 'seatrial[nmpc]'") from error
    if not known:
        log.warning("this build of CasADi lacks %s: ipopt solves the problems of nmpc", wanted)
    return wanted if known else "ipopt"


def coefficients(plant: PlantTable) -> Array:
    """The numbers of a table: its entries, those of M^-1 that can be non-zero, its devices'."""
    inverse = plant.inverse_inertia[np.asarray(plant.coupled)]
    return np.concatenate([plant.entries, inverse, plant.parameters])


def rates_function(kinematics: Kinematics, plant: PlantTable, rounding: float = 0.0) -> Any:
    """The function (eta, nu, acting, force, wind, current, coefficients) -> (eta_dot, nu_dot).

    Arguments are those of `symbolic_rates`; `coefficients` are those of any table of the same
    structure. With a `rounding` e, |x| is sqrt(x^2 + e^2), which has derivatives for an optimiser.
    """
    n = len(plant.velocity_index)
    n_pose = n + isinstance(kinematics, Quaternion)
    numbers = entries("coefficients", len(coefficients(plant)))
    of_table, of_devices = len(plant.entries), len(numbers) - len(plant.parameters)
    inverse = np.zeros((n, n), dtype=object)
    inverse[np.asarray(plant.coupled)] = numbers[of_table:of_devices]
    symbolic = plant._replace(
        entries=numbers[:of_table], inverse_inertia=inverse, parameters=numbers[of_devices:]
    )
    sizes = n_pose, n, n_acting(plant), n, 2, 2, len(numbers)
    given = {name: ca.SX.sym(name, size) for name, size in zip(ARGUMENTS, sizes, strict=True)}

    def apply(operation: str, operands: Any, uses: int) -> Any:
        if operation == ENTRY:
            name, index = operands
            return given[name][index]
        if operation == "negative":
            return -operands[0]
        if operation == "absolute" and rounding:
            return ca.sqrt(operands[0] ** 2 + rounding**2)
        if operation == "sqrt":
            return ca.sqrt(operands[0] + SMALLEST)
        return getattr(ca, SPELLED.get(operation, operation))(*operands)

    outputs = [
        ca.vertcat(*evaluate(list(rates), apply))
        for rates in symbolic_rates(kinematics, symbolic, disturbed=True)
    ]
    return ca.Function("rates", [*given.values()], outputs, [*ARGUMENTS], ["eta_dot", "nu_dot"])


def _split(vector: Any, sizes: tuple[int, ...]) -> list[Any]:
    """The parts of a vector of these sizes."""
    parts: list[Any] = ca.vertsplit(vector, np.cumsum([0, *sizes]).tolist())
    return parts


@lru_cache
def _say(message: str) -> None:
    """Log a message, once."""
    log.warning(message)


_KNOWN: dict[str, Any] = {}  # solvers, by the digest of their program


@dataclass(eq=False)
class Program:
    """The program of what it is compiled for; `plant` is a table with its terms."""

    plant: PlantTable
    dofs: tuple[str, ...]
    lagging: bool  # what acts follows the command by a lag
    steps: int
    lines: int  # between hull and obstacles at every step
    corners: int  # of the hull
    limited_rate: bool
    solver_name: str

    def __post_init__(self) -> None:
        self.n = n = len(self.dofs)
        self.slacks = int(self.lines > 0)
        self.states = 3 * n + n * self.lagging
        self.width = self.states + n + self.slacks  # unknowns of a stage
        self.length = self.steps * self.width + self.states  # unknowns of all
        self.paths, self.rates = self.lines * self.corners, n * self.limited_rate
        self.stage = n, n, 2, 3 * self.lines  # target, force in NED, wind, lines
        self.shared = (  # step, decay, limits, weights, hull, coefficients
            1, 1, n, n, n, self.slacks, 2 * self.corners, len(coefficients(self.plant)),
        )  # fmt: skip

    def functions(self) -> tuple[Any, Any, Any]:
        """A step f, the cost and the constraints of a stage, of (x, unknowns, stage, shared)."""
        n = self.n
        x, w = ca.SX.sym("x", self.states), ca.SX.sym("w", self.n + self.slacks)
        q, c = ca.SX.sym("q", sum(self.stage)), ca.SX.sym("c", sum(self.shared))
        h, decay, scale, error, change, weight, hull, numbers = _split(c, self.shared)
        target, force, wind, lines = _split(q, self.stage)
        moved, last, u, s = x[: 2 * n], x[self.states - n :], w[:n, 0], w[n:, 0]
        acting = [u, u, u]
        if self.lagging:
            acting[0] = x[2 * n : 3 * n]
            for i in range(2):
                acting[i + 1] = decay * acting[i] + (1.0 - decay) * u
        model = rates_function(kinematics_of(self.dofs), self.plant, ROUNDING)

        def rate(at: Any, share: Any) -> Any:
            still = ca.SX(2, 1)
            return ca.vertcat(*model(at[:n], at[n:], share * scale, force, wind, still, numbers))

        k1 = rate(moved, acting[0])
        k2 = rate(moved + 0.5 * h * k1, acting[1])
        k3 = rate(moved + 0.5 * h * k2, acting[1])
        k4 = rate(moved + h * k3, acting[2])
        ahead = moved + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        after = ca.vertcat(ahead, *[acting[2]][: int(self.lagging)], u)
        cost = ca.sum1(error * (x[:n] - target) ** 2) + ca.sum1(change * (u - last) ** 2)
        cost += ca.sum1(weight * (s + s**2))
        rows = []
        for i in range(self.lines):  # distances of the corners of the hull from the lines
            north, east, least = lines[3 * i], lines[3 * i + 1], lines[3 * i + 2]
            ahead = north * ca.cos(x[2]) + east * ca.sin(x[2])
            aside = east * ca.cos(x[2]) - north * ca.sin(x[2])
            centre = north * x[0] + east * x[1] - least + s[0]
            for j in range(self.corners):
                rows.append(centre + ahead * hull[2 * j] + aside * hull[2 * j + 1])
        if self.limited_rate:
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

    def problem(self) -> dict[str, Any]:
        """The program for CasADi: unknowns (x_0, w_0, ..., x_N), parameters (x_0, shared, stages).

        The constraints are, stage after stage, the step, of the first the start, and the others.
        """
        steps, nx, stage = self.steps, self.states, sum(self.stage)
        f, cost, path = self.functions()
        sizes = nx, sum(self.shared), stage * (steps + 1)
        z, p = ca.MX.sym("z", self.length), ca.MX.sym("p", sum(sizes))
        start, shared, stages = _split(p, sizes)
        columns, last = ca.reshape(z[: steps * self.width], self.width, steps), z[-nx:]
        x, w = columns[:nx, :], columns[nx:, :]
        q = ca.reshape(stages, stage, steps + 1)
        of = x, w, q[:, :steps], ca.repmat(shared, 1, steps)
        gaps = ca.horzcat(x[:, 1:], last) - f.map(steps)(*of)
        end = cost(
            last, ca.vertcat(last[nx - self.n :], ca.DM(self.slacks, 1)), q[:, steps], shared
        )
        rows = path.map(steps)(*of) if self.paths + self.rates else ca.MX(0, steps)
        others = ca.vec(ca.vertcat(gaps[:, 1:], rows[:, 1:]))
        g = ca.vertcat(gaps[:, 0], x[:, 0] - start, rows[:, 0], others)
        return {"x": z, "p": p, "f": ca.sum2(cost.map(steps)(*of)) + end, "g": g}

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
        gap, later = np.zeros(nx), self.steps - 1
        rows = (np.concatenate([gap, gap, o, *[gap, o] * later]) for o in (least, most))
        return dict(zip(("lbx", "ubx", "lbg", "ubg"), (low, high, *rows), strict=True))

    @cached_property
    def solver(self) -> Any:
        """The solver, made once in a process, on compiled functions if there is a C compiler."""
        structure = [getattr(self, field.name) for field in fields(self)[1:]]
        terms = {k: v.tolist() if isinstance(v, np.ndarray) else v
                 for k, v in self.plant._asdict().items() if k not in NUMBERS}  # fmt: skip
        key = structure, terms, ca.__version__, FLAGS, ROUNDING, get_host_cpu_name()
        digest = hashlib.sha256(repr((*key, self.shared)).encode()).hexdigest()[:32]
        if digest not in _KNOWN:
            name, steps, own = self.solver_name, self.steps, self.paths + self.rates
            options = {"print_time": False, "error_on_fail": False, name: SOLVERS[name]}
            if name == "fatrop":
                options |= {
                    "structure_detection": "manual", "N": steps,
                    "ng": [self.states + own, *[own] * (steps - 1), 0],
                    "nx": [self.states] * (steps + 1), "nu": [*[self.n + self.slacks] * steps, 0],
                }  # fmt: skip
            file = cache_folder() / f"nmpc-{digest}.so"
            known = file.exists() or self._compiled(file, options)
            problem = str(file) if known else self.problem()
            _KNOWN[digest] = ca.nlpsol("nmpc", name, problem, options)
        return _KNOWN[digest]

    def _compiled(self, file: Path, options: dict[str, Any]) -> bool:
        """Compile the functions that the solver calls; false without a C compiler."""
        compiler = os.environ.get("CC") or shutil.which("cc")
        if compiler is None:
            _say("no C compiler: CasADi interprets the program of nmpc, about ten times as slow")
            return False
        log.info("compiling the program of nmpc (about 20 s, once for these terms and horizon)")
        interpreted = ca.nlpsol("nmpc", self.solver_name, self.problem(), options)
        code, called = ca.CodeGenerator("nmpc"), interpreted.get_function()
        for function in (interpreted.oracle(), *map(interpreted.get_function, called)):
            code.add(function)
        with tempfile.TemporaryDirectory() as folder:
            source, built = Path(folder) / "nmpc.c", Path(folder) / "nmpc.so"
            source.write_text(code.dump())
            command = [*compiler.split(), *FLAGS, str(source), "-o", str(built)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                said = done.stderr[:80]
                _say(f"{compiler} failed, CasADi interprets the program of nmpc: {said}")
                return False
            replace_file(file, built.read_bytes())
        return True


class NmpcDesign(NamedTuple):
    """The problem of a model and an outlook."""

    model: Vessel
    observer: Observer
    every: int  # number of loop instants between two commands
    step_s: float
    outlook: Outlook
    program: Program
    shared: Array  # parameters of all stages
    bounds: dict[str, Array]  # of unknowns and constraints


@dataclass
class NmpcMemory:
    """State between two samples; forces are shares of the limits."""

    estimated: Memory
    acting: Array  # (r,) by the lag
    command: Array  # (r,)
    plan: Array | None = None  # unknowns of the last problem
    slack: float = 0.0  # by which the hull was too near to an obstacle, at most so far [m]


@dataclass(frozen=True, kw_only=True)
class Nmpc(PythonController):
    """Nonlinear model predictive control of the pose by forces on the axes.

    `horizon` steps of `step` sqrt(L / g), after each of which there is a command. `error_weight`
    weighs the error of the pose [1/m^2, 1/rad^2], and `effort` times `input_weight` increments of
    the force in `period_s` as shares of `limits` [N, Nm]. The hull stays `margin` L away from the
    `lines` nearest obstacles; a violation by a length costs `slack_weight` times an error of one.
    """

    horizon: Annotated[int, Ge(2), Le(1000)]
    step: Positive
    preview: Preview
    error_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.error_weight")]
    input_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.increment_weight")]
    effort: Positive
    period_s: Annotated[Positive, FromVessel("tuning.control.period_s")]
    limits: Annotated[tuple[float, ...], FromVessel("force_limits")]
    rate_limits: tuple[float, ...] | None
    margin: NotNegative
    lines: Annotated[int, Ge(1), Le(20)]
    slack_weight: Positive
    solver: Literal["fatrop", "ipopt"]
    estimator: Estimator
    kalman: Kalman
    wind: Annotated[WindForce | None, FromVessel("tuning.windage")]
    thruster: Annotated[SecondOrderLag | None, FromVessel("thruster")] = None
    length_m: Annotated[Positive, FromVessel("scales.length_m")]

    def __post_init__(self) -> None:
        check_ranges(self)
        n = len(self.limits)
        check_weights("error_weight", self.error_weight, n, positive=False)
        for name in ("limits", "input_weight", "rate_limits"):
            values = getattr(self, name)
            if values is not None:
                check_weights(name, values, n, positive=True)
        solver_of(self.solver)

    @property
    def margin_m(self) -> float:
        """Distance of the hull from obstacles [m]."""
        return self.margin * self.length_m

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        step_s = self.step * float(np.sqrt(self.length_m / GRAVITY))
        return max(1, round(step_s / period_s))

    def preview_rows(self, period_s: float) -> int:
        """Number of loop instants by which a step of the reference is known in advance."""
        return 0 if self.preview == "none" else self.horizon * self.command_rows(period_s)

    def command_limits(self) -> tuple[float, ...]:
        """The limits of the force [N, Nm], and of the thrusters."""
        most = None if self.thruster is None else self.thruster.amplitude_limit
        return tuple(np.minimum(self.limits, most or np.inf).tolist())

    def failures(self, state: NmpcMemory) -> int:
        """Number of problems that were not solved."""
        return int(state.estimated.failures[0])

    def findings(self, state: NmpcMemory) -> list[Diagnostic]:
        """The largest violation of the distance from obstacles."""
        return [Diagnostic("slack_distance", "all", state.slack, "m")] if state.slack else []

    def linear(self, model: Model, period_s: float) -> tuple[DesignModel, Observer]:
        """The linear model at the period of the commands, and its estimator."""
        own = self.command_rows(period_s) * period_s
        design = design_model(table_of(model), self.command_limits(), own, self.wind)
        return design, observer_of(design, self.estimator, self.kalman)

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Order, controllability and spectral radius of the estimator, and the step."""
        design, observer = self.linear(model, period_s)
        step = Diagnostic("horizon_step", "all", design.period_s, "s")
        return [*design.diagnostics(), *estimator_diagnostics(observer), step]

    def design(self, model: Model, period_s: float) -> NmpcDesign:
        """The problem in calm, open water."""
        every, (_, observer) = self.command_rows(period_s), self.linear(model, period_s)
        return self._problem(table_of(model), observer, every, every * period_s, NO_OUTLOOK)

    def start(self, design: NmpcDesign) -> NmpcMemory:
        """At rest, without a plan."""
        n = design.program.n
        return NmpcMemory(memory(2 * n, n, n), np.zeros(n), np.zeros(n))

    def foresee(self, parameters: PythonTable, outlook: Outlook) -> PythonTable:
        """The parameters with reference, wind and obstacles; its program is compiled."""
        known = parameters.design
        design = self._problem(known.model, known.observer, known.every, known.step_s, outlook)
        assert design.program.solver is not None
        return parameters._replace(design=design)

    def _problem(
        self, model: Vessel, observer: Observer, every: int, step_s: float, outlook: Outlook
    ) -> NmpcDesign:
        """The program for a model and an outlook, its shared parameters and its bounds."""
        n, own = len(model.dofs), model
        if len(outlook.wind_ned) and self.wind and not model.force_table().aerodynamic:
            own = model + self.wind.table(model.dofs)
        plant, lag, limits = own.plant_table(), self.thruster, self.command_limits()
        most = np.minimum(self.rate_limits or np.inf, (lag and lag.rate_limit) or np.inf)
        change = np.broadcast_to(most, n) * step_s / limits  # largest in a step
        hull = outlook.hull if outlook.obstacles and outlook.hull is not None else np.zeros((0, 2))
        program = Program(
            plant, model.dofs, lag is not None, self.horizon, self.lines if len(hull) else 0,
            len(hull), bool(np.any(np.isfinite(change))), solver_of(self.solver),
        )  # fmt: skip
        error = np.array(self.error_weight) / max(self.error_weight)  # tolerances are absolute
        effort = self.effort * np.array(self.input_weight) / max(self.error_weight)
        shared = np.concatenate([
            [step_s, 0.0 if lag is None else float(np.exp(-0.5 * step_s / lag.delay_s))], limits,
            error, effort * (self.period_s / step_s) ** 2,
            [self.slack_weight * self.length_m] * program.slacks, hull.ravel(), coefficients(plant),
        ])  # fmt: skip
        bounds = program.bounds(np.minimum(change, 2.0))
        return NmpcDesign(model, observer, every, step_s, outlook, program, shared, bounds)

    def command(self, design: NmpcDesign, state: NmpcMemory, now: Signals) -> Array:
        """The first force of the best plan; without a solution that of the last plan."""
        past, observer, n = state.estimated, design.observer, design.program.n
        if past.instant[0] % design.every == 0:
            eta, nu = now.eta.copy(), now.nu.copy()
            if past.instant[0] == 0 or observer.measured:
                estimate(observer, past, eta, nu)
            else:
                correct(observer, past, eta)
            to_axes(observer.turning, heading(observer, past.x), past.x[n:], nu)
            lags = [state.acting] if self.thruster is not None else []
            at = np.concatenate([past.x[:n], nu, *lags, state.command])
            self._predict(design, state, at, self._solve(design, state, at, now.eta_d))
        past.instant[0] += 1
        return np.asarray(observer.limits * state.command)

    def _predict(self, design: NmpcDesign, state: NmpcMemory, at: Array, stage: Array) -> None:
        """Move the estimate to the next command on the model itself, whose error the bias is."""
        past, observer, program = state.estimated, design.observer, design.program
        n, added, stage = program.n, np.zeros(program.n), stage.copy()
        if past.instant[0] < len(design.outlook.added):
            force = design.outlook.added[past.instant[0]]
            to_axes(observer.turning, -heading(observer, past.x), force, added)
        stage[n : 2 * n] += added
        unknowns = np.concatenate([state.command, np.zeros(program.slacks)])
        ahead = np.asarray(program.step(at, unknowns, stage, design.shared)).ravel()
        past.x[:n], state.acting = ahead[:n], ahead[-2 * n : -n]
        to_axes(observer.turning, -heading(observer, past.x), ahead[n : 2 * n], past.x[n:])
        past.bias[:] *= observer.bias_decay

    def _solve(self, design: NmpcDesign, state: NmpcMemory, at: Array, eta_d: Array) -> Array:
        """Solve the problem from a state; writes plan, command and slack, returns a stage."""
        program, n = design.program, design.program.n
        width, nx = program.width, program.states
        if state.plan is None or len(state.plan) != program.length:
            rest = np.concatenate([at, state.command, np.zeros(program.slacks)])
            rest[n : 2 * n] = 0.0
            plan = np.tile(rest, self.horizon + 1)[: program.length]
        else:
            plan = np.concatenate([state.plan[width:], state.plan[-width:]])  # a step later
        plan[:nx] = at
        stages = self._stages(design, state.estimated, plan, eta_d)
        p = np.concatenate([at, design.shared, stages.ravel()])
        solution = program.solver(x0=plan, p=p, **design.bounds)
        if program.solver.stats()["success"]:
            plan = np.asarray(solution["x"]).ravel()
        else:
            state.estimated.failures[0] += 1
        state.plan, state.command = plan, np.clip(plan[nx : nx + n], -1.0, 1.0)
        slack = np.max(program.stages(plan)[:, nx + n :], initial=0.0)
        state.slack = max(state.slack, float(slack))
        return np.asarray(stages[0])

    def _stages(self, design: NmpcDesign, past: Memory, plan: Array, eta_d: Array) -> Array:
        """Parameters of all stages: target, disturbance, wind, lines; (horizon + 1, width)."""
        program, outlook, steps = design.program, design.outlook, self.horizon
        n, rows = program.n, past.instant[0] + design.every * np.arange(steps + 1)
        stages = np.zeros((steps + 1, sum(program.stage)))
        known = self.preview != "none" and len(outlook.reference)
        last = len(outlook.reference) - 1
        stages[:, :n] = outlook.reference[np.minimum(rows, last)] if known else eta_d
        if design.observer.turning:
            turns = np.round((stages[0, 2] - past.x[2]) / (2.0 * np.pi))
            stages[:, 2] -= 2.0 * np.pi * turns
        decay = design.observer.bias_decay ** np.arange(steps + 1)
        stages[:, n : 2 * n] = decay[:, None] * past.bias
        if len(outlook.wind_ned):  # measured, or known in advance
            coming = self.preview == "setpoint_and_wind"
            last = len(outlook.wind_ned) - 1
            wind = outlook.wind_ned[np.minimum(rows if coming else rows[0], last)]
            stages[:, 2 * n : 2 * n + 2] = wind
            if rows[0] < len(outlook.wind_noise):
                error = in_ned(outlook.wind_noise[rows[0]], heading(design.observer, past.x))
                stages[: 1 if coming else None, 2 * n : 2 * n + 2] += error
        if program.lines:
            assert outlook.hull is not None and outlook.obstacles is not None  # noqa: PT018
            poses = program.stages(plan)[:, :3]
            lines = separating_lines(outlook.hull, poses, outlook.obstacles, program.lines)
            lines[:, :, 2] = np.maximum(lines[:, :, 2], -NOWHERE) + self.margin_m
            stages[:steps, 2 * n + 2 :] = lines.reshape(steps, -1)
        return stages
