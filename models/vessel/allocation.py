"""Thrust allocation: the forces u of the thrusters that produce the generalised force tau.

    tau = T u,    T = [d; r x d] of a thruster at r that pushes along d      Bargouth, (2.11)-(2.14)

An azimuth thruster has two components of u, its force ahead and to starboard, (2.15)-(2.18).
Two methods differ in what is least: `pseudo_inverse` the forces, `qp` their shares of the limits.
A force that cannot be reached is scaled down, and keeps its direction.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from seatrial.models.compiled import LEAN, lean_kernel, tuple_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.pseudo_inverse import PseudoInverse, allocate_all, by_pseudo_inverse

REACHED = 1e-9  # relative tolerance within which an applied force equals the commanded one
# Largest force of a T200 thruster ahead and astern [N] at supplied voltages [V]; Hoyer, section 4.2
T200 = ((14.0, 44.1, 34.5), (16.0, 51.4, 39.2))


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
        u, pull, multiplier, way = (np.zeros(n) for n in (n_u, n_u, n_dof, n_dof))
        return PseudoInverse(
            T, spare, low, high, np.cumsum([0, *counts]), u, pull, multiplier, way,
            reach=np.abs(T) @ np.repeat(np.maximum(high, -low), counts),
            give=np.square(T) @ spare, G=np.zeros((n_dof, n_dof + 1)),
        )  # fmt: skip

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
