"""Vessels in six degrees of freedom against MSS: the Otter, `osv` and the REMUS 100.

There, heave, roll and pitch have springs in the position, which are no part of a table: what they
give is the force from outside. The drag of cross flow is summed over 21 stations, of a hull longer
by a strip, and acts up and down on all three, as on a submerged hull.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.notation import DOFS
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import RigidBody
from seatrial.models.vessel.devices.cross_flow import CrossFlow
from seatrial.models.vessel.devices.device import Device, device_forces
from seatrial.models.vessel.devices.fin import Fin
from seatrial.models.vessel.devices.slender_body import SlenderBody
from seatrial.models.vessel.kinematics import cross_matrix
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.table import Vessel
from tests.models.vessel.oracles import (
    VELOCITIES,
    accelerations,
    close,
    columns,
    constants,
    oracle,
    stream,
    through_water,
)

configured: Callable[[str], VesselParameters] = cache(parameters_of)
PLANE, SPRUNG = [0, 1, 5], [2, 3, 4]


def in_six(
    planar: VesselParameters, inertia: Array, derivatives: dict[str, float], flow: CrossFlow
) -> VesselParameters:
    """A planar vessel that heaves, rolls and pitches as well."""
    flow = replace(flow, rule="ends", submerged=True)
    return replace(
        planar, dofs=DOFS, inertia=tuple(map(tuple, inertia.tolist())),
        derivatives={**planar.derivatives, **derivatives}, velocity_limits=None,
        devices={**planar.devices, "cross_flow": flow},
    )  # fmt: skip


def same_in_the_plane(whole: VesselParameters, planar: VesselParameters) -> None:
    """Inertia, Coriolis forces, damping and devices of a vessel are those of the plane."""
    six, plane = whole.nominal(), planar.nominal()
    np.testing.assert_allclose(six.on(plane.terms).theta[:, PLANE], plane.theta, rtol=1e-12)
    np.testing.assert_allclose(six.installed.parameters, plane.installed.parameters, rtol=1e-12)


def springs(stiffness: Array, rows: dict[str, Array]) -> Array:
    """Force (N, 6) [N, Nm] by heave, roll and pitch, of the stiffness (6, 6)."""
    position = np.zeros((len(rows["z"]), 6))
    position[:, SPRUNG] = columns(rows, "z", "phi", "theta")
    return -position @ stiffness.T


def otter_body(mass_kg: float, place: Array) -> tuple[float, Array, Array]:
    """Mass, centre of gravity (3,) and inertia about it (3, 3) with another payload."""
    hull = np.array([0.2, 0.0, -0.2])
    mass = 55.0 + mass_kg
    centre = (55.0 * hull + mass_kg * place) / mass
    about = np.diag(55.0 * np.array([0.432, 0.5, 0.5]) ** 2)
    for part, arm in ((55.0, hull - centre), (mass_kg, place - centre)):
        about -= part * cross_matrix(arm) @ cross_matrix(arm)
    return mass, centre, about


def otter_stiffness(mass: float, z_g: float) -> Array:
    """G (6, 6) about the centre of flotation, 0.2 m aft; K_B = 0.7 T with these pontoons."""
    held, draught = constants("mss_otter_coeffs.json"), mass / 410.0
    below = mass * 9.81 * (0.7 * draught - (draught - z_g))
    of_area = 1025.0 * 9.81 * np.array([held["I_T"], held["I_L"]])
    return np.diag([0.0, 0.0, held["G33"], *(of_area + below), 0.0])


def otter_with(mass_kg: float, *place_m: float) -> tuple[VesselParameters, Array]:
    """The Otter with another payload and its stiffness (6, 6) at the origin, as in MSS."""
    mass, centre, about = otter_body(mass_kg, np.array(place_m))
    surge = constants("mss_otter_coeffs.json")["MA"][0][0]
    added = np.array([surge, 82.5, 55.0, *np.array([0.2, 0.8, 1.7]) * np.diag(about)])
    lever = mass * cross_matrix(centre)
    turning = about - lever @ cross_matrix(centre)
    inertia = np.block([[mass * np.eye(3), -lever], [lever, turning]]) + np.diag(added)
    stiffness, draught = otter_stiffness(mass, centre[2]), mass / 410.0
    critical = 2.0 * np.sqrt(np.diag(stiffness) * np.diag(inertia))
    damping = {
        "Y_v": -inertia[1, 1], "N_r": -inertia[5, 5], "N_|r|r": -10.0 * inertia[5, 5],
        "Z_w": -0.3 * critical[2], "K_p": -0.2 * critical[3], "M_q": -0.4 * critical[4],
    }  # fmt: skip
    drag = float(np.interp(0.25 / (2.0 * draught), HOERNER[0], HOERNER[1]))
    moved = np.eye(6)
    moved[2, 4] = 0.2
    otter = in_six(configured("otter"), inertia, damping, CrossFlow(2.0, draught, drag))
    return otter, moved.T @ stiffness @ moved


# Drag coefficient of a section over B / 2 T, as read from Hoerner's curve by MSS
HOERNER = (
    [0.0108623, 0.176606, 0.353025, 0.451863, 0.472838, 0.492877, 0.493252, 0.558473, 0.646401,
     0.833589, 0.988002, 1.30807],
    [1.96608, 1.96573, 1.89756, 1.78718, 1.58374, 1.27862, 1.21082, 1.08356, 0.998631, 0.87959,
     0.828415, 0.759941],
)  # fmt: skip


def payload_weight(rows: dict[str, Array]) -> Array:
    """Heave force, roll and pitch moment (N, 6) of the payload; MSS leaves out the other three."""
    angles, place = columns(rows, "phi", "theta"), columns(rows, "rp_x", "rp_y", "rp_z")
    (s_phi, s_theta), (c_phi, c_theta) = np.sin(angles).T, np.cos(angles).T
    down = np.column_stack([-s_theta, c_theta * s_phi, c_theta * c_phi])
    force = 9.81 * rows["mp"][:, None] * down
    made = np.column_stack([force, np.cross(place, force)])
    made[:, PLANE] = 0.0
    return made


@pytest.mark.data
def test_the_otter_accelerates_as_in_mss() -> None:
    """With payloads of up to 45 kg anywhere, and in a current."""
    rows = oracle("mss_otter_xdot.csv")
    nu, nu_dot = through_water(rows)
    limits = configured("otter").inputs["n_1"]
    n = np.clip(columns(rows, "n1", "n2") / (2.0 * np.pi), limits.low, limits.high)
    payload, weight = columns(rows, "mp", "rp_x", "rp_y", "rp_z"), payload_weight(rows)
    found = np.empty_like(nu)
    for row in np.unique(payload, axis=0):
        at = np.all(payload == row, axis=1)
        otter, stiffness = otter_with(*row)
        tau = springs(stiffness, {name: column[at] for name, column in rows.items()})
        found[at] = otter.nominal().forward(tau + weight[at], nu[at], inputs=n[at])
    close(found, nu_dot, 1e-9)


@pytest.mark.data
def test_the_otter_of_the_configuration_is_that_of_mss() -> None:
    otter, stiffness = otter_with(25.0, 0.05, 0.0, -0.35)
    held = constants("mss_otter_coeffs.json")
    np.testing.assert_allclose(otter.nominal().inertia, held["M"], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(stiffness, held["G"], rtol=1e-12, atol=1e-9)
    same_in_the_plane(otter, configured("otter"))


def of_added_mass(added: Array, nu: Array, through: Array) -> Array:
    """C_A(nu) nu_r - C_A(nu_r) nu_r, (N, 6), by Kirchhoff's momenta of `nu`."""
    change = (nu - through) @ added
    linear = np.cross(through[:, 3:], change[:, :3])
    angular = np.cross(through[:, 3:], change[:, 3:]) + np.cross(through[:, :3], change[:, :3])
    return np.column_stack([linear, angular])


def drag_astern(u: Array, drag: Device) -> Array:
    """X [N] of MSS beside that of the drag of a vessel: its share astern is negative."""
    d_1, d_2, crossover = drag.values()
    share = np.where(u < 0.0, 2.0 * np.tanh(u / crossover), 0.0)
    return np.asarray(share * (d_1 - d_2 * np.abs(u)) * u)


def osv() -> VesselParameters:
    """The supply vessel with azimuths that heaves, rolls and pitches as well."""
    planar, held = configured("osv"), constants("mss_osv_coeffs.json")["vessel"]
    flow, damping = planar.devices["cross_flow"], np.diag(held["D"])
    assert isinstance(flow, CrossFlow)
    derivatives = {"Z_w": -damping[2], "K_p": -damping[3], "M_q": -damping[4]}
    return in_six(planar, np.array(held["M"]), derivatives, flow)


@pytest.mark.data
def test_the_supply_vessel_with_azimuths_accelerates_as_in_mss() -> None:
    """With the drag of cross flow as above, and but for two slips, both given as a force.

    The added mass has Coriolis forces of the velocity over ground; astern the share of the
    quadratic drag is negative.
    """
    rows, held = oracle("mss_osv_xdot.csv"), constants("mss_osv_coeffs.json")["vessel"]
    nu, nu_dot = through_water(rows)
    vessel = osv()
    n = columns(rows, "n1", "n2", "n3", "n4") / 60.0
    inputs = np.column_stack([n, rows["alpha1"], rows["alpha2"]])
    tau = springs(np.array(held["G"]), rows)
    tau -= of_added_mass(np.array(held["MA"]), columns(rows, *VELOCITIES), nu)
    tau[:, 0] += drag_astern(nu[:, 0], vessel.devices["drag"])
    close(vessel.nominal().forward(tau, nu, inputs=inputs), nu_dot, 1e-9)


@pytest.mark.data
def test_the_supply_vessel_of_the_configuration_is_that_of_mss() -> None:
    same_in_the_plane(osv(), configured("osv"))


# Drag coefficient of a long cylinder over its Reynolds number, as read from DNV-RP-C205 by MSS, and
# what remains of it at a length of 8.4 diameters, below and above a Reynolds number of 200 000
CYLINDER = (
    [15543.5423211490, 24434.8681540938, 35719.8807222993, 60880.7508493947, 86174.7436190610,
     118086.431856986, 149262.255516420, 214708.876786124, 230940.445891927, 271581.385758833,
     297098.185911873, 325252.018159382, 361942.848517458, 409798.156149477, 475302.392082697,
     524734.960427919, 578921.928291835, 638292.879987135, 744046.366191920, 853237.628592033],
    [1.20369, 1.20823, 1.21060, 1.21093, 1.20901, 1.21134, 1.21148, 1.21171, 1.20109, 1.16918,
     1.11163, 1.00926, 0.89411, 0.70855, 0.53155, 0.40785, 0.32683, 0.28422, 0.29711, 0.32280],
)  # fmt: skip
SLENDER = 1.6 / 0.19
LARGER, LIGHTER = 1.0096, 1025.0 / 1026.0
SHORT = np.interp(SLENDER, [5.0, 10.0], [0.62, 0.68]), np.interp(SLENDER, [5.0, 10.0], [0.8, 0.82])


def made_by(device: Device, nu: Array, inputs: Array) -> Array:
    """Forces (N, 6) of one device at velocities (N, 6) and its inputs (N, n)."""
    nothing = np.zeros((0, 6))
    one = Vessel("one", DOFS, (), nothing, inputs=device.inputs(), devices={"it": device})
    return device_forces(one.installed, one.variables(np.zeros_like(nu), nu, inputs=inputs))


def cylinder_drag(nu: Array) -> Array:
    """Drag of cross flow (N, 6) by the Reynolds number of v, w and the length."""
    reynolds = np.hypot(nu[:, 1], nu[:, 2]) * 1.6e6
    drag = np.interp(reynolds, *CYLINDER) * np.where(reynolds < 2e5, *SHORT)
    flow = CrossFlow(1.6, 0.19, 1.0, rule="ends", submerged=True)
    return np.asarray(drag[:, None] * made_by(flow, nu, np.zeros((len(nu), 0))))


def larger_body(body: RigidBody) -> RigidBody:
    """A spheroid larger by 0.96 %, of water of 1025 instead of 1026 kg/m^3, and its weight."""
    mass = body.mass_kg * LARGER**3 * LIGHTER
    arms = body.centre_of_gravity_m[2] ** 2 * np.array([1.0, 1.0, 0.0])
    about = (np.diag(body.inertia_kg_m2) - body.mass_kg * arms) * LARGER**5 * LIGHTER
    x, y, z = (about + mass * arms).tolist()
    weight = mass * constants("mss_remus100_coeffs.json")["g_mu"]
    return replace(
        body, mass_kg=mass, inertia_kg_m2=((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z)),
        weight_n=weight, buoyancy_n=weight,
    )  # fmt: skip


def larger_derivatives(of: dict[str, float], body: RigidBody) -> tuple[dict[str, float], Array]:
    """Derivatives of the larger spheroid, and the diagonal of its inertia (6,)."""
    angular = {"K_pdot", "M_qdot", "N_rdot"}
    changed = {key: v * LARGER ** (5 if key in angular else 3) for key, v in of.items()}
    added = [changed[key] for key in ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")]
    inertia = np.diag(body.inertia()) - np.array(added)
    righting = 2.0 * np.sqrt(body.weight_n * body.centre_of_gravity_m[2] * inertia)
    changed |= {"Y_v": -inertia[1] / 20.0, "Z_w": -inertia[2] / 20.0, "N_r": -inertia[5]}
    return changed | {"K_p": -0.3 * righting[3], "M_q": -0.8 * righting[4]}, inertia


def remus() -> VesselParameters:
    """The REMUS 100 of MSS without cross flow, from that of PythonVehicleSimulator."""
    older = configured("remus100")
    assert older.body is not None
    body = larger_body(older.body)
    derivatives, inertia = larger_derivatives(older.derivatives, body)
    devices = dict(older.devices)
    del devices["cross_flow"]
    hull = devices["body"]
    assert isinstance(hull, SlenderBody)
    devices["body"] = replace(
        hull, drag_0=hull.drag_0 * LARGER**2, d_u=inertia[0] / 20.0, d_v=0.0, oswald=0.3
    )
    for name in ("rudder", "planes"):
        fin = devices[name]
        assert isinstance(fin, Fin)
        devices[name] = replace(fin, x_m=LARGER * fin.x_m)
    limits = {
        name: replace(each, low=np.radians(-20.0), high=np.radians(20.0)) if name != "n" else each
        for name, each in older.inputs.items()
    }
    return replace(older, body=body, derivatives=derivatives, devices=devices, inputs=limits)


def over_ground(vessel: VesselParameters, ground: Array, nu: Array, inputs: Array) -> Array:
    """Force (N, 6) of MSS beside that of `vessel`, by the speeds over ground that it takes."""
    screw, hull = vessel.devices["propeller"], vessel.devices["body"]
    assert isinstance(hull, SlenderBody)
    n = inputs[:, 2:]
    beside = made_by(screw, ground, n) - made_by(screw, nu, n)
    slip = np.exp(-hull.fading * np.sqrt(ground[:, 0] + ground[:, 1] ** 2))
    own = np.exp(-hull.fading * np.linalg.norm(nu[:, :3], axis=1))
    beside[:, 0] -= hull.d_u * (slip - own) * nu[:, 0]
    return beside


@pytest.mark.data
def test_the_remus_accelerates_as_in_mss() -> None:
    """It is of a later generation than in PythonVehicleSimulator. Table and devices are changed:

    - both semi-axes are 0.96 % larger, so the mass is 31.9 kg, and the fins are at the stern end
    - gravity is that of Trondheim
    - the fins turn by up to 20 degrees
    - the induced drag is that of an Oswald factor of 0.3 instead of 0.7
    - the linear drag of sway does not fade with the speed

    What no device has is given as a force, and so is what the speeds over ground do:

    - the drag of cross flow is that of a cylinder, whose coefficient varies with the speed across
    - slip: its Reynolds number has the length of the vehicle in place of the diameter
    - slip: the rigid body and the cross flow are in water of 1025 kg/m^3, all else of 1026
    - slip: the inflow of the propeller is that of the speed over ground
    - slip: the linear drag of surge fades with the speed over ground, and that with u for u^2
    - slip: a current that the vehicle meets in a turn changes by the yaw rate alone
    """
    rows, vessel = oracle("mss_remus100_xdot.csv"), remus()
    ground, water, nu_dot = columns(rows, *VELOCITIES), stream(rows), accelerations(rows)
    nu = ground.copy()
    nu[:, :3] -= water
    nu_dot[:, 0] -= ground[:, 5] * water[:, 1]
    nu_dot[:, 1] += ground[:, 5] * water[:, 0]
    limits = vessel.inputs.values()
    inputs = columns(rows, "delta_r", "delta_s", "n") / np.array([1.0, 1.0, 60.0])
    inputs = np.clip(inputs, [each.low for each in limits], [each.high for each in limits])
    tau = cylinder_drag(nu) + over_ground(vessel, ground, nu, inputs)
    attitude = columns(rows, "phi", "theta", "psi")
    close(vessel.nominal().forward(tau, nu, attitude, inputs=inputs), nu_dot, 1e-9)


@pytest.mark.data
def test_the_inertia_of_the_remus_is_that_of_mss() -> None:
    held = constants("mss_remus100_coeffs.json")["M"]
    np.testing.assert_allclose(remus().nominal().inertia, held, rtol=1e-12, atol=1e-12)
