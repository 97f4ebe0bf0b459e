"""Six degrees of freedom against the equations of Hoyer (2021), chapter 2, and laws."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import RigidBody, coriolis, from_derivatives
from seatrial.models.vessel.kinematics import (
    angle_rate,
    angles_of_frame,
    cross_matrix,
    frame_of_angles,
    frame_of_quaternion,
    quaternion_of,
    quaternion_rate,
)
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.disturbance import ConstantForce
from tests.models.control.sailing import drift, weather
from tests.trials import composed

angles = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))
motions = arrays(np.float64, 6, elements=st.floats(-2.0, 2.0))
STILL = np.zeros(6)


@cache
def beluga(kind: str) -> Any:
    return composed(f"vessel=beluga_{kind}", "excitation=waypoints").vessel


def let_go(
    vessel: Vessel, seconds: float, pose: Array, nu: Array = STILL, *, force: Array = STILL,
    attitude: Any = "quaternion", **options: Any,
) -> Voyage:  # fmt: skip
    """A vessel let go at a pose with a velocity, under a force that is constant in NED."""
    n = round(seconds / 0.1)
    met = weather(n, 6, force_ned=np.tile(force, (n, 1)))
    return drift(replace(vessel, attitude=attitude), met, start=pose, start_nu=nu, **options)


def frame(attitude: Array) -> Array:
    found = np.empty((3, 3))
    frame_of_angles(attitude, found)
    return found


@given(angles)
def test_frames_equal_those_of_scipy(attitude: Array) -> None:
    expected = Rotation.from_euler("ZYX", attitude[::-1]).as_matrix()
    np.testing.assert_allclose(frame(attitude), expected, atol=1e-12)
    found = np.empty((3, 3))
    frame_of_quaternion(quaternion_of(attitude), found)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@given(angles)
def test_angles_are_read_back_as_the_nearest_turns(attitude: Array) -> None:
    read = attitude + 0.3
    angles_of_frame(frame(attitude), read)
    np.testing.assert_allclose(frame(read), frame(attitude), atol=1e-9)
    if abs(attitude[1]) < 1.5:
        np.testing.assert_allclose(read, attitude, atol=1e-6)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_angles_of_a_vehicle_on_end_keep_the_roll(pitch: float) -> None:
    attitude = np.array([0.4, pitch, 1.1])
    read = np.array([0.4, 0.0, 0.0])
    angles_of_frame(frame(attitude), read)
    np.testing.assert_allclose(frame(read), frame(attitude), atol=1e-7)
    assert read[0] == pytest.approx(0.4, abs=1e-6)


@given(angles, arrays(np.float64, 3, elements=st.floats(-2.0, 2.0)))
def test_kinematics_are_the_derivative_of_the_rotation(attitude: Array, omega: Array) -> None:
    h = 1e-6
    turned = frame(attitude) @ Rotation.from_rotvec(h * omega).as_matrix()
    rate = np.empty(4)
    quaternion_rate(quaternion_of(attitude), *omega, rate)
    after = np.empty((3, 3))
    frame_of_quaternion(quaternion_of(attitude) + h * rate, after)
    np.testing.assert_allclose(after, turned, atol=1e-9)
    if abs(np.cos(attitude[1])) > 0.1:
        angle = np.empty(3)
        angle_rate(attitude, *omega, angle)
        np.testing.assert_allclose(frame(attitude + h * angle), turned, atol=1e-9)


@pytest.mark.parametrize(("kind", "count"), [("full", 108), ("diagonal", 18), ("linear", 12)])
def test_the_numbers_are_those_of_the_thesis(kind: str, count: int) -> None:
    assert len(beluga(kind).derivatives) == count
    inertia = beluga(kind).nominal().inertia
    np.testing.assert_allclose(inertia, inertia.T, atol=1e-12)
    assert inertia[0, 0] == pytest.approx(60.0)  # the surge models of the thesis


@given(motions)
def test_coriolis_is_skew_and_the_printed_one(nu: Array) -> None:
    """C_RB (2.10), and C_A (2.12) with the blocks of M_A where the thesis has minus them."""
    parameters = beluga("full")
    body = parameters.body
    v, omega = nu[:3], nu[3:]
    rigid = body.inertia()
    added = parameters.nominal().inertia - rigid
    m, S_r, S_w = body.mass_kg, cross_matrix(body.centre_of_gravity_m), cross_matrix(omega)
    inner = rigid[3:, 3:]
    C_rb = np.block([[m * S_w, -m * S_w @ S_r], [m * S_r @ S_w, -cross_matrix(inner @ omega)]])
    p1 = cross_matrix(added[:3, :3] @ v + added[:3, 3:] @ omega)
    p2 = cross_matrix(added[3:, :3] @ v + added[3:, 3:] @ omega)
    C_a = np.block([[np.zeros((3, 3)), -p1], [-p1, -p2]])
    for C in (C_rb, C_a):
        np.testing.assert_allclose(C, -C.T, atol=1e-12)
    table = coriolis(parameters.nominal().inertia, DOFS)
    found = table.inverse(np.zeros((1, 6)), nu[None])[0]
    np.testing.assert_allclose(found, (C_rb + C_a) @ nu, atol=1e-9)
    assert abs(nu @ found) < 1e-9


@given(angles)
def test_restoring_forces_are_the_printed_ones(attitude: Array) -> None:
    """Hoyer (2021), eq. (2.7)."""
    body = beluga("full").body
    R = frame(attitude)
    gravity = R.T @ np.array([0.0, 0.0, body.weight_n])
    buoyancy = -R.T @ np.array([0.0, 0.0, body.buoyancy_n])
    moment = np.cross(body.centre_of_buoyancy_m, buoyancy)
    moment = moment + np.cross(body.centre_of_gravity_m, gravity)
    printed = -np.concatenate([gravity + buoyancy, moment])
    found = body.restoring(DOFS).inverse(np.zeros((1, 6)), np.zeros((1, 6)), attitude[None])[0]
    np.testing.assert_allclose(found, printed, atol=1e-9)


def neutral() -> RigidBody:
    inertia = ((1.1, 0.0, 0.0), (0.0, 1.7, 0.0), (0.0, 0.0, 2.1))
    return RigidBody(25.36, inertia, (0.0, 0.0, 0.0), 248.0, 248.0, (0.0, 0.0, -0.05))


def hull(derivatives: dict[str, float]) -> Vessel:
    body = neutral()
    return from_derivatives("hull", DOFS, body.inertia(), derivatives) + body.restoring(DOFS)


def test_a_vehicle_that_is_too_heavy_sinks_at_its_terminal_speed() -> None:
    voyage = let_go(beluga("diagonal").nominal(), 120.0, STILL)
    w = voyage.log.nu[-1, 2]
    assert 35.0 * w + 6.0 * w**2 == pytest.approx(248.78 - 247.0, rel=1e-6)


@pytest.mark.parametrize("kind", ["full", "diagonal", "linear"])
@pytest.mark.parametrize("tip", [(1.0, 0.0), (0.0, 1.2), (2.5, -0.8)])
def test_a_tipped_vehicle_rights_itself(kind: str, tip: tuple[float, float]) -> None:
    pose = np.array([0.0, 0.0, 0.0, *tip, 0.3])
    voyage = let_go(beluga(kind).nominal(), 60.0, pose)
    np.testing.assert_allclose(voyage.log.eta[-1, 3:5], 0.0, atol=0.02)


def energy(vessel: Vessel, voyage: Voyage) -> Array:
    """Kinetic energy and that of the buoyancy that stands above the centre, of `neutral`."""
    kinetic = 0.5 * np.einsum("ki,ij,kj->k", voyage.log.nu, vessel.inertia, voyage.log.nu)
    phi, theta = voyage.log.eta[:, 3], voyage.log.eta[:, 4]
    return np.asarray(kinetic - 248.0 * 0.05 * np.cos(phi) * np.cos(theta))


@pytest.mark.parametrize("attitude", ["quaternion", "euler"])
def test_energy_is_kept_to_the_order_of_the_integrator(attitude: str) -> None:
    vessel = hull({"X_udot": -30.0, "Y_vdot": -50.0, "Z_wdot": -60.0, "K_pdot": -0.9})
    nu = np.array([0.4, -0.2, 0.1, 0.5, -0.4, 0.6])
    pose = np.array([0.0, 0.0, 0.0, 0.3, -0.4, 0.5])
    errors = {}
    for integrator, steps in (("rk4", (0.1, 0.05, 0.025)), ("euler", (0.05, 0.025, 0.0125))):
        kept = [
            energy(
                vessel,
                let_go(vessel, 8.0, pose, nu, step_s=h, attitude=attitude, integrator=integrator),
            )
            for h in steps
        ]
        errors[integrator] = [np.max(np.abs(e - e[0])) for e in kept]
    assert np.all(np.log2(np.divide(errors["rk4"][:-1], errors["rk4"][1:])) > 3.5)
    assert errors["rk4"][-1] < 1e-5
    assert np.all(np.log2(np.divide(errors["euler"][:-1], errors["euler"][1:])) > 0.8)


@pytest.mark.parametrize("kind", ["full", "linear"])
def test_both_kinematics_agree_away_from_the_singularity(kind: str) -> None:
    vessel = beluga(kind).nominal()
    nu = np.array([0.5, -0.2, 0.1, 0.8, 0.3, 0.6])
    pose = np.array([0.0, 0.0, 0.0, 0.3, -0.4, 3.0])
    force = np.array([10.0, -5.0, 3.0, 0.0, 0.0, 1.0])
    one = let_go(vessel, 30.0, pose, nu, force=force, step_s=0.0125)
    other = let_go(vessel, 30.0, pose, nu, force=force, step_s=0.0125, attitude="euler")
    np.testing.assert_allclose(one.log.eta, other.log.eta, atol=1e-7)
    np.testing.assert_allclose(one.log.nu, other.log.nu, atol=1e-7)


def test_quaternions_pass_through_ninety_degrees_of_pitch() -> None:
    """A free body that turns about its y axis loops; its angles are those of the rotation."""
    body = from_derivatives("body", DOFS, np.diag([25.0, 25.0, 25.0, 1.1, 1.7, 2.1]), {})
    voyage = let_go(body, 20.0, STILL, np.array([0.0, 0.0, 0.0, 0.0, 0.5, 0.0]))
    np.testing.assert_allclose(voyage.log.nu[:, 4], 0.5, atol=1e-12)
    for k in range(0, 200, 7):
        expected = Rotation.from_euler("Y", 0.5 * voyage.t[k]).as_matrix()
        np.testing.assert_allclose(frame(voyage.log.eta[k, 3:]), expected, atol=1e-6)
    assert 0.5 * voyage.t[-1] > 1.5 * np.pi


@given(angles)
def test_a_constant_force_is_a_table_at_every_attitude(attitude: Array) -> None:
    push = ConstantForce(20.0, -7.0, 3.0)
    R = frame(attitude)
    expected = np.concatenate([R.T @ [20.0, -7.0, 0.0], R.T @ [0.0, 0.0, 3.0]])
    found = push.table(DOFS).inverse(np.zeros((1, 6)), np.zeros((1, 6)), attitude[None])[0]
    np.testing.assert_allclose(found, -expected, atol=1e-12)


def test_the_log_equals_the_readable_equations() -> None:
    push = ConstantForce(20.0, -7.0, 3.0)
    vessel = beluga("full").nominal()
    pose, nu = np.array([0.0, 0, 0, 0.5, -0.4, 2.0]), np.array([0.5, 0.1, -0.2, 0.3, 0.4, -0.5])
    voyage = let_go(vessel, 20.0, pose, nu, force=push.ned(DOFS))
    log = voyage.log
    needed = (vessel + push.table(DOFS)).inverse(log.nu_dot, log.nu, log.eta[:, 3:])
    np.testing.assert_allclose(needed, 0.0, atol=1e-8)


def test_euler_steps_are_those_of_the_thesis() -> None:
    """y(t) = y(t - 1) + h y_dot(t - 1), eq. (6.2), with the quaternion normalised."""
    vessel = beluga("diagonal").nominal()
    pose, nu = np.array([0.0, 0, 0, 0.5, -0.4, 2.0]), np.array([0.5, 0.1, -0.2, 0.3, 0.4, -0.5])
    log = let_go(vessel, 3.0, pose, nu, step_s=0.1, integrator="euler").log
    q, at, speed = quaternion_of(pose[3:]), pose[:3], nu
    for k in range(29):
        R, rate, attitude = np.empty((3, 3)), np.empty(4), np.zeros(3)
        frame_of_quaternion(q, R)
        angles_of_frame(R, attitude)
        quaternion_rate(q, *speed[3:], rate)
        at = at + 0.1 * R @ speed[:3]
        speed = speed + 0.1 * vessel.forward(STILL[None], speed[None], attitude[None])[0]
        q = (q + 0.1 * rate) / np.linalg.norm(q + 0.1 * rate)
        np.testing.assert_allclose(log.eta[k + 1, :3], at, atol=1e-12)
        np.testing.assert_allclose(log.nu[k + 1], speed, atol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"mass_kg": 0.0}, {"weight_n": -1.0},
        {"inertia_kg_m2": ((1.0, 0.1, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))},
        {"inertia_kg_m2": ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))},
    ],
)  # fmt: skip
def test_impossible_bodies_are_refused(changes: dict[str, Any]) -> None:
    body = {name: getattr(neutral(), name) for name in RigidBody.__dataclass_fields__}
    with pytest.raises(ConfigurationError, match=next(iter(changes))):
        RigidBody(**(body | changes))
