"""Allocation of a force to the inputs of devices: dynamic positioning by thrusters and azimuths.

The forces of the thrusters are those of `seatrial.models.vessel.allocation`, within the bollard
pull that the inputs allow. A thrust T becomes the input x by the curve of its device at rest,

    T = k ((1 - q) s + q s^2),   s = (|x| - d) / (1 - d)

and a direction the azimuth nearest to the last one, with the thrust astern where that is known and
nearer. The loss by inflow is left to the feedback. Fossen (2021), section 11.2.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.allocation import ALLOCATIONS, Allocation, PositionedThruster
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.devices.azimuth import Thruster
from seatrial.models.vessel.devices.device import Device
from seatrial.models.vessel.pseudo_inverse import PseudoInverse, by_pseudo_inverse
from seatrial.models.vessel.thruster import Input

IDLE = 1e-3  # of its largest thrust, below which an azimuth keeps its direction
TURN = 2.0 * np.pi


class DeviceTable(NamedTuple):
    """Geometry and curves of the thrusters for the kernel, and its work space."""

    forces: PseudoInverse
    reached: Array  # (n_dof,) [N, Nm] at bollard pull
    base: Array  # (n_inputs,) values of inputs that no thruster uses
    drive: Codes  # (n,) input of each thruster
    alpha: Codes  # (n,) input of its azimuth; -1: it cannot turn
    ahead: Array  # (n,) [N] for an input of 1
    astern: Array
    dead: Array
    curve: Array
    largest: Array  # (n, 2) [N] ahead, astern
    neutral: Array  # (n,) [rad] direction at an azimuth of zero
    low: Array  # (n,) [rad]
    high: Array
    held: Array  # (n,) [rad] last azimuths


@lean_kernel
def input_of(thrust: float, scale: float, curve: float, dead: float) -> float:
    """The input of a thrust [N] of one sign, not negative: the inverse of the device's curve."""
    share = thrust / scale
    if share <= 0.0:
        return 0.0
    linear = 1.0 - curve
    s = share / linear
    if curve > 0.0:
        s = (np.sqrt(linear * linear + 4.0 * curve * share) - linear) / (2.0 * curve)
    return float(dead + (1.0 - dead) * s)


@lean_kernel
def _turned(table: DeviceTable, t: int, direction: float, thrust: float) -> float:
    """Hold the azimuth nearest to the last one; returns the thrust with its sign."""
    last, best, sign = table.held[t], np.inf, 1.0
    chosen = last
    for side in range(2):
        if side == 1 and thrust > table.largest[t, 1]:
            break
        for turn in range(-2, 3):
            angle = direction - table.neutral[t] + 0.5 * TURN * side + TURN * turn
            if table.low[t] <= angle <= table.high[t] and abs(angle - last) < best - 1e-9:
                best, chosen, sign = abs(angle - last), angle, 1.0 - 2.0 * side
    table.held[t] = chosen
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
            if thrust > IDLE * table.largest[t, 0]:
                thrust = _turned(table, t, np.arctan2(aside, ahead), thrust)
            else:
                thrust = 0.0
            applied[table.alpha[t]] = table.held[t]
        size, curve, dead = abs(thrust), table.curve[t], table.dead[t]
        if thrust >= 0.0:
            applied[table.drive[t]] = input_of(size, table.ahead[t], curve, dead)
        else:
            applied[table.drive[t]] = -input_of(size, table.astern[t], curve, dead)


ALLOCATIONS[DeviceTable] = by_devices


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
        """The thrusters with their bollard pull; the larger ones are used more."""
        thrusters = []
        for device in self.devices:
            ahead, astern = self._pull(device)
            direction = float(np.cos(device.angle_rad)), float(np.sin(device.angle_rad)), 0.0
            thrusters.append(
                PositionedThruster(
                    "fixed" if device.alpha is None else "azimuth",
                    (device.x_m, device.y_m, 0.0),
                    ahead,
                    astern if device.alpha is None else None,  # an azimuth turns instead
                    direction,
                    weight=1.0 / ahead**2,
                )
            )
        return Allocation("pseudo_inverse", tuple(thrusters))

    def _pull(self, device: Thruster) -> tuple[float, float]:
        limits = self.inputs[device.drive]
        return thrust_at(device, limits.high), thrust_at(device, limits.low)

    def table(self, dofs: tuple[str, ...]) -> DeviceTable:
        """Geometry and curves for the allocation step, with the azimuths at their start."""
        forces = self.forces().table(dofs)
        assert isinstance(forces, PseudoInverse)
        names, numbers = list(self.inputs), []
        for d in self.devices:
            turn = None if d.alpha is None else self.inputs[d.alpha]
            turns = (0.0, 0.0, 0.0) if turn is None else (turn.low, turn.high, turn.start)
            curve = d.ahead, d.astern or d.ahead, d.dead_band, d.curvature
            numbers.append((*curve, d.angle_rad, *turns))
        ahead, astern, dead, curved, neutral, low, high, held = np.array(numbers).T.copy()
        return DeviceTable(
            forces, np.zeros(len(dofs)), np.array([float(i.start) for i in self.inputs.values()]),
            np.array([names.index(d.drive) for d in self.devices]),
            np.array([-1 if d.alpha is None else names.index(d.alpha) for d in self.devices]),
            ahead, astern, dead, curved, np.array([self._pull(d) for d in self.devices]), neutral,
            low, high, held,
        )  # fmt: skip

    def limits(self, dofs: tuple[str, ...]) -> tuple[float, ...]:
        """Largest force on each axis alone, in both directions [N, Nm]."""
        return _limits(self.devices, tuple(self.inputs.items()), dofs)


@lru_cache(maxsize=64)  # the vessels of a sweep have the same thrusters
def _limits(
    devices: tuple[Thruster, ...], inputs: tuple[tuple[str, Input], ...], dofs: tuple[str, ...]
) -> tuple[float, ...]:
    allocation = DeviceAllocation(devices, dict(inputs)).forces()
    table = allocation.table(dofs)
    assert isinstance(table, PseudoInverse)
    most = np.diag(table.reach)
    applied = allocation.allocate(np.vstack([most, -most]), dofs).applied
    reach = np.abs(np.diagonal(applied.reshape(2, len(dofs), -1), axis1=1, axis2=2))
    return tuple(np.min(reach, axis=0).tolist())


def device_allocation(
    devices: Mapping[str, Device], inputs: Mapping[str, Input], dofs: tuple[str, ...]
) -> DeviceAllocation | None:
    """The allocation of a vessel whose inputs all drive thrusters; None if it cannot be positioned.

    The thrusters must give a force on each axis independently.
    """
    driven = [device for device in devices.values() if device.inputs()]
    own = tuple(device for device in driven if isinstance(device, Thruster))
    if not own or len(own) < len(driven):
        return None
    result = DeviceAllocation(own, inputs)
    try:
        return result if min(result.limits(dofs)) > 0.0 else None
    except ConfigurationError:  # not independently
        return None
