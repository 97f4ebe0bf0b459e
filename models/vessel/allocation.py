"""Thrust allocation: the forces u of the thrusters that produce the generalised force tau.

    tau = T u,    T = [d; r x d] of a thruster at r that pushes along d      Bargouth, (2.11)-(2.14)

An azimuth thruster has two components of u, its force ahead and to starboard, (2.15)-(2.18).
Two methods differ in what is least: `pseudo_inverse` the forces, `qp` their shares of the limits.
A force that cannot be reached is scaled down, and keeps its direction:

    min u' W u,  T u = s tau,  every thruster within its limit, for the largest share s up to 1

The solution is u = P(W^-1 T' lambda), where P saturates each thruster, for the multipliers lambda
with T u = s tau. They maximise the concave dual function, whose gradient is s tau - T u; the first
step of Newton's method is the weighted pseudo-inverse, the following ones distribute what saturated
thrusters do not give. Boyd and Vandenberghe (2004), sections 5.5 and 9.5.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from seatrial.models.compiled import LEAN, kernel, lean_kernel, tuple_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.basis import Array, Codes

REACHED = 1e-9  # relative tolerance within which an applied force equals the commanded one
# Largest force of a T200 thruster ahead and astern [N] at supplied voltages [V]; Hoyer, section 4.2
T200 = np.array([[14.0, 44.1, 34.5], [16.0, 51.4, 39.2]])
HALVINGS = 40  # of the interval that contains the share of an unreachable force
NEWTON_STEPS = 40
ZERO_THRUST = 1e-13  # of a force, relative to that of all thrusters at their limit
RIDGE = 1e-12  # added to the diagonal, relative to it, as saturated thrusters do not respond


class Direct(NamedTuple):
    """No allocation: the command is applied unchanged."""

    share: float = 1.0


@lean_kernel
def _pass_on(table: Direct, tau: Array, applied: Array) -> None:
    for i in range(tau.shape[0]):
        applied[i] = table.share * tau[i]


class PseudoInverse(NamedTuple):
    """Geometry for the kernel, and work space for one allocation."""

    T: Array  # (n_dof, n_u)
    spare: Array  # (n_u,) 1 / weight
    low: Array  # (n_thrusters,) [N]
    high: Array
    first: Codes  # (n_thrusters + 1,) first component of each thruster
    u: Array  # (n_u,)
    pull: Array  # (n_u,) u without limits
    kept: Array  # (n_thrusters,) share of it that the limit allows
    multiplier: Array  # (n_dof,) lambda
    way: Array  # (n_dof,) step of lambda
    reach: Array  # (n_dof,) [N, Nm] force of all thrusters at their limit
    give: Array  # (n_dof,) diagonal of T W^-1 T'
    G: Array  # (n_dof, n_dof + 1)


@lean_kernel
def _respond(table: PseudoInverse) -> float:
    """Write u = P(W^-1 T' lambda), saturated at the limits; returns the conjugate of the cost."""
    total = 0.0
    for t in range(table.low.shape[0]):
        at, end = table.first[t], table.first[t + 1]
        square = 0.0
        for c in range(at, end):
            table.pull[c] = 0.0
            for i in range(table.multiplier.shape[0]):
                table.pull[c] += table.spare[c] * table.T[i, c] * table.multiplier[i]
            square += table.pull[c] ** 2
        astern = end - at == 1 and table.pull[at] < 0.0
        limit, size = -table.low[t] if astern else table.high[t], np.sqrt(square)
        table.kept[t] = limit / size if size > limit else 1.0
        for c in range(at, end):
            table.u[c] = table.kept[t] * table.pull[c]
            total += (table.pull[c] - 0.5 * table.u[c]) * table.u[c] / table.spare[c]
    return total


@lean_kernel
def _curve(table: PseudoInverse, i: int, j: int) -> float:
    """d (T u)_i / d lambda_j: saturated thrusters do not respond, or only sideways."""
    total = 0.0
    for t in range(table.low.shape[0]):
        along = along_i = along_j = square = 0.0
        for c in range(table.first[t], table.first[t + 1]):
            along += table.T[i, c] * table.T[j, c]
            along_i += table.T[i, c] * table.pull[c]
            along_j += table.T[j, c] * table.pull[c]
            square += table.pull[c] ** 2
        if table.kept[t] < 1.0:
            along -= along_i * along_j / square
        total += table.spare[table.first[t]] * table.kept[t] * along
    return total


@lean_kernel
def _residual(table: PseudoInverse, tau: Array, share: float) -> bool:
    """Write share tau - T u to the last column of G; returns whether it exceeds rounding."""
    nonzero = False
    for i in range(tau.shape[0]):
        rest = share * tau[i]
        for c in range(table.u.shape[0]):
            rest -= table.T[i, c] * table.u[c]
        table.G[i, -1] = rest
        nonzero = nonzero or abs(rest) > ZERO_THRUST * table.reach[i]
    return nonzero


@lean_kernel
def _newton_step(table: PseudoInverse, tau: Array, share: float, value: float) -> float:
    """A Newton step that maximises the dual function, halved until it rises; gradient in G."""
    n, G, slope = tau.shape[0], table.G, 0.0
    for i in range(n):
        table.way[i] = G[i, n]
        for j in range(n):
            G[i, j] = _curve(table, i, j)
        G[i, i] += RIDGE * table.give[i]
    for k in range(n):  # elimination; the matrix is symmetric and positive definite
        for i in range(n):
            factor = G[i, k] / G[k, k] if i != k else 0.0
            for j in range(k, n + 1):
                G[i, j] -= factor * G[k, j]
    for i in range(n):
        step = G[i, n] / G[i, i]
        slope += table.way[i] * step
        table.way[i] = step
        table.multiplier[i] += step
    length = 1.0
    for _ in range(HALVINGS):
        increased = -_respond(table)
        for i in range(n):
            increased += share * tau[i] * table.multiplier[i]
        if increased >= value + 1e-4 * length * slope - ZERO_THRUST * abs(value):
            return increased
        length *= 0.5
        for i in range(n):
            table.multiplier[i] -= length * table.way[i]
    return value


@lean_kernel
def _distribute(table: PseudoInverse, tau: Array, share: float) -> bool:
    """Write the u of least cost within the limits with T u = share tau; False if there is none."""
    for i in range(tau.shape[0]):
        table.multiplier[i] = 0.0
    value = -_respond(table)
    for _ in range(NEWTON_STEPS):
        if not _residual(table, tau, share):
            return True
        value = _newton_step(table, tau, share, value)
    return not _residual(table, tau, share)


@lean_kernel
def by_pseudo_inverse(table: PseudoInverse, tau: Array, applied: Array) -> None:
    """Write T u for the largest share of tau, at most all of it, that the thrusters can give."""
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


@kernel
def allocate_all(table: PseudoInverse, tau: Array, u: Array, applied: Array) -> None:
    """Write u (N, n_u) and T u (N, n_dof) for forces tau (N, n_dof)."""
    for k in range(tau.shape[0]):
        by_pseudo_inverse(table, tau[k], applied[k])
        u[k] = table.u


ALLOCATIONS: dict[type, Callable[..., None]] = {
    Direct: _pass_on,
    PseudoInverse: by_pseudo_inverse,
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
    low, high = T200
    slope = (1.0 - low[1:] / high[1:]) / (high[0] - low[0])
    ahead, astern = 1.0 + (voltage_v - high[0]) * slope
    return float(ahead), float(astern)


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
        along = np.array([self.direction]) / np.linalg.norm(self.direction)
        rows = {"fixed": along, "tunnel": np.eye(3)[1:2], "azimuth": np.eye(3)[:2]}[self.kind]
        return np.hstack([rows, np.cross(self.position_m, rows)]).T


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
        if self.voltage_v is not None:
            voltage_factors(self.voltage_v)

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

    def table(self, dofs: Sequence[str]) -> Direct | PseudoInverse:
        """Thruster geometry and limits for the allocation step."""
        if self.method == "none":
            return Direct()
        T = self.matrix(dofs)
        n_dof, n_u = T.shape
        ahead, astern = (1.0, 1.0) if self.voltage_v is None else voltage_factors(self.voltage_v)
        high = ahead * np.array([one.ahead_n for one in self.thrusters])
        low = -astern * np.array(
            [one.ahead_n if one.astern_n is None else one.astern_n for one in self.thrusters]
        )
        counts = [one.columns().shape[1] for one in self.thrusters]
        spare = np.repeat([1.0 / one.weight for one in self.thrusters], counts)
        if self.method == "qp":
            spare *= np.square(np.repeat(high, counts))
        u, pull, kept, multiplier, way = map(np.zeros, (n_u, n_u, len(low), n_dof, n_dof))
        reach, give = np.abs(T) @ np.repeat(np.maximum(high, -low), counts), np.square(T) @ spare
        first, G = np.cumsum([0, *counts]), np.zeros((n_dof, n_dof + 1))
        return PseudoInverse(
            T, spare, low, high, first, u, pull, kept, multiplier, way, reach, give, G
        )

    def allocate(self, tau: Array, dofs: Sequence[str]) -> Allocated:
        """Thruster forces that produce the forces tau [N, Nm], shape (N, n_dof)."""
        table = self.table(dofs)
        if isinstance(table, Direct):
            raise ConfigurationError("thrusters.method: got none, expected pseudo_inverse or qp")
        u, applied = np.empty((len(tau), table.T.shape[1])), np.empty_like(tau)
        allocate_all(table, np.ascontiguousarray(tau), u, applied)
        return Allocated(u, applied, reached(tau, applied))


def reached(tau: Array, applied: Array) -> NDArray[np.bool_]:
    """Whether each row of the applied force equals tau, both (N, n_dof); shape (N,)."""
    size = np.maximum(np.max(np.abs(tau), axis=0), 1e-300)
    return np.asarray(np.all(np.abs(applied - tau) <= REACHED * size, axis=1))
