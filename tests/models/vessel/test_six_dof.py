"""Vessels in six degrees of freedom against MSS: the Otter and `osv`.

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
from seatrial.models.vessel.devices.cross_flow import CrossFlow
from seatrial.models.vessel.devices.device import Device
from seatrial.models.vessel.kinematics import cross_matrix
from seatrial.models.vessel.parameters import VesselParameters
from tests.models.vessel.oracles import VELOCITIES, close, columns, constants, oracle, through_water

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
