"""Allocation of a force to the inputs of devices: dynamic positioning by thrusters and azimuths.

The forces of the thrusters are those of `seatrial.models.vessel.allocation`, within the bollard
pull that the inputs allow. A thrust T becomes the input x by the curve of its device at rest,

    T = k ((1 - q) s + q s^2),   s = (|x| - d) / (1 - d)

and a direction the azimuth nearest to the last one, with the thrust astern where that is known and
nearer. The loss by inflow is left to the feedback. Fossen (2021), section 11.2.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.allocation import (
    ALLOCATIONS,
    Allocation,
    PositionedThruster,
    PseudoInverse,
    by_pseudo_inverse,
)
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.devices.azimuth import Thruster
from seatrial.models.vessel.devices.device import Device
from seatrial.models.vessel.thruster import Input

IDLE = 1e-3  # of its largest thrust, below which an azimuth keeps its direction


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
            if low <= angle <= high and abs(angle - last) < best - 1e-9:
                best, table.held[t], sign = abs(angle - last), angle, 1.0 - 2.0 * side
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
            if thrust > IDLE * table.forces.high[t]:
                thrust = _turned(table, t, np.arctan2(aside, ahead), thrust)
            else:
                thrust = 0.0
            applied[table.alpha[t]] = table.held[t]
        applied[table.drive[t]] = input_of(thrust, table.curve[t])


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
        return Allocation("pseudo_inverse", tuple(map(self._positioned, self.devices)))

    def _positioned(self, device: Thruster) -> PositionedThruster:
        fixed, limits = device.alpha is None, self.inputs[device.drive]
        ahead, angle = thrust_at(device, limits.high), device.angle_rad
        return PositionedThruster(
            "fixed" if fixed else "azimuth", (device.x_m, device.y_m, 0.0), ahead,
            thrust_at(device, limits.low) if fixed else None,  # an azimuth turns instead
            (float(np.cos(angle)), float(np.sin(angle)), 0.0), weight=1.0 / ahead**2,
        )  # fmt: skip

    def table(self, dofs: tuple[str, ...]) -> DeviceTable:
        """Geometry and curves for the allocation step, with the azimuths at their start."""
        forces, own = self.forces().table(dofs), self.devices
        assert isinstance(forces, PseudoInverse)
        names = list(self.inputs)
        turns = [None if d.alpha is None else self.inputs[d.alpha] for d in own]
        return DeviceTable(
            forces, np.zeros(len(dofs)), np.array([float(i.start) for i in self.inputs.values()]),
            np.array([names.index(d.drive) for d in own]),
            np.array([-1 if d.alpha is None else names.index(d.alpha) for d in own]),
            np.array([(d.ahead, d.astern or d.ahead, d.dead_band, d.curvature) for d in own]),
            np.array([thrust_at(d, self.inputs[d.drive].low) for d in own]),
            np.array([
                (d.angle_rad, *((turn.low, turn.high) if turn else (0.0, 0.0)))
                for d, turn in zip(own, turns, strict=True)
            ]),
            np.array([turn.start if turn else 0.0 for turn in turns]),
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
    if not own or len(own) < len(driven):
        return None
    result = DeviceAllocation(own, inputs)
    try:
        return result if min(result.limits(dofs)) > 0.0 else None
    except ConfigurationError:  # not independently
        return None
