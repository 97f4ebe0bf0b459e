"""Thrust allocation: which force each thruster gives so that together they give tau.

    tau = T u,    T = [d; r x d] of a thruster at r that pushes along d      Bargouth, (2.11)-(2.14)

An azimuth thruster has two components of u, its force ahead and to starboard, (2.15)-(2.18).
Two methods: a weighted pseudo-inverse u = W^-1 T' (T W^-1 T')^-1 tau, in which thrusters that
exceed their limit stay there and the others share the rest, compiled; and a quadratic program of a
solver's. What cannot be reached is scaled, its direction kept.
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
from seatrial.models.vessel.thrust_program import QuadraticProgram, by_program, circles_of

REACHED = 1e-9  # of the scale: closer to one is reached
# Largest force of a T200 thruster ahead and astern [N] at supplied voltages [V]; Hoyer, section 4.2
T200 = ((14.0, 44.1, 34.5), (16.0, 51.4, 39.2))


class Direct(NamedTuple):
    """No allocation: every force can be given."""

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
    """The force [N, Nm] that is given for the force tau that is asked for, both (n_dof,)."""
    ALLOCATIONS[type(table)](table, tau, applied)


@overload(allocate_step, jit_options=LEAN)
def _allocate_step(table: NamedTuple, tau: Array, applied: Array) -> Callable[..., None]:
    step = ALLOCATIONS[tuple_of(table)]

    def chosen(table: NamedTuple, tau: Array, applied: Array) -> None:
        step(table, tau, applied)

    return chosen


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
    ahead_n: Positive
    astern_n: float | None = None  # None: as ahead
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    weight: Positive = 1.0

    def __post_init__(self) -> None:
        check_ranges(self)
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
            size = np.repeat(np.maximum(high, -low), counts)
            u, pull = np.zeros(T.shape[1]), np.zeros(T.shape[1])
            multiplier, way = np.zeros(len(dofs)), np.zeros(len(dofs))
            reach, give = np.abs(T) @ size, np.square(T) @ (1.0 / weight)
            return PseudoInverse(
                T, 1.0 / weight, low, high, first, u, pull, multiplier, way, reach, give, G
            )
        turns = np.array([one.kind == "azimuth" for one in self.thrusters])
        low = np.where(turns, -high, low)
        first = np.cumsum([0, *counts[:-1]])[np.array(counts) == 2]
        pairs = np.stack([first, first + 1], axis=1).astype(np.int64)
        sizes = np.repeat(low, counts), np.repeat(high, counts)
        circles = circles_of(counts)
        return QuadraticProgram(T, weight, *sizes, circles, pairs, np.zeros(T.shape[1]))

    def allocate(self, tau: Array, dofs: Sequence[str]) -> Allocated:
        """Thruster forces for forces tau [N, Nm], shape (N, n_dof)."""
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
    """Whether the force that was given is the one that was asked for; rows of (N, n_dof)."""
    size = np.maximum(np.max(np.abs(tau), axis=0), 1e-300)
    return np.asarray(np.all(np.abs(applied - tau) <= REACHED * size, axis=1))
