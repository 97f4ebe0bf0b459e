"""Nonlinear model predictive control of the pose, on the equation of motion of the model itself.

At every command this problem is solved from the estimated state and unknown force, with the
reference and the wind that are known in advance, by direct multiple shooting:

    min  sum |y_k - y_d,k|^2_Q + |u_k - u_{k-1}|^2_P + w (s_k + s_k^2)
    x_{k+1} = f(x_k, u_k),    x = (eta, nu, what acts, u_{k-1})
    n' (p + R(psi) v) >= d - s    for every line (n, d) and corner v of the hull
    |u_k - u_{k-1}| <= limit of the rate,    |u_k| <= 1,    F u_k <= 1

u and what acts are shares of the limits; f is a step of the classical Runge-Kutta method with the
force at its start, middle and end, which follows the held u by a first-order lag. F are the `faces`
of what thrusters give together; of devices the lag is that of the slowest drive, the rate that of
full thrust turned with the slowest azimuth. Bock and Plitt (1984); free space as in Martinsen et
al. (2019). All numbers are parameters: one program, compiled once, holds for tables of these terms.

The gain of the estimate is that of `estimator`, the prediction that of the model itself. The last
plan, moved on by a step, is the first guess. Each pose of it gives the lines to the nearest
obstacles (`separating_lines`), beyond which the hull stays; the slack s keeps the problem feasible.
Where fatrop finds no solution, ipopt is asked; without one the command is that of the last plan.
"""

import hashlib
import logging
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Ge, Le
from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

from seatrial.models.compiled import cache_folder
from seatrial.models.control import controller, estimator
from seatrial.models.control.controller import Model
from seatrial.models.control.linear_design import check_weights, design_model
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
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.plant_table import PlantTable
from seatrial.models.vessel.pose import Kinematics, kinematics_of
from seatrial.models.vessel.scales import GRAVITY
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.wind import WindForce

if TYPE_CHECKING:
    ca: Any
else:
    import lazy_loader

    # An extra, of which lazy_loader may wait for itself where it is missing.
    ca = lazy_loader.load("casadi") if find_spec("casadi") else None

log = logging.getLogger(__name__)
FLAGS = "-O1", "-march=native", "-fPIC", "-shared"
ROUNDING = 1e-3  # of magnitudes [m/s, rad/s]; without it their kinks stop the iterations
SMALLEST = 1e-24  # under a square root, whose derivative is then finite at rest
SOLVERS: dict[str, dict[str, Any]] = {  # the next one where one fails
    "fatrop": {"print_level": 0, "tolerance": 1e-6, "mu_init": 1e-2, "max_iter": 100},
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-6, "mu_init": 1e-2, "max_iter": 200},
}
WHOLE = {"cse": True, "never_inline": True, "jac_penalty": 0}  # Jacobians, of a whole step
ARGUMENTS = "eta", "nu", "acting", "force", "wind", "current", "coefficients"
SPELLED = {
    "add": "plus", "subtract": "minus", "multiply": "times", "divide": "rdivide",
    "absolute": "fabs", "minimum": "fmin", "maximum": "fmax", "less": "lt", "less_equal": "le",
    "greater": "gt", "greater_equal": "ge", "where": "if_else", "arctan2": "atan2",
}  # fmt: skip


@lru_cache
def solvers() -> list[str]:
    """The names of the solvers that this build of CasADi has; ConfigurationError without CasADi."""
    if ca is None:
        raise ConfigurationError("casadi is not installed: pip install 'seatrial[nmpc]'")
    return [name for name in SOLVERS if ca.has_nlpsol(name)]


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
    numbers = entries("coefficients", len(coefficients(plant)))
    parts = np.split(numbers, [len(plant.entries), len(numbers) - len(plant.parameters)])
    inverse = np.zeros((n, n), dtype=object)
    inverse[np.asarray(plant.coupled)] = parts[1]
    symbolic = plant._replace(entries=parts[0], inverse_inertia=inverse, parameters=parts[2])
    sizes = n, n, n_acting(plant), n, 2, 2, len(numbers)
    given = {name: ca.SX.sym(name, size) for name, size in zip(ARGUMENTS, sizes, strict=True)}

    def apply(operation: str, operands: Any, uses: int) -> Any:
        if operation == ENTRY:
            return given[operands[0]][operands[1]]
        if operation == "negative":
            return -operands[0]
        if operation == "absolute" and rounding:
            return ca.sqrt(operands[0] ** 2 + rounding**2)
        if operation == "sqrt":
            return ca.sqrt(operands[0] + SMALLEST)
        return getattr(ca, SPELLED.get(operation, operation))(*operands)

    rates = symbolic_rates(kinematics, symbolic, disturbed=True)
    outputs = [ca.vertcat(*evaluate([*vector], apply)) for vector in rates]
    return ca.Function("rates", [*given.values()], outputs, [*ARGUMENTS], ["eta_dot", "nu_dot"])


_KNOWN: dict[str, Any] = {}  # solvers, by the names of their files


def compile_to(solver: Any, path: Path) -> bool:
    """Compile the functions that a solver calls to a file; without a compiler that is logged."""
    log.info("compiling the program of nmpc (about 20 s, once for these terms and horizon)")
    code = ca.CodeGenerator("nmpc")
    for function in (solver.oracle(), *map(solver.get_function, solver.get_function())):
        code.add(function)
    with tempfile.TemporaryDirectory() as folder:
        source, built = Path(folder) / "nmpc.c", Path(folder) / "nmpc.so"
        source.write_text(code.dump())
        command = [*os.environ.get("CC", "cc").split(), *FLAGS, str(source), "-o", str(built)]
        try:
            subprocess.run(command, capture_output=True, check=True)
            replace_file(path, built.read_bytes())
        except (OSError, subprocess.CalledProcessError) as error:
            log.warning("CasADi interprets nmpc, about ten times as slow: %s", error)
    return path.exists()


@dataclass(eq=False)
class Program:
    """The program of what it is compiled for; `plant` is a table with its terms."""

    plant: PlantTable
    dofs: tuple[str, ...]
    lagging: bool  # what acts follows the command by a lag
    steps: int
    lines: int  # between hull and obstacles at every step
    shared: tuple[int, ...]  # sizes of what all stages share, see `functions`

    def __post_init__(self) -> None:
        self.n = n = len(self.dofs)
        self.slacks, rates, self.corners = self.shared[5], self.shared[6], self.shared[7] // 2
        self.states = 3 * n + n * self.lagging
        self.width = self.states + n + self.slacks  # unknowns of a stage
        self.length = self.steps * self.width + self.states  # unknowns of all
        self.rows = self.lines * self.corners + 2 * rates + self.shared[8] // n  # of a stage
        self.stage = n, n, 2, 3 * self.lines  # target, force in NED, wind, lines
        low, high = (
            np.resize(np.repeat(values, (self.states, n, self.slacks)), self.length)
            for values in ((-np.inf, -1.0, 0.0), (np.inf, 1.0, np.inf))
        )
        gap, free = np.zeros(self.states), np.full(self.rows, np.inf)
        most = np.concatenate([gap, *[gap, free] * self.steps])
        self.bounds = {"lbx": low, "ubx": high, "lbg": np.zeros(len(most)), "ubg": most}
        terms = self.plant._replace(entries=gap, inverse_inertia=gap, parameters=gap)
        structure = terms, self.dofs, self.lagging, self.steps, self.lines, self.shared
        with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
            key = f"{structure} {ca.__version__} {get_host_cpu_name()}"
        self.digest = hashlib.sha256(key.encode()).hexdigest()[:32]  # beside the sources of models

    @cached_property
    def functions(self) -> tuple[Any, Any, Any]:
        """A step f, the cost and the constraints of a stage, of (x, unknowns, stage, shared)."""
        n = self.n
        x, w = ca.SX.sym("x", self.states), ca.SX.sym("w", self.n + self.slacks)
        q, c = ([ca.SX.sym("p", size) for size in sizes] for sizes in (self.stage, self.shared))
        h, decay, scale, error, change, weight, most, hull, faces, numbers = c
        target, force, wind, lines = q
        moved, last, u, s = x[: 2 * n], x[self.states - n :], w[:n, 0], w[n:, 0]
        acting = [x[2 * n : 3 * n] if self.lagging else u]
        for i in range(2):
            acting.append(decay * acting[i] + (1.0 - decay) * u)
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
        rows = [most - (u - last), most + (u - last)] if self.shared[6] else []
        rows += [1.0 - ca.reshape(faces, self.n, -1).T @ u] if self.shared[8] else []
        if self.lines:  # distances of the corners of the hull from the lines
            cos, sin, line = ca.cos(x[2]), ca.sin(x[2]), ca.reshape(lines, 3, self.lines)
            turned = ca.blockcat([[cos, -sin], [sin, cos]]) @ ca.reshape(hull, 2, self.corners)
            along = (turned + ca.repmat(x[:2], 1, self.corners)).T @ line[:2, :]
            rows.insert(0, ca.vec(along - ca.repmat(line[2, :], self.corners, 1)) + s)
        of, known = [x, w, *map(ca.vcat, (q, c))], {"is_diff_in": [True, True, False, False]}
        jacobian = {"jacobian_options": WHOLE | {"jacobian_options": {"cse": True}}}
        return (
            ca.Function("f", of, [ca.cse(after)], {**known, **WHOLE, **jacobian}),
            ca.Function("cost", of, [cost], known),
            ca.Function("path", of, [ca.vertcat(*rows)], known),
        )

    def problem(self) -> dict[str, Any]:
        """The program for CasADi: unknowns (x_0, w_0, ..., x_N), parameters (x_0, shared, stages).

        The constraints are, stage after stage, the step, of the first the start, and the others.
        """
        steps, nx, stage = self.steps, self.states, sum(self.stage)
        f, cost, path = self.functions
        sizes = nx, sum(self.shared), stage * (steps + 1)
        z, p = ca.MX.sym("z", self.length), ca.MX.sym("p", sum(sizes))
        start, shared, stages = ca.vertsplit(p, np.cumsum([0, *sizes]).tolist())
        columns, last = ca.reshape(z[: steps * self.width], self.width, steps), z[-nx:]
        x, w = columns[:nx, :], columns[nx:, :]
        q = ca.reshape(stages, stage, steps + 1)
        of = x, w, q[:, :steps], ca.repmat(shared, 1, steps)
        gaps = ca.horzcat(x[:, 1:], last) - f.map(steps)(*of)
        held = ca.vertcat(last[nx - self.n :], ca.DM(self.slacks, 1))
        end = cost(last, held, q[:, steps], shared)
        rows = path.map(steps)(*of) if self.rows else ca.MX(0, steps)
        others = ca.vec(ca.vertcat(gaps, rows)[:, 1:])
        g = ca.vertcat(gaps[:, 0], x[:, 0] - start, rows[:, 0], others)
        return {"x": z, "p": p, "f": ca.sum2(cost.map(steps)(*of)) + end, "g": g}

    def stages(self, plan: Array) -> Array:
        """State and unknowns of all stages but the last, shape (steps, width)."""
        return plan[: -self.states].reshape(-1, self.width)

    def solver(self, name: str) -> Any:
        """A solver, made once in a process, on compiled functions if there is a C compiler."""
        file = f"nmpc-{name}-{self.digest}.so"
        if file not in _KNOWN:
            options = {"print_time": False, "error_on_fail": False, name: SOLVERS[name]}
            if name == "fatrop":
                equality = (self.bounds["ubg"] == 0.0).tolist()
                options |= {"structure_detection": "auto", "equality": equality}
            path = cache_folder() / file
            problem = str(path) if path.exists() else self.problem()
            _KNOWN[file] = ca.nlpsol("nmpc", name, problem, options)
            if not path.exists() and compile_to(_KNOWN[file], path):
                _KNOWN[file] = ca.nlpsol("nmpc", name, str(path), options)
        return _KNOWN[file]


class NmpcDesign(NamedTuple):
    """The problem of a model and an outlook."""

    model: Model
    period_s: float
    observer: estimator.Observer
    outlook: Outlook
    program: Program
    shared: Array  # parameters of all stages


@dataclass
class NmpcMemory:
    """State between two samples; forces are shares of the limits."""

    estimated: estimator.Memory
    acting: Array  # (r,) by the lag
    command: Array  # (r,)
    plan: Array | None = None  # unknowns of the last problem
    slack: float = 0.0  # by which the hull was too near to an obstacle, at most so far [m]


@dataclass(frozen=True, kw_only=True)
class Nmpc(controller.PythonController):
    """Nonlinear model predictive control of the pose by forces on the axes.

    `horizon` steps of `step` sqrt(L / g), after each of which there is a command. `error_weight`
    weighs the error of the pose [1/m^2, 1/rad^2], and `effort` times `input_weight` increments of
    the force in `period_s` as shares of `limits` [N, Nm]. The hull stays `margin` L away from the
    `lines` nearest obstacles; a violation by a length costs `slack_weight` times an error of one.
    """

    horizon: Annotated[int, Ge(2), Le(1000)]
    step: Positive
    error_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.error_weight")]
    input_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.increment_weight")]
    effort: Positive
    period_s: Annotated[Positive, FromVessel("tuning.control.period_s")]
    limits: Annotated[tuple[float, ...], FromVessel("force_limits")]
    margin: NotNegative
    lines: Annotated[int, Ge(1), Le(20)]
    slack_weight: Positive
    kalman: estimator.Kalman
    wind: Annotated[WindForce | None, FromVessel("tuning.windage")]
    vessel: VesselParameters
    length_m: Annotated[Positive, FromVessel("scales.length_m")]

    def __post_init__(self) -> None:
        check_ranges(self)
        for name, positive in {"error_weight": False, "limits": True, "input_weight": True}.items():
            check_weights(name, getattr(self, name), len(self.limits), positive=positive)
        solvers()

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        return max(1, round(self.step * math.sqrt(self.length_m / GRAVITY) / period_s))

    def preview_rows(self, period_s: float) -> int:
        """Number of loop instants by which a step of the reference is known in advance."""
        return self.horizon * self.command_rows(period_s)

    def command_limits(self) -> tuple[float, ...]:
        """The limits of the force [N, Nm], and of the thrusters."""
        lag = self.vessel.thruster
        return tuple(np.minimum(self.limits, (lag and lag.amplitude_limit) or np.inf).tolist())

    def failures(self, state: NmpcMemory) -> int:
        """Number of problems that were not solved."""
        return int(state.estimated.failures[0])

    def findings(self, state: NmpcMemory) -> list[Diagnostic]:
        """The largest violation of the distance from obstacles."""
        return [Diagnostic("slack_distance", "all", state.slack, "m")] if state.slack else []

    def design(self, model: Model, period_s: float, outlook: Outlook = NO_OUTLOOK) -> NmpcDesign:
        """The program for a model and an outlook, its shared parameters and its estimator."""
        own, devices = controller.table_of(model), self.vessel.positioning
        lag, thrusters = self.vessel.thruster, self.vessel.thrusters
        step_s = self.command_rows(period_s) * period_s
        linear = design_model(own, self.command_limits(), step_s, self.wind)
        observer = estimator.observer_of(linear, "kalman", self.kalman)
        if len(outlook.wind_ned) and self.wind and not own.force_table().aerodynamic:
            own = own + self.wind.table(own.dofs)
        plant, limits = own.plant_table(), linear.limits
        hull = outlook.hull if outlook.obstacles and outlook.hull is not None else np.zeros((0, 2))
        delay_s, rate = lag.delay_s if lag else 0.0, np.zeros(0)
        if lag and lag.rate_limit:
            rate = np.array(lag.rate_limit) / limits
        if devices:
            thrusters, inputs, turning = devices.forces(), devices.inputs, math.inf
            for one in devices.devices:
                delay_s = max(delay_s, inputs[one.drive].time_constant_s or 0.0)
                turning = min(turning, (one.alpha and inputs[one.alpha].rate_limit) or math.inf)
            rate = np.full(len(limits), turning) if turning < math.inf else rate
        faces = thrusters.faces(own.dofs, limits) if thrusters else np.zeros(0)
        largest = max(self.error_weight)  # tolerances are absolute
        effort = self.effort * (self.period_s / step_s) ** 2 * np.array(self.input_weight)
        shared: tuple[Any, ...] = (
            [step_s], [math.exp(-0.5 * step_s / delay_s) if delay_s else 0.0], limits,
            np.array(self.error_weight) / largest, effort / largest,
            [self.slack_weight * self.length_m] * (len(hull) > 0),
            rate * step_s, hull.ravel(), faces.ravel(), coefficients(plant),
        )  # fmt: skip
        sizes, lines = tuple(map(len, shared)), self.lines * (len(hull) > 0)
        program = Program(plant, own.dofs, delay_s > 0.0, self.horizon, lines, sizes)
        return NmpcDesign(model, period_s, observer, outlook, program, np.concatenate(shared))

    def start(self, design: NmpcDesign) -> NmpcMemory:
        """At rest, without a plan."""
        n = design.program.n
        return NmpcMemory(estimator.memory(2 * n, n, n), np.zeros(n), np.zeros(n))

    def foresee(self, parameters: Any, outlook: Outlook) -> controller.PythonTable:
        """The parameters with reference, wind and obstacles; its program is compiled."""
        design = self.design(parameters.design.model, parameters.design.period_s, outlook)
        design.program.solver(solvers()[0])
        return controller.PythonTable(self, design)

    def command(self, design: NmpcDesign, state: NmpcMemory, now: controller.Signals) -> Array:
        """The first force of the best plan; without a solution that of the last plan."""
        past, observer, program = state.estimated, design.observer, design.program
        if (k := past.instant[0]) % self.command_rows(design.period_s) == 0:
            if k == 0:
                past.x[:] = observer.start @ now.eta
            else:
                estimator.correct(observer, past, now.eta.copy())
            n, turning, psi = program.n, observer.turning, estimator.heading(observer, past.x)
            nu, added = np.zeros(n), np.zeros(n)
            estimator.to_axes(turning, psi, past.x[n:], nu)
            lag = state.acting[: n * program.lagging]
            at = np.concatenate([past.x[:n], nu, lag, state.command])
            stage = self._solve(design, state, at, now.eta_d)
            if k < len(design.outlook.added):
                estimator.to_axes(turning, -psi, design.outlook.added[k], added)
            stage[n : 2 * n] += added
            unknowns = np.concatenate([state.command, np.zeros(program.slacks)])
            # the estimate moves on the model itself, whose error the bias is
            ahead = np.asarray(program.functions[0](at, unknowns, stage, design.shared)).ravel()
            past.x[:n], state.acting = ahead[:n], ahead[-2 * n : -n]
            psi = estimator.heading(observer, past.x)
            estimator.to_axes(turning, -psi, ahead[n : 2 * n], past.x[n:])
            past.bias[:] *= observer.bias_decay
        past.instant[0] += 1
        return np.asarray(observer.limits * state.command)

    def _solve(self, design: NmpcDesign, state: NmpcMemory, at: Array, eta_d: Array) -> Array:
        """Solve the problem from a state; writes plan, command and slack, returns a stage."""
        program, outlook, observer = design.program, design.outlook, design.observer
        past, n, nx, steps = state.estimated, program.n, program.states, self.horizon
        if state.plan is None:
            rest = np.concatenate([at, state.command, np.zeros(program.slacks)])
            rest[n : 2 * n] = 0.0
            plan = np.tile(rest, steps + 1)[: program.length]
        else:  # a step later
            plan = np.concatenate([state.plan[program.width :], state.plan[-program.width :]])
        plan[:nx] = at
        rows = past.instant[0] + self.command_rows(design.period_s) * np.arange(steps + 1)
        stages = np.zeros((steps + 1, sum(program.stage)))
        target, force, wind, lines = np.split(stages, np.cumsum(program.stage[:-1]), axis=1)
        last = len(outlook.reference) - 1
        target[:] = outlook.reference[np.minimum(rows, last)] if last >= 0 else eta_d
        if observer.turning:
            target[:, 2] -= 2.0 * np.pi * np.round((target[0, 2] - past.x[2]) / (2.0 * np.pi))
        force[:] = past.bias * observer.bias_decay ** np.arange(steps + 1)[:, None]
        if last := len(outlook.wind_ned):
            wind[:] = outlook.wind_ned[np.minimum(rows, last - 1)]
            if rows[0] < len(outlook.wind_noise):
                wind[0] += in_ned(outlook.wind_noise[rows[0]], estimator.heading(observer, past.x))
        if program.lines and outlook.hull is not None and outlook.obstacles is not None:
            poses = program.stages(plan)[:, :3]
            nearest = separating_lines(outlook.hull, poses, outlook.obstacles, program.lines)
            nearest[:, :, 2] += self.margin * self.length_m
            lines[:-1] = nearest.reshape(steps, -1)
        p = np.concatenate([at, design.shared, stages.ravel()])
        for solver in map(program.solver, solvers()):
            solution = solver(x0=plan, p=p, **program.bounds)
            if solver.stats()["success"]:
                plan = np.asarray(solution["x"]).ravel()
                break
        else:
            past.failures[0] += 1
        state.plan, state.command = plan, np.clip(plan[nx : nx + n], -1.0, 1.0)
        state.slack = float(np.max(program.stages(plan)[:, nx + n :], initial=state.slack))
        return np.asarray(stages[0])
