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

For devices, the limits are the bollard pull that their inputs allow. A thrust becomes an input by
the curve of its device at rest (`devices.azimuth`), and a direction the azimuth nearest to the last
one, with the thrust astern where that is known and nearer. The loss by inflow is left to the
feedback. Fossen (2021), section 11.2.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le
from numba.extending import overload
from numpy.typing import NDArray

from seatrial.models.compiled import LEAN, lean_kernel, tuple_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.devices.azimuth import Thruster
from seatrial.models.vessel.devices.device import Device
from seatrial.models.vessel.thruster import Input

REACHED = 1e-9  # relative tolerance within which an applied force equals the commanded one
IDLE = 1e-3  # of its largest thrust, below which an azimuth keeps its direction
ROUNDED = 0.005  # [rad] by which the limits of an azimuth may be rounded: 1.57, 3.14
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


class DeviceTable(NamedTuple):
    """Geometry and curves of n thrusters for the kernel, and its work space."""

    forces: PseudoInverse
    reached: Array  # (n_dof,) [N, Nm] at bollard pull
    base: Array  # (n_inputs,) values of inputs that no thruster uses
    drive: Codes  # (n,) input of each thruster
    alpha: Codes  # (n,) input of its azimuth; -1: it cannot turn
    curve: Array  # (n, 4) thrust [N] of an input of 1 ahead and astern, dead band d and curvature q
    astern: Array  # (n,) [N] largest thrust astern
    angles: Array  # (n, 3) [rad] direction at an azimuth of zero, lowest and highest azimuth
    held: Array  # (n,) [rad] last azimuths


@lean_kernel
def input_of(thrust: float, curve: Array) -> float:
    """The input of a thrust [N]: the inverse of the device's curve (4,)."""
    share = abs(thrust) / (curve[0] if thrust >= 0.0 else curve[1])
    if share <= 0.0:
        return 0.0
    dead, q, linear = curve[2], curve[3], 1.0 - curve[3]
    s = share if q <= 0.0 else (np.sqrt(linear * linear + 4.0 * q * share) - linear) / (2.0 * q)
    return float(np.copysign(dead + (1.0 - dead) * s, thrust))


@lean_kernel
def _turned(table: DeviceTable, t: int, direction: float, thrust: float) -> float:
    """Hold the azimuth nearest to the last one; returns the thrust with its sign."""
    last, best, sign = table.held[t], np.inf, 1.0
    neutral, low, high = table.angles[t]
    for side in range(1 if thrust > table.astern[t] else 2):
        for turn in range(-2, 3):
            angle = direction - neutral + np.pi * side + 2.0 * np.pi * turn
            within = low - ROUNDED <= angle <= high + ROUNDED
            if within and abs(angle - last) < best - 1e-9:
                best, sign = abs(angle - last), 1.0 - 2.0 * side
                table.held[t] = min(max(angle, low), high)
    return sign * thrust


@lean_kernel
def by_devices(table: DeviceTable, tau: Array, applied: Array) -> None:
    """Write the inputs (n_inputs,) of the devices that give the largest share of tau (n_dof,)."""
    by_pseudo_inverse(table.forces, tau, table.reached)
    for i in range(table.base.shape[0]):
        applied[i] = table.base[i]
    for t in range(table.drive.shape[0]):
        at = table.forces.first[t]
        thrust = table.forces.u[at]
        if table.alpha[t] >= 0:
            ahead, aside = thrust, table.forces.u[at + 1]
            thrust = np.sqrt(ahead * ahead + aside * aside)
            idle = thrust <= IDLE * table.forces.high[t]
            thrust = 0.0 if idle else _turned(table, t, np.arctan2(aside, ahead), thrust)
            applied[table.alpha[t]] = table.held[t]
        applied[table.drive[t]] = input_of(thrust, table.curve[t])


ALLOCATIONS: dict[type, Callable[..., None]] = {
    Direct: _pass_on,
    PseudoInverse: by_pseudo_inverse,
    DeviceTable: by_devices,
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
    astern_n: NotNegative | None = None  # None: equal to ahead_n
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    weight: Positive = 1.0

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.astern_n is not None and self.kind == "azimuth":
            raise ConfigurationError(f"astern_n: got {self.astern_n}, expected null of an azimuth")
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

    `voltage_v` is the supply voltage of thrusters whose limits are stated for 16 V; these are
    linear in it.
    """

    method: Literal["none", "pseudo_inverse", "qp"]
    thrusters: tuple[PositionedThruster, ...]
    voltage_v: Annotated[float, Ge(14.0), Le(16.7)] = 16.0  # of the batteries

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.thrusters:
            raise ConfigurationError("thrusters: got none, expected at least one")

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
        low_v, high_v = T200
        slope = (1.0 - low_v[1:] / high_v[1:]) / (high_v[0] - low_v[0])
        ahead, astern = 1.0 + (self.voltage_v - high_v[0]) * slope
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

    def faces(self, dofs: Sequence[str], limits: Array) -> Array:
        """Half-spaces F u <= 1, (k, n_dof), that hold every force that the thrusters give together.

        u are shares of the `limits` [N, Nm], which bound the axes alone. The force along a normal d
        is at most h(d) = sum_t max d' T_t u_t, the support function of the sum of the thrusters'
        sets: Schneider (2014), Convex bodies, section 1.7. Normals are those of the cut edges and
        corners of the box of the limits; where nothing is allocated there are none.
        """
        if isinstance(table := self.table(dofs), Direct):
            return np.zeros((0, len(limits)))
        normals = np.array([*product((-1.0, 0.0, 1.0), repeat=len(limits))])
        normals = normals[np.count_nonzero(normals, axis=1) > 1]
        along = np.split(table.T.T @ (normals / limits).T, table.first[1:-1])
        most = [  # of every thruster, in each direction
            high * np.hypot(*g) if len(g) > 1 else np.maximum(high * g[0], low * g[0])
            for g, low, high in zip(along, table.low, table.high, strict=True)
        ]
        return np.asarray(normals / np.sum(most, axis=0)[:, None])

    def allocate(self, tau: Array, dofs: Sequence[str]) -> Allocated:
        """Thruster forces that produce the forces tau [N, Nm], shape (N, n_dof)."""
        table = self.table(dofs)
        if isinstance(table, Direct):
            raise ConfigurationError("thrusters.method: got none, expected pseudo_inverse or qp")
        u, applied = np.empty((len(tau), table.T.shape[1])), np.empty_like(tau)
        for k, wanted in enumerate(np.ascontiguousarray(tau)):
            by_pseudo_inverse(table, wanted, applied[k])
            u[k] = table.u
        return Allocated(u, applied, reached(tau, applied))


def reached(tau: Array, applied: Array) -> NDArray[np.bool_]:
    """Whether each row of the applied force equals tau, both (N, n_dof); shape (N,)."""
    size = np.maximum(np.max(np.abs(tau), axis=0), 1e-300)
    return np.asarray(np.all(np.abs(applied - tau) <= REACHED * size, axis=1))


def thrust_at(device: Thruster, value: float) -> float:
    """Bollard pull [N] at an input, not negative; 0 for one astern that is not known."""
    scale = device.ahead if value >= 0.0 else device.astern or 0.0
    s = max((abs(value) - device.dead_band) / (1.0 - device.dead_band), 0.0)
    return float(scale * ((1.0 - device.curvature) * s + device.curvature * s * s))


@dataclass(frozen=True)
class DeviceAllocation:
    """The thrusters of a vessel with inputs, which together give a force on each of its axes."""

    devices: tuple[Thruster, ...]
    inputs: Mapping[str, Input]

    def forces(self) -> Allocation:
        """The thrusters with their bollard pull; the larger ones are used more.

        An azimuth that turns by half a circle or more, not by all of it, has the thrust that it
        gives ahead and astern. Raises ConfigurationError for one that turns by less.
        """
        thrusters = []
        for device in self.devices:
            fixed, limits, angle = device.alpha is None, self.inputs[device.drive], device.angle_rad
            ahead, astern = thrust_at(device, limits.high), thrust_at(device, limits.low)
            if device.alpha:
                turn = self.inputs[device.alpha].high - self.inputs[device.alpha].low + 2 * ROUNDED
                ahead = ahead if turn >= 2.0 * np.pi else min(ahead, astern)
                if turn < np.pi or not ahead:
                    raise ConfigurationError(f"{device.alpha}: not every direction is reached")
            thrusters.append(PositionedThruster(
                "fixed" if fixed else "azimuth", (device.x_m, device.y_m, 0.0), ahead,
                astern if fixed else None,  # an azimuth turns instead
                (float(np.cos(angle)), float(np.sin(angle)), 0.0), weight=1.0 / ahead**2,
            ))  # fmt: skip
        return Allocation("pseudo_inverse", tuple(thrusters))

    def table(self, dofs: tuple[str, ...]) -> DeviceTable:
        """Geometry and curves for the allocation step, with the azimuths at their start."""
        forces, own, names = self.forces().table(dofs), self.devices, list(self.inputs)
        assert isinstance(forces, PseudoInverse)
        turns = [self.inputs[d.alpha or d.drive] for d in own]  # of fixed ones they are not used
        return DeviceTable(
            forces, np.zeros(len(dofs)), np.array([float(i.start) for i in self.inputs.values()]),
            np.array([names.index(d.drive) for d in own]),
            np.array([-1 if d.alpha is None else names.index(d.alpha) for d in own]),
            np.array([(d.ahead, d.astern or d.ahead, d.dead_band, d.curvature) for d in own]),
            np.array([thrust_at(d, self.inputs[d.drive].low) for d in own]),
            np.array([(d.angle_rad, i.low, i.high) for d, i in zip(own, turns, strict=True)]),
            np.array([i.start for i in turns]),
        )  # fmt: skip

    def limits(self, dofs: tuple[str, ...]) -> tuple[float, ...]:
        """Largest force on each axis alone, in both directions [N, Nm]."""
        allocation, n = self.forces(), len(dofs)
        table = allocation.table(dofs)
        assert isinstance(table, PseudoInverse)
        most = np.diag(table.reach)
        applied = allocation.allocate(np.vstack([most, -most]), dofs).applied
        reach = np.abs(np.diagonal(applied.reshape(2, n, n), axis1=1, axis2=2))
        return tuple(np.min(reach, axis=0).tolist())


def device_allocation(
    devices: Mapping[str, Device], inputs: Mapping[str, Input], dofs: tuple[str, ...]
) -> DeviceAllocation | None:
    """The allocation of a vessel whose inputs all drive thrusters; None if it cannot be positioned.

    The thrusters must give a force on each axis independently.
    """
    driven = [device for device in devices.values() if device.inputs()]
    own = tuple(device for device in driven if isinstance(device, Thruster))
    result = DeviceAllocation(own, inputs)
    with suppress(ConfigurationError):  # without thrusters, or not independently
        if len(own) == len(driven) and min(result.limits(dofs)) > 0.0:
            return result
    return None
