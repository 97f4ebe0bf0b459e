"""Thrust allocation: the forces u of the thrusters that produce the generalised force tau.

    tau = T u,    T = [d; r x d] of a thruster at r that pushes along d      Bargouth, (2.11)-(2.14)

An azimuth thruster has two components of u, its force ahead and to starboard, (2.15)-(2.18).
There are two methods. The compiled weighted pseudo-inverse u = W^-1 T' (T W^-1 T')^-1 tau holds
saturated thrusters at their limit and distributes the remaining force over the others. The other
method is a quadratic program. A force that cannot be reached is scaled down, and keeps its
direction.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import daqp
import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from seatrial.models.compiled import LEAN, lean_kernel, tuple_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.pseudo_inverse import PseudoInverse, allocate_all, by_pseudo_inverse

REACHED = 1e-9  # relative tolerance within which an applied force equals the commanded one
# Largest force of a T200 thruster ahead and astern [N] at supplied voltages [V]; Hoyer, section 4.2
T200 = ((14.0, 44.1, 34.5), (16.0, 51.4, 39.2))
SIDES = 16  # of the polygon around the circle of an azimuth thruster
MAX_CUTS = 12  # largest number of cuts; each adds the tangent where the force is outside the circle
INSIDE = 1e-9  # of a circle's radius


class QuadraticProgram(NamedTuple):
    """Geometry for the program; circles are inequality rows relative to the limits."""

    T: Array
    weight: Array  # (n_u,)
    low: Array  # (n_u,) [N]
    high: Array
    circles: Array  # (n_rows, n_u)
    pairs: Codes  # (n_azimuths, 2) their components in u
    u: Array


def _solve_program(table: QuadraticProgram, T: Array, tau: Array, circles: Array) -> Array | None:
    """(u, s) of the program, u relative to the limits; None if the solver fails."""
    n_dof, n_u = T.shape
    rows = np.hstack([T, -tau[:, None]])
    H = np.diag([*(1e-6 * table.weight), 1e-6])
    f = np.append(np.zeros(n_u), -1.0)
    upper = np.concatenate([np.ones(n_u + 1), np.zeros(n_dof), np.ones(len(circles))])
    lower = np.concatenate(
        [table.low / table.high, [0.0], np.zeros(n_dof), np.full(len(circles), -1e30)]
    )
    sense = np.zeros(len(upper), dtype=np.int32)
    sense[n_u + 1 : n_u + 1 + n_dof] = 5  # equality
    circle_rows = np.hstack([circles, np.zeros((len(circles), 1))])
    for tolerance in (1e-10, 1e-8):  # nearly equal tangents can fail at the first
        solution, _, flag, _ = daqp.solve(
            H, f, np.vstack([rows, circle_rows]), upper, lower, sense.copy(), primal_tol=tolerance
        )
        if flag >= 1:
            return np.asarray(solution, dtype=np.float64)
    return None


def by_program(table: QuadraticProgram, tau: Array, applied: Array) -> None:
    """Write the solution of min delta/2 u' W u - s,  T u = s tau,  0 <= s <= 1,  u within limits.

    For a small delta the share s is the largest possible one (an exact penalty), and u the
    solution of least cost for it. The forces are relative to the limits, so that the tolerances of
    the solver are meaningful; its residual T u - s tau is then distributed over the thrusters that
    are not at a limit. The circle of an azimuth thruster is first a polygon around it; where the
    force is outside the circle, the tangent is added (cutting planes). Finally the forces are
    scaled by the remaining excess.
    """
    n_u = table.T.shape[1]
    T = table.T * table.high
    size = np.max(np.abs(T), axis=1)
    circles, solution = table.circles, np.zeros(n_u + 1)
    pairs = solution[:n_u][table.pairs]
    for _ in range(MAX_CUTS):
        improved = _solve_program(table, T / size[:, None], tau / size, circles)
        if improved is None:  # keep the last solution, which is close
            break
        solution = improved
        pairs = solution[:n_u][table.pairs]  # (n_azimuths, 2)
        outside = np.hypot(*pairs.T) > 1.0 + INSIDE
        if not np.any(outside):
            break
        tangents = np.zeros((int(np.sum(outside)), n_u))
        direction = pairs[outside] / np.hypot(*pairs[outside].T)[:, None]
        np.put_along_axis(tangents, table.pairs[outside], direction, axis=1)
        circles = np.vstack([circles, tangents])
    solution = solution / max(1.0, np.max(np.hypot(*pairs.T), initial=0.0))
    x, s = solution[:n_u], min(solution[n_u], 1.0)
    s = 1.0 if s > 1.0 - 1e-7 else s
    free = (x < 1.0 - 1e-6) & (x > table.low / table.high + 1e-6)
    residual = (s * tau - T @ x) / size
    x[free] += np.linalg.lstsq(T[:, free] / size[:, None], residual, rcond=None)[0]
    table.u[:] = x * table.high
    applied[:] = table.T @ table.u


def circles_of(counts: Sequence[int]) -> Array:
    """Rows c with c u <= 1: tangents of the circles of azimuth thrusters, relative to the limit."""
    angle = 2.0 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
    sides = np.column_stack([np.cos(angle), np.sin(angle)])
    rows = np.zeros((SIDES * counts.count(2), sum(counts)))
    row = 0
    for first, count in zip(np.cumsum([0, *counts[:-1]]), counts, strict=True):
        if count == 2:
            rows[row : row + SIDES, first : first + 2] = sides
            row += SIDES
    return rows


class Direct(NamedTuple):
    """No allocation: the command is applied unchanged."""

    share: float = 1.0


@lean_kernel
def _pass_on(table: Direct, tau: Array, applied: Array) -> None:
    for i in range(tau.shape[0]):
        applied[i] = table.share * tau[i]


ALLOCATIONS: dict[type, Callable[..., None]] = {
    Direct: _pass_on,
    PseudoInverse: by_pseudo_inverse,
    QuadraticProgram: by_program,
}  # by the type of the thrusters' geometry, so that a simulation compiles the one it needs


def allocate_step(table: NamedTuple, tau: Array, applied: Array) -> None:
    """Write the applied force [N, Nm] for the commanded force tau [N, Nm], both (n_dof,)."""
    ALLOCATIONS[type(table)](table, tau, applied)


@overload(allocate_step, jit_options=LEAN)
def _allocate_step(table: NamedTuple, tau: Array, applied: Array) -> Callable[..., None]:
    step = ALLOCATIONS[tuple_of(table)]

    def allocate(table: NamedTuple, tau: Array, applied: Array) -> None:
        step(table, tau, applied)

    return allocate


def voltage_factors(voltage_v: float) -> tuple[float, float]:
    """Force limits at a supply voltage [V] relative to those at 16 V, ahead and astern.

    The limits are interpolated linearly. Raises ConfigurationError outside the 14 to 16.7 V of the
    batteries.
    """
    if not 14.0 <= voltage_v <= 16.7:
        raise ConfigurationError(f"voltage_v must lie between 14 and 16.7, got {voltage_v}")
    (low, ahead, astern), (high, most_ahead, most_astern) = T200
    share = (voltage_v - low) / (high - low)
    return (
        (ahead + share * (most_ahead - ahead)) / most_ahead,
        (astern + share * (most_astern - astern)) / most_astern,
    )


@dataclass(frozen=True)
class PositionedThruster:
    """A thruster at a position in body axes [m].

    A `fixed` thruster pushes along `direction`, a `tunnel` thruster to starboard and an `azimuth`
    thruster in any horizontal direction. The force lies between -`astern_n` and `ahead_n`; an
    azimuth thruster turns instead of reversing. A larger `weight` reduces its use.
    """

    kind: Literal["fixed", "tunnel", "azimuth"]
    position_m: tuple[float, float, float]
    ahead_n: Positive
    astern_n: float | None = None  # None: equal to ahead_n
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    weight: Positive = 1.0

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.astern_n is not None and (self.astern_n < 0.0 or self.kind == "azimuth"):
            raise ConfigurationError(
                f"astern_n: got {self.astern_n} for a thruster of kind {self.kind}, expected a "
                "number that is not negative, or null for an azimuth thruster"
            )
        if not np.linalg.norm(self.direction) > 0.0:
            raise ConfigurationError(f"direction: got {self.direction}, expected a non-zero vector")

    def columns(self) -> Array:
        """Columns of T for this thruster over six degrees of freedom, shape (6, 1) or (6, 2)."""
        if self.kind == "azimuth":
            directions = np.eye(3)[:, :2]
        elif self.kind == "tunnel":
            directions = np.array([[0.0], [1.0], [0.0]])
        else:
            directions = np.array(self.direction)[:, None] / np.linalg.norm(self.direction)
        return np.vstack([directions, np.cross(self.position_m, directions.T).T])


class Allocated(NamedTuple):
    """Thruster force components (N, n_u) [N] and the force they produce, (N, n_dof) [N, Nm]."""

    u: Array
    applied: Array
    reached: NDArray[np.bool_]  # (N,) whether the applied force equals the commanded one


@dataclass(frozen=True)
class Allocation:
    """The thrusters of a vessel and the allocation method; `none` applies the command unchanged.

    `voltage_v` is the supply voltage of thrusters whose limits are stated for 16 V.
    """

    method: Literal["none", "pseudo_inverse", "qp"]
    thrusters: tuple[PositionedThruster, ...]
    voltage_v: float | None = None

    def __post_init__(self) -> None:
        if not self.thrusters:
            raise ConfigurationError("thrusters: got none, expected at least one")
        self._factors()

    def _factors(self) -> tuple[float, float]:
        return (1.0, 1.0) if self.voltage_v is None else voltage_factors(self.voltage_v)

    def matrix(self, dofs: Sequence[str]) -> Array:
        """T, shape (n_dof, n_u). Raises ConfigurationError if its rank is less than n_dof."""
        rows = [DOFS.index(dof) for dof in dofs]
        T = np.hstack([thruster.columns() for thruster in self.thrusters])[rows]
        rank = np.linalg.matrix_rank(T / np.maximum(np.max(np.abs(T), axis=1), 1e-300)[:, None])
        if rank < len(dofs):
            raise ConfigurationError(
                f"thrusters: got {rank} independent directions of force, expected {len(dofs)} "
                f"for {', '.join(dofs)}"
            )
        return np.ascontiguousarray(T)

    def table(self, dofs: Sequence[str]) -> Direct | PseudoInverse | QuadraticProgram:
        """Thruster geometry and limits for the allocation step."""
        if self.method == "none":
            return Direct()
        T = self.matrix(dofs)
        counts = [thruster.columns().shape[1] for thruster in self.thrusters]
        ahead, astern = self._factors()
        high = np.array([ahead * thruster.ahead_n for thruster in self.thrusters])
        low = np.array(
            [
                -astern * (thruster.ahead_n if thruster.astern_n is None else thruster.astern_n)
                for thruster in self.thrusters
            ]
        )
        weight = np.repeat([thruster.weight for thruster in self.thrusters], counts)
        if self.method == "pseudo_inverse":
            first = np.concatenate([[0], np.cumsum(counts)])
            G = np.zeros((len(dofs), len(dofs) + 1))
            size = np.repeat(np.maximum(high, -low), counts)
            u, pull = np.zeros(T.shape[1]), np.zeros(T.shape[1])
            multiplier, step = np.zeros(len(dofs)), np.zeros(len(dofs))
            reach, give = np.abs(T) @ size, np.square(T) @ (1.0 / weight)
            return PseudoInverse(
                T, 1.0 / weight, low, high, first, u, pull, multiplier, step, reach, give, G
            )
        azimuth = np.array([thruster.kind == "azimuth" for thruster in self.thrusters])
        low = np.where(azimuth, -high, low)
        first = np.cumsum([0, *counts[:-1]])[np.array(counts) == 2]
        pairs = np.stack([first, first + 1], axis=1).astype(np.int64)
        sizes = np.repeat(low, counts), np.repeat(high, counts)
        circles = circles_of(counts)
        return QuadraticProgram(T, weight, *sizes, circles, pairs, np.zeros(T.shape[1]))

    def allocate(self, tau: Array, dofs: Sequence[str]) -> Allocated:
        """Thruster forces that produce the forces tau [N, Nm], shape (N, n_dof)."""
        table = self.table(dofs)
        if isinstance(table, Direct):
            raise ConfigurationError("thrusters.method: got none, expected pseudo_inverse or qp")
        u, applied = np.empty((len(tau), table.T.shape[1])), np.empty_like(tau)
        if isinstance(table, PseudoInverse):
            allocate_all(table, np.ascontiguousarray(tau), u, applied)
        else:
            for k in range(len(tau)):
                by_program(table, tau[k], applied[k])
                u[k] = table.u
        return Allocated(u, applied, reached(tau, applied))


def reached(tau: Array, applied: Array) -> NDArray[np.bool_]:
    """Whether each row of the applied force equals tau, both (N, n_dof); shape (N,)."""
    size = np.maximum(np.max(np.abs(tau), axis=0), 1e-300)
    return np.asarray(np.all(np.abs(applied - tau) <= REACHED * size, axis=1))
