"""A stored model in SDF, for Gazebo and for VRX, and what their plugins do not have.

A plugin adds a force of the motion to that of a rigid body, in axes forward, to port and up:

    gazebo:  F_i = M_ij nu_dot_j + D_ij nu_j + D_ijk nu_j nu_k + E_ijk nu_j |nu_k|
    vrx:     F_i = -(M_i nu_dot_i + D_i nu_i + E_i |nu_i| nu_i)

(Hydrodynamics.hh of gz-sim 8, whose own Coriolis forces are disabled; SimpleHydrodynamics.hh of
VRX.) The rigid body is the heaviest one with which no added mass is negative, since the plugins
compute the force of an added mass from accelerations of the step before; its Coriolis forces are
those of the physics engine. Thrusters are commanded in N. Any other part of the model is named at
the head of the file, with the root mean square of its force at the motion of the run's recording.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from seatrial.models.notation import ACCELERATIONS, DOFS, POSES, VELOCITIES
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import INDEX, N_VARIABLES, Array, Term
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.devices.azimuth import Thruster
from seatrial.models.vessel.devices.device import device_forces, installed
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.table import Vessel
from seatrial.runner.export.equations import equations_of
from seatrial.runner.export.stored_model import DERIVATIVE_LETTERS, StoredModel

SIGNS = (1.0, -1.0, -1.0, 1.0, -1.0, -1.0)  # of the axes forward, to port and up
SPEEDS = {INDEX[name]: k for k, name in enumerate(VELOCITIES)}
RATES = {INDEX[name]: k for k, name in enumerate(ACCELERATIONS)}


class HydrodynamicsPlugin(NamedTuple):
    """A plugin: its library, its name, whether it couples axes, and the sign of its parameters."""

    filename: str
    name: str
    couples: bool
    sign: float


PLUGINS = {
    "gazebo": HydrodynamicsPlugin(
        "gz-sim-hydrodynamics-system", "gz::sim::systems::Hydrodynamics", True, -1.0
    ),
    "vrx": HydrodynamicsPlugin("libSimpleHydrodynamics.so", "vrx::SimpleHydrodynamics", False, 1.0),
}


class Thrust(NamedTuple):
    """A thruster: its place [m] and direction forward, to port and up, and its limits [N]."""

    name: str
    place: tuple[float, float, float]
    direction: tuple[float, float, float]
    ahead: float
    astern: float
    turns: bool


class Lost(NamedTuple):
    """A part of the model without a parameter: its name, and its force (N,) at a recording."""

    name: str
    force: Array

    def __str__(self) -> str:
        return f"{self.name}: {np.sqrt(np.mean(self.force * self.force)):.3g}"


def parameter(plugin: HydrodynamicsPlugin, term: Term, axis: int) -> tuple[str, float] | None:
    """Name and factor of the parameter for a coefficient of a term in an axis; None: there is none.

    The factor is that from the force per term, as in the table, in axes forward, starboard, down.
    """
    signed = [code for code in term.codes if 0 < code < N_VARIABLES]
    sizes = [code - N_VARIABLES for code in term.codes if code >= N_VARIABLES]
    letter = DERIVATIVE_LETTERS[axis].lower()
    if signed and signed[0] in RATES and len(signed + sizes) == 1:
        axes, name = [RATES[signed[0]]], f"{letter}Dot{VELOCITIES[RATES[signed[0]]].upper()}"
    elif signed and len(signed + sizes) <= 2 and all(code in SPEEDS for code in signed + sizes):
        axes = [SPEEDS[code] for code in signed]
        own, other = (
            [VELOCITIES[SPEEDS[code]].upper() for code in codes] for codes in (signed, sizes)
        )
        between = "abs" if sizes and plugin.couples else ""
        name = f"{letter}{''.join(own)}{between}{''.join(other)}"
    else:
        return None
    alone = axes == [axis] and all(SPEEDS[code] == axis for code in sizes)
    if not (plugin.couples or alone):
        return None
    return name, plugin.sign * SIGNS[axis] * float(np.prod([SIGNS[k] for k in axes]))


def rigid_body(table: Vessel) -> tuple[float, Vessel]:
    """The mass [kg] of the rigid body, and its table with the inertia of the angles."""
    diagonal = dict(zip(table.dofs, np.diag(table.inertia), strict=True))
    mass = min((float(diagonal[dof]) for dof in table.dofs if dof in DOFS[:3]), default=1.0)
    own = np.diag([mass if dof in DOFS[:3] else diagonal[dof] for dof in table.dofs])
    return mass, from_derivatives("rigid body", table.dofs, own, {})


def parameters_of(
    target: str, vessel: VesselParameters, motion: Mapping[str, Array]
) -> tuple[dict[str, float], list[Lost]]:
    """The parameters of the plugin of a target, and what it does not have at a recorded motion."""
    plugin, table = PLUGINS[target], vessel.nominal()
    rest, x = table - rigid_body(table)[1], _variables(table, motion)
    known: dict[str, float] = {}
    lost = []
    for term, row, phi in zip(rest.terms, rest.theta, basis.evaluate(rest.terms, x).T, strict=True):
        for dof, value in zip(table.dofs, row, strict=True):
            axis = DOFS.index(dof)
            found = parameter(plugin, term, axis)
            if not value:
                continue
            if found is not None:
                known[found[0]] = known.get(found[0], 0.0) + found[1] * float(value)
            else:
                lost.append(Lost(f"{DERIVATIVE_LETTERS[axis]}_{term}", value * phi))
    return known, [*lost, *_lost_devices(vessel, x)]


def _variables(table: Vessel, motion: Mapping[str, Array]) -> Array:
    """The variables of a recorded motion."""
    n = len(motion["t"])

    def columns(names: tuple[str, ...]) -> Array:
        return np.column_stack([motion.get(name, np.zeros(n)) for name in names] or [np.zeros(n)])

    nu, rates = columns(table.velocities), columns(table.accelerations)
    inputs = columns(table.inputs) if table.inputs else None
    return table.variables(rates, nu, columns(POSES[3:]), None, inputs)


def _lost_devices(vessel: VesselParameters, x: Array) -> Iterator[Lost]:
    """The forces of devices that are no thrusters, and what the flow takes from those that are."""
    still = x.copy()
    still[:, [INDEX[name] for name in (*VELOCITIES, *basis.SPEED, basis.SIDESLIP)]] = 0.0
    before, devices = np.zeros((len(x), len(DOFS))), {}
    for name, device in vessel.devices.items():
        devices[name] = device
        after = device_forces(installed(devices), x)
        own, before = after - before, after
        what = name
        if isinstance(device, Thruster):
            own, what = own - device_forces(installed({name: device}), still), f"inflow of {name}"
        for axis, dof in enumerate(DOFS):
            if dof in vessel.dofs and np.any(own[:, axis]):
                yield Lost(f"{DERIVATIVE_LETTERS[axis]} of {what}", own[:, axis])


def thrusts(vessel: VesselParameters) -> Iterator[Thrust]:
    """The thrusters of a vessel."""
    for i, one in enumerate(vessel.thrusters.thrusters if vessel.thrusters else ()):
        (x, y, z), (a, b, c) = one.position_m, one.columns()[:3, 0]
        astern = one.ahead_n if one.astern_n is None else one.astern_n
        turns = one.kind == "azimuth"
        place, direction = (x, -y, -z), (float(a), -float(b), -float(c))
        yield Thrust(f"thruster_{i + 1}", place, direction, one.ahead_n, astern, turns)
    for name, device in vessel.devices.items():
        if isinstance(device, Thruster):
            limits = vessel.inputs[device.drive]
            driven = np.zeros((2, N_VARIABLES))
            driven[:, INDEX[device.drive]] = limits.high, min(limits.low, 0.0)
            ahead, astern = np.hypot(*device_forces(installed({name: device}), driven).T[:2])
            direction = float(np.cos(device.angle_rad)), -float(np.sin(device.angle_rad)), 0.0
            place = (device.x_m, -device.y_m, 0.0)
            yield Thrust(name, place, direction, float(ahead), float(astern), bool(device.alpha))


def sdf(model: StoredModel, target: str, name: str) -> str:
    """The model in SDF with the plugin of a target and the thrusters of its vessel."""
    vessel = model.parameters
    known, lost = parameters_of(target, vessel, model.motion())
    if target == "vrx":  # whose defaults are not zero
        known = dict.fromkeys(_of_each_axis(vessel.dofs), 0.0) | known
    mass, rigid = rigid_body(vessel.nominal())
    own = dict(zip(rigid.dofs, np.diag(rigid.inertia), strict=True))
    return equations_of(model).render(
        "model.sdf", name=name, target=target, plugin=PLUGINS[target], parameters=known, lost=lost,
        mass=mass, moments=[own.get(dof, mass) for dof in DOFS[3:]], thrusts=[*thrusts(vessel)],
    )  # fmt: skip


def _of_each_axis(dofs: Sequence[str]) -> Iterator[str]:
    """The parameters of VRX in degrees of freedom."""
    for axis in map(DOFS.index, dofs):
        letter, speed = DERIVATIVE_LETTERS[axis].lower(), VELOCITIES[axis].upper()
        yield from (f"{letter}Dot{speed}", f"{letter}{speed}", f"{letter}{speed}{speed}")
