"""Thrust allocation: which force each thruster gives so that together they give tau.

    tau = T u,    T = [d; r x d] of a thruster at r that pushes along d      Bargouth, (2.11)-(2.14)

An azimuth thruster has two components of u, its force ahead and to starboard, (2.15)-(2.18).
Two methods: a weighted pseudo-inverse u = W^-1 T' (T W^-1 T')^-1 tau, in which a thruster that
exceeds its limit is held there and the others share the rest; and a quadratic program, which
finds every force that can be reached. What cannot be reached is scaled, its direction kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from models.basis import DOFS, Array, Codes
from models.compiled import kernel, lean_kernel
from models.dynamics import LEAN
from models.errors import ConfigurationError

SIDES = 32  # of the polygon in an azimuth thruster's circle, for the quadratic program
HALVINGS = 40  # of the interval in which the scale of an unreachable force lies
SINGULAR = 1e-12  # of a pivot, relative to the largest entry
REACHED = 1e-9  # of the scale: closer to one is reached

# Largest force of a T200 thruster ahead and astern [N] at supplied voltages [V]; Hoyer, section 4.2
T200 = ((14.0, 44.1, 34.5), (16.0, 51.4, 39.2))


def voltage_factors(voltage_v: float) -> tuple[float, float]:
    """Share of the force at 16 V, ahead and astern, that a supplied voltage leaves (interpolated).

    Raises ConfigurationError outside the 14 to 16.7 V of the batteries.
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
class Thruster:
    """A thruster at a place in body axes [m].

    `kind`: `fixed`, along `direction`; `tunnel`, to starboard; `azimuth`, any horizontal
    direction. Its force lies between -`astern_n` and `ahead_n`; an azimuth thruster turns instead
    of going astern. A larger `weight` spares it.
    """

    kind: Literal["fixed", "tunnel", "azimuth"]
    position_m: tuple[float, float, float]
    ahead_n: float
    astern_n: float | None = None  # None: as ahead
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    weight: float = 1.0

    def __post_init__(self) -> None:
        for name in ("ahead_n", "weight"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")
        if self.astern_n is not None and (self.astern_n < 0.0 or self.kind == "azimuth"):
            raise ConfigurationError(
                f"astern_n: got {self.astern_n} of a thruster of kind {self.kind}, expected no "
                "negative number, and none of an azimuth thruster"
            )
        if not np.linalg.norm(self.direction) > 0.0:
            raise ConfigurationError(f"direction: got {self.direction}, which is none")

    def columns(self) -> Array:
        """Its columns of T over all six degrees of freedom, shape (6, 1) or (6, 2)."""
        if self.kind == "azimuth":
            ways = np.eye(3)[:, :2]
        elif self.kind == "tunnel":
            ways = np.array([[0.0], [1.0], [0.0]])
        else:
            ways = np.array(self.direction)[:, None] / np.linalg.norm(self.direction)
        return np.vstack([ways, np.cross(self.position_m, ways.T).T])


class Direct(NamedTuple):
    """No allocation: every force can be given."""

    share: float = 1.0


class PseudoInverse(NamedTuple):
    """Geometry for the kernel; work space for one distribution."""

    T: Array  # (n_dof, n_u)
    spare: Array  # (n_u,) 1 / weight
    low: Array  # (n_thrusters,) [N]
    high: Array
    first: Codes  # (n_thrusters + 1,) first component of each thruster
    u: Array  # (n_u,)
    held: Codes  # (n_thrusters,) 1 where it stands at its limit
    G: Array  # (n_dof, n_dof + 1)


class QuadraticProgram(NamedTuple):
    """The same for the quadratic program; circles are inequality rows in shares of the limit."""

    T: Array
    weight: Array  # (n_u,)
    low: Array  # (n_u,) [N]
    high: Array
    circles: Array  # (n_rows, n_u)
    u: Array


ALLOCATIONS: dict[type, Callable[..., None]] = {}


@lean_kernel
def _pass_on(table: Direct, tau: Array, applied: Array) -> None:
    for i in range(tau.shape[0]):
        applied[i] = table.share * tau[i]


ALLOCATIONS[Direct] = _pass_on


@lean_kernel
def _solve(G: Array) -> bool:
    """Solve the square system in G = [A b] by elimination, the solution in its last column."""
    n = G.shape[0]
    largest = 0.0
    for i in range(n):
        for j in range(n):
            largest = max(largest, abs(G[i, j]))
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(G[i, k]) > abs(G[pivot, k]):
                pivot = i
        if not abs(G[pivot, k]) > SINGULAR * largest:
            return False
        for j in range(k, n + 1):
            G[k, j], G[pivot, j] = G[pivot, j], G[k, j]
        for i in range(n):
            if i != k:
                factor = G[i, k] / G[k, k]
                for j in range(k, n + 1):
                    G[i, j] -= factor * G[k, j]
    for k in range(n):
        G[k, n] /= G[k, k]
    return True


@lean_kernel
def _excess(table: PseudoInverse, i: int) -> float:
    """How far thruster i exceeds its limit, relative to it; negative within."""
    at = table.first[i]
    size: float = table.u[at]
    if table.first[i + 1] - at == 2:
        size = np.sqrt(size**2 + table.u[at + 1] ** 2)
    limit: float = table.high[i] if size >= 0.0 else table.low[i]
    return size / limit - 1.0 if limit != 0.0 else 1.0


@lean_kernel
def _hold_at_limit(table: PseudoInverse, i: int) -> None:
    share = 1.0 / (1.0 + _excess(table, i))
    at = table.first[i]
    for j in range(at, table.first[i + 1]):
        table.u[j] *= share if table.low[i] < 0.0 or table.u[j] > 0.0 else 0.0
    table.held[i] = 1


@lean_kernel
def _share_rest(table: PseudoInverse, tau: Array, scale: float) -> bool:
    """u of the thrusters that are not held: the pseudo-inverse of what the held ones leave."""
    G, n = table.G, tau.shape[0]
    for i in range(n):
        for j in range(n + 1):
            G[i, j] = 0.0
        G[i, n] = scale * tau[i]
    for t in range(table.held.shape[0]):
        for c in range(table.first[t], table.first[t + 1]):
            for i in range(n):
                if table.held[t] == 1:
                    G[i, n] -= table.T[i, c] * table.u[c]
                else:
                    for j in range(n):
                        G[i, j] += table.T[i, c] * table.spare[c] * table.T[j, c]
    if not _solve(G):
        return False
    for t in range(table.held.shape[0]):
        if table.held[t] == 0:
            for c in range(table.first[t], table.first[t + 1]):
                table.u[c] = 0.0
                for i in range(n):
                    table.u[c] += table.spare[c] * table.T[i, c] * G[i, n]
    return True


@lean_kernel
def _distribute(table: PseudoInverse, tau: Array, scale: float) -> bool:
    """Write u with T u = scale tau; the worst thruster beyond its limit is held, one at a time."""
    count = table.held.shape[0]
    for t in range(count):
        table.held[t] = 0
    for _ in range(count + 1):
        if not _share_rest(table, tau, scale):
            return False
        worst, most = -1, 1e-12
        for t in range(count):
            if table.held[t] == 0 and _excess(table, t) > most:
                worst, most = t, _excess(table, t)
        if worst < 0:
            return True
        _hold_at_limit(table, worst)
    return False


@lean_kernel
def _by_pseudo_inverse(table: PseudoInverse, tau: Array, applied: Array) -> None:
    """T u of the largest share of tau, up to all of it, that is found."""
    low, high = 0.0, 1.0
    if not _distribute(table, tau, 1.0):
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if _distribute(table, tau, middle):
                low = middle
            else:
                high = middle
        _distribute(table, tau, low)
    for i in range(tau.shape[0]):
        applied[i] = 0.0
        for c in range(table.u.shape[0]):
            applied[i] += table.T[i, c] * table.u[c]


ALLOCATIONS[PseudoInverse] = _by_pseudo_inverse


def _by_program(table: QuadraticProgram, tau: Array, applied: Array) -> None:
    """min delta/2 u' W u - s,  T u = s tau,  0 <= s <= 1,  u within its limits.

    For a small delta the share s is the largest possible one (an exact penalty), and u the
    lightest that gives it. In shares of the limits, so that the solver's tolerances have a
    meaning; what they leave of T u - s tau is then given to the thrusters between their limits.
    """
    import daqp

    n_dof, n_u = table.T.shape
    T = table.T * table.high
    size = np.max(np.abs(T), axis=1)
    rows = np.hstack([T, -tau[:, None]]) / size[:, None]
    circles = np.hstack([table.circles, np.zeros((len(table.circles), 1))])
    H = np.diag([*(1e-6 * table.weight), 1e-6])
    f = np.append(np.zeros(n_u), -1.0)
    upper = np.concatenate([np.ones(n_u + 1), np.zeros(n_dof), np.ones(len(circles))])
    lower = np.concatenate(
        [table.low / table.high, [0.0], np.zeros(n_dof), np.full(len(circles), -1e30)]
    )
    sense = np.zeros(len(upper), dtype=np.int32)
    sense[n_u + 1 : n_u + 1 + n_dof] = 5  # equality
    found, _, flag, _ = daqp.solve(
        H, f, np.vstack([rows, circles]), upper, lower, sense, primal_tol=1e-10
    )
    if flag < 1:
        found = np.zeros(n_u + 1)
    x, s = found[:n_u], min(found[n_u], 1.0)
    s = 1.0 if s > 1.0 - 1e-7 else s
    free = (x < 1.0 - 1e-6) & (x > table.low / table.high + 1e-6)
    left = (s * tau - T @ x) / size
    x[free] += np.linalg.lstsq(T[:, free] / size[:, None], left, rcond=None)[0]
    table.u[:] = x * table.high
    applied[:] = table.T @ table.u


ALLOCATIONS[QuadraticProgram] = _by_program


def allocate_step(table: Any, tau: Array, applied: Array) -> None:
    """The force [N, Nm] that is given for the force tau that is asked for, both (n_dof,)."""
    ALLOCATIONS[type(table)](table, tau, applied)


@overload(allocate_step, jit_options=LEAN)
def _allocate_step(table: Any, tau: Any, applied: Any) -> Any:
    step = ALLOCATIONS[table.instance_class]

    def chosen(table: Any, tau: Any, applied: Any) -> None:
        step(table, tau, applied)

    return chosen


@kernel
def _allocate_all(table: PseudoInverse, tau: Array, u: Array, applied: Array) -> None:
    for k in range(tau.shape[0]):
        _by_pseudo_inverse(table, tau[k], applied[k])
        u[k] = table.u


class Allocated(NamedTuple):
    """Forces of the thrusters' components (N, n_u) and what they give, (N, n_dof) [N, Nm]."""

    u: Array
    applied: Array
    reached: NDArray[np.bool_]  # (N,) whether it is what was asked for


@dataclass(frozen=True)
class Allocation:
    """The thrusters of a vessel and how they share a force; `none` takes every force as given.

    `voltage_v` is the voltage supplied to thrusters whose limits are those at 16 V.
    """

    method: Literal["none", "pseudo_inverse", "qp"]
    thrusters: tuple[Thruster, ...]
    voltage_v: float | None = None

    def __post_init__(self) -> None:
        if not self.thrusters:
            raise ConfigurationError("thrusters: got none, expected at least one")
        self._factors()

    def _factors(self) -> tuple[float, float]:
        return (1.0, 1.0) if self.voltage_v is None else voltage_factors(self.voltage_v)

    def matrix(self, dofs: Sequence[str]) -> Array:
        """T, shape (n_dof, n_u). Raises ConfigurationError where it cannot push every way."""
        rows = [DOFS.index(dof) for dof in dofs]
        T = np.hstack([one.columns() for one in self.thrusters])[rows]
        rank = np.linalg.matrix_rank(T / np.maximum(np.max(np.abs(T), axis=1), 1e-300)[:, None])
        if rank < len(dofs):
            raise ConfigurationError(
                f"thrusters: they push in {rank} independent directions, expected {len(dofs)} "
                f"for {', '.join(dofs)}"
            )
        return np.ascontiguousarray(T)

    def table(self, dofs: Sequence[str]) -> Direct | PseudoInverse | QuadraticProgram:
        """The geometry for the simulation."""
        if self.method == "none":
            return Direct()
        T = self.matrix(dofs)
        counts = [one.columns().shape[1] for one in self.thrusters]
        ahead, astern = self._factors()
        high = np.array([ahead * one.ahead_n for one in self.thrusters])
        low = np.array(
            [
                -astern * (one.ahead_n if one.astern_n is None else one.astern_n)
                for one in self.thrusters
            ]
        )
        weight = np.repeat([one.weight for one in self.thrusters], counts)
        if self.method == "pseudo_inverse":
            first = np.concatenate([[0], np.cumsum(counts)])
            G = np.zeros((len(dofs), len(dofs) + 1))
            held = np.zeros(len(counts), dtype=np.int64)
            return PseudoInverse(T, 1.0 / weight, low, high, first, np.zeros(T.shape[1]), held, G)
        turns = np.array([one.kind == "azimuth" for one in self.thrusters])
        low = np.where(turns, -high, low)
        circles = _circles(counts)
        sizes = np.repeat(low, counts), np.repeat(high, counts)
        return QuadraticProgram(T, weight, *sizes, circles, np.zeros(T.shape[1]))

    def allocate(self, tau: Array, dofs: Sequence[str]) -> Allocated:
        """Thruster forces for forces tau [N, Nm], shape (N, n_dof)."""
        table = self.table(dofs)
        if isinstance(table, Direct):
            raise ConfigurationError("thrusters.method: got none, expected pseudo_inverse or qp")
        u, applied = np.empty((len(tau), table.T.shape[1])), np.empty_like(tau)
        if isinstance(table, PseudoInverse):
            _allocate_all(table, np.ascontiguousarray(tau), u, applied)
        else:
            for k in range(len(tau)):
                _by_program(table, tau[k], applied[k])
                u[k] = table.u
        return Allocated(u, applied, reached(tau, applied))


def reached(tau: Array, applied: Array) -> NDArray[np.bool_]:
    """Whether the force that was given is the one that was asked for; rows of (N, n_dof)."""
    size = np.maximum(np.max(np.abs(tau), axis=0), 1e-300)
    return np.asarray(np.all(np.abs(applied - tau) <= REACHED * size, axis=1))


def _circles(counts: Sequence[int]) -> Array:
    """Rows c with c u <= 1 for the components of azimuth thrusters in shares of their limit."""
    angle = 2.0 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
    sides = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / SIDES)
    rows = np.zeros((SIDES * counts.count(2), sum(counts)))
    at = 0
    for first, count in zip(np.cumsum([0, *counts[:-1]]), counts, strict=True):
        if count == 2:
            rows[at : at + SIDES, first : first + 2] = sides
            at += SIDES
    return rows
