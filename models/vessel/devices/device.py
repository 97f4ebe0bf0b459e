"""The interface of a device, and the forces of all devices of a vessel.

A device gives forces and moments on the hull from the inputs and the motion through the water,
which are variables of the basis. Its options are physical parameters with names, units and bounds.
The kernels read them from one array for all devices, so that an identifier can change them; the
structure of a device, such as the indices of its inputs, is a named tuple for which its step is
registered in `DEVICES`. The equation of motion calls these steps through their addresses
(`seatrial.models.bound`), in the order in which the devices are configured.

A rudder or fin lies in the flow that a propeller leaves. A propeller therefore writes this flow to
its place in `wake`: the velocity that reaches it and the velocity far behind it [m/s], along the
hull.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, ClassVar, NamedTuple, TypeAlias, cast

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from seatrial.models.bound import MEMORY, ROW, bound, entry
from seatrial.models.compiled import LEAN, is_compiled, kernel, tuple_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.packs import PACKS
from seatrial.models.ranges import check_ranges
from seatrial.models.vessel.basis import INDEX, INPUTS, N_VARIABLES, Array

FORCES = 6  # surge, sway, heave, roll, pitch, yaw
WAKE = 2  # numbers that a device leaves for those behind it
MAX_DEVICES = 8  # devices of a vessel
DEVICES: dict[type, Callable[..., None]] = {}
Structure: TypeAlias = Any  # the named tuple that a device's step is registered for
SLACK = 0.01  # of a range, that noise may exceed
PER_MINUTE = 60.0
SMALL, PLAUSIBLE = 0.05, 1.5  # parts of the largest J of a propeller


class Bounds(NamedTuple):
    """Unit of a number and the range in which it is plausible."""

    unit: str
    low: float
    high: float

    def check(self, name: str, value: float) -> None:
        """Raise ConfigurationError for a number out of the range, or none."""
        if not self.low <= value <= self.high:
            unit = f" {self.unit}" if self.unit else ""
            other = {"rad": "; is it in degrees?", "1/s": "; is it in 1/min?"}.get(self.unit, "")
            raise ConfigurationError(
                f"{name}: got {value:g}, expected {self.low:.4g} to {self.high:.4g}{unit}{other}"
            )


INPUT_BOUNDS = {  # by the beginning of the name
    "delta": Bounds("rad", -0.5 * math.pi, 0.5 * math.pi),
    "alpha": Bounds("rad", -4.0 * math.pi, 4.0 * math.pi),
    "n": Bounds("1/s", -500.0, 500.0),
    "pwm": Bounds("", -1.0, 1.0),
}


def input_bounds(name: str) -> Bounds:
    """Unit and plausible range of an input by its name, such as `n_1`."""
    return INPUT_BOUNDS[name.split("_")[0]]


class DataRange(NamedTuple):
    """A quantity of a device over samples, and the range of its data."""

    name: str
    unit: str
    values: Array  # (N,), NaN where it is not defined
    low: float
    high: float


@dataclass(frozen=True)
class Device(ABC):
    """Options of a device: its parameters, and the names of its inputs.

    `PARAMETERS` are the fields that are parameters, with unit and plausible range, in the order in
    which the step reads them.
    """

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {}
    LOADS: ClassVar[tuple[str, ...]] = ()  # what may be measured on it [N]

    def __post_init__(self) -> None:
        for name, bounds in self.PARAMETERS.items():
            value = getattr(self, name)
            if value is not None:
                bounds.check(name, value)
        check_ranges(self)
        unknown = [name for name in self.inputs() if name not in INPUTS]
        if unknown:
            raise ConfigurationError(
                f"devices: got input {unknown[0]!r}, expected one of {', '.join(INPUTS)}"
            )

    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs that the device reads."""

    @abstractmethod
    def structure(self, first: int, place: int, places: Mapping[str, int]) -> Structure:
        """The named tuple of a step registered in `DEVICES`.

        `first` is the position of its first parameter in the array of all parameters, `place` that
        of its two numbers in `wake`, and `places` are those of the devices before it, by name.
        """

    def ranges(self, x: Array) -> tuple[DataRange, ...]:
        """Quantities with limited data, for samples of the variables x (N, N_VARIABLES); none."""
        return ()

    def loads(self, x: Array) -> Array:
        """Its `LOADS` [N], shape (N, n_loads), for samples of the variables x (N, N_VARIABLES)."""
        return np.zeros((len(x), 0))

    def values(self) -> Array:
        """Values of the parameters, in SI units, in the order of `PARAMETERS`."""
        return np.array([getattr(self, name) for name in self.PARAMETERS], dtype=np.float64)

    def with_values(self, values: Sequence[float]) -> "Device":
        """The device with other values of its parameters."""
        options = {field.name: getattr(self, field.name) for field in fields(self)}
        changed = zip(self.PARAMETERS, map(float, values), strict=True)
        return type(self)(**{**options, **dict(changed)})


def with_parameters(devices: Mapping[str, Device], values: Sequence[float]) -> dict[str, Device]:
    """Devices with other values of all their parameters, in the order of `installed`.

    A value beyond its plausible range, as a draw may be, is that at the end of the range.
    """
    changed, left = {}, iter(values)
    for name, device in devices.items():
        own = zip(device.PARAMETERS.values(), left, strict=False)
        changed[name] = device.with_values([min(max(x, low), high) for (_, low, high), x in own])
    return changed


class Installed(NamedTuple):
    """The devices of a vessel in the form that the kernels need."""

    structures: tuple[Structure, ...]
    parameters: Array  # of all devices, one after the other
    labels: tuple[str, ...]  # of the parameters, such as rudder.gamma_R
    bounds: tuple[Bounds, ...]  # units and plausible ranges of the parameters


def installed(devices: Mapping[str, Device]) -> Installed:
    """Devices by name, in the order of their flow: a propeller before the rudder behind it."""
    structures, values = [], [np.zeros(0)]
    labels: list[str] = []
    bounds: list[Bounds] = []
    places: dict[str, int] = {}
    if len(devices) > MAX_DEVICES:
        raise ConfigurationError(f"devices: got {len(devices)}, expected at most {MAX_DEVICES}")
    for name, device in devices.items():
        place = WAKE * len(places)
        structures.append(device.structure(len(labels), place, places))
        values.append(device.values())
        labels += [f"{name}.{parameter}" for parameter in device.PARAMETERS]
        bounds += device.PARAMETERS.values()
        places[name] = place
    return Installed(tuple(structures), np.concatenate(values), tuple(labels), tuple(bounds))


NO_DEVICES = installed({})


def exert(
    structures: tuple[Structure, ...], parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add the forces of devices to `force` (6,) [N, Nm]; `structures` may be `BoundDevices`.

    `z` are the variables and their magnitudes, shape (2 N_VARIABLES,), `parameters` those of all
    devices, and `wake` (WAKE * MOST,) is work space.
    """
    for structure in structures:
        DEVICES[type(structure)](structure, parameters, z, wake, force)


class BoundDevices(NamedTuple):
    """Devices whose steps are called through their addresses; of one type for all vessels."""

    addresses: NDArray[np.int64]  # (n,)
    memory: NDArray[np.uint8]  # (n, MEMORY) their structures


@overload(exert, jit_options=LEAN)
def _exert(
    structures: Any, parameters: Array, z: Array, wake: Array, force: Array
) -> Callable[..., None]:
    members, kind = cast(Any, structures), cast(Any, z)
    if getattr(members, "instance_class", None) is BoundDevices:
        call: Any = {ROW: _call_device, PACKS: _call_device_of_packs}[kind]

        def call_each(
            structures: Any, parameters: Array, z: Array, wake: Array, force: Array
        ) -> None:
            for i in range(structures.addresses.shape[0]):
                call(structures.addresses[i], structures.memory[i], (parameters, z, wake, force))

        return call_each
    if len(members) == 0:

        def nothing(
            structures: Any, parameters: Array, z: Array, wake: Array, force: Array
        ) -> None:
            pass

        return nothing
    step = DEVICES[tuple_of(members[0])]

    def apply(structures: Any, parameters: Array, z: Array, wake: Array, force: Array) -> None:
        step(structures[0], parameters, z, wake, force)
        exert(structures[1:], parameters, z, wake, force)

    return apply


_device, _call_device = entry(exert, *[ROW] * 4)
_device_of_packs, _call_device_of_packs = entry(exert, *[PACKS] * 4)


@kernel
def _bind_device(memory: Array, parts: Any) -> int:
    return _device(memory, parts)  # type: ignore[no-any-return]


@kernel
def _bind_device_of_packs(memory: Array, parts: Any) -> int:
    return _device_of_packs(memory, parts)  # type: ignore[no-any-return]


@cache
def _bound_devices(kinds: tuple[type, ...], rows: tuple[Structure, ...], of_packs: bool) -> Any:
    bind = _bind_device_of_packs if of_packs else _bind_device
    each = [bound(bind, (row,)) for row in rows]
    memory = np.array([one.memory for one in each], np.uint8).reshape(-1, MEMORY)
    return BoundDevices(np.array([one.address for one in each], np.int64), memory)


def bound_devices(structures: tuple[Structure, ...], of_packs: bool = False) -> Any:
    """Devices in the form that is the same for all of them, for arrays of numbers or of packs.

    As they are if numba is disabled.
    """
    if not is_compiled(_sample_forces):
        return structures
    return _bound_devices(tuple(map(type, structures)), structures, of_packs)


@kernel
def _sample_forces(
    structures: tuple[Structure, ...], parameters: Array, x: Array, forces: Array
) -> None:
    z, wake = np.zeros(2 * N_VARIABLES), np.zeros(WAKE * MAX_DEVICES)
    for k in range(x.shape[0]):
        for j in range(N_VARIABLES):
            z[j], z[N_VARIABLES + j] = x[k, j], abs(x[k, j])
        exert(structures, parameters, z, wake, forces[k])


def device_forces(devices: Installed, x: Array) -> Array:
    """Forces of devices [N, Nm], shape (N, 6), for variables x, shape (N, N_VARIABLES)."""
    forces = np.zeros((len(x), FORCES))
    structures = bound_devices(devices.structures)
    _sample_forces(structures, devices.parameters, np.ascontiguousarray(x), forces)
    return forces


def input_index(name: str) -> int:
    """Position of an input among the variables."""
    return INDEX[name]


class Excess(NamedTuple):
    """A quantity of a device outside of the range of its data."""

    name: str  # such as propeller.J
    seconds: float
    text: str  # how long and how far, one line


def excesses(devices: Mapping[str, Device], x: Array, period_s: float) -> list[Excess]:
    """What lies outside at samples x (N, N_VARIABLES), a period [s] apart, quantity by quantity."""
    found = []
    for name, device in devices.items():
        for one in device.ranges(x):
            slack = SLACK * (one.high - one.low if np.isfinite(one.high - one.low) else 1.0)
            below, above = one.values < one.low - slack, one.values > one.high + slack
            seconds = period_s * float(np.sum(below | above))
            if seconds == 0.0:
                continue
            least, most = float(np.nanmin(one.values)), float(np.nanmax(one.values))
            reached = [f"down to {least:.3g}"] * bool(np.any(below))
            reached += [f"up to {most:.3g}"] * bool(np.any(above))
            whole = period_s * len(x)
            limits = f"{one.low:.3g} to {one.high:.3g}" if np.isfinite(one.high) else "0 or more"
            text = (
                f"{name}: {one.name} {' and '.join(reached)} {one.unit}".rstrip()
                + f", outside of its data ({limits}) for {seconds:.3g} s of {whole:.4g} s"
            )
            found.append(Excess(f"{name}.{one.name}", seconds, text))
    return found


def doubts(devices: Mapping[str, Device], x: Array) -> list[str]:
    """Shaft speeds of samples x that are likely to be in revolutions a minute, one line each.

    Where a propeller runs ahead in the median at a J that is small, and 60 times that is common.
    """
    found = []
    for name, device in devices.items():
        for one in device.ranges(x):
            values = one.values[one.values > 0.0]
            if one.name != "J" or not len(values):
                continue
            median = float(np.median(values))
            common = PER_MINUTE * median
            if median < SMALL * one.high and common < PLAUSIBLE * one.high:
                found.append(
                    f"{name}: J = {median:.2g} in the median, expected up to {one.high:.2g}; with "
                    f"n divided by 60 it is {common:.2g}: is n in 1/min instead of 1/s?"
                )
    return found
