"""Vessels with several thrusters or fins, and the devices they have, by laws and recordings."""

from collections.abc import Callable
from csv import DictReader
from dataclasses import replace
from datetime import datetime
from functools import cache

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.notation import DOFS
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.azimuth import Thruster
from seatrial.models.vessel.devices.cross_flow import CrossFlow
from seatrial.models.vessel.devices.device import Device, device_forces
from seatrial.models.vessel.devices.fin import Fin
from seatrial.models.vessel.devices.propeller import Propeller
from seatrial.models.vessel.devices.surge_drag import SurgeDrag
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.steering import steady_speed
from seatrial.models.vessel.table import Vessel
from tests.models.vessel.oracles import (
    VELOCITIES,
    accelerations,
    close,
    columns,
    oracle,
    oracle_file,
)

configured: Callable[[str], VesselParameters] = cache(parameters_of)
PLANE = [0, 1, 5]


def forces(device: Device, nu: Array, inputs: Array) -> Array:
    """Forces (N, 6) of one device at velocities (N, 3) in the plane and inputs (N, n)."""
    dofs = tuple(DOFS[i] for i in PLANE)
    vessel = Vessel(
        "one", dofs, (), np.zeros((0, 3)), inputs=device.inputs(), devices={"it": device}
    )
    return device_forces(vessel.installed, vessel.variables(np.zeros_like(nu), nu, inputs=inputs))


def test_strips_converge_to_the_integrals_of_cross_flow() -> None:
    """Sway alone: 1/2 rho C_D H L v^2; yaw alone: 1/2 rho C_D H L^4 / 32 r^2."""
    device = CrossFlow(2.0, 0.2, 1.1, 1000.0, strips=400)
    made = forces(device, np.array([[0.0, -0.7, 0.0], [0.0, 0.0, 0.5]]), np.zeros((2, 0)))
    scale = 0.5 * 1000.0 * 1.1 * 0.2
    assert made[0, 1] == pytest.approx(scale * 2.0 * 0.7**2)
    assert made[1, 5] == pytest.approx(-scale * 2.0**4 / 32.0 * 0.5**2, rel=1e-4)
    assert abs(made[0, 5]) + abs(made[1, 1]) < 1e-12


def test_cross_flow_takes_energy_from_any_motion() -> None:
    nu = np.random.default_rng(0).normal(size=(500, 3))
    made = forces(CrossFlow(2.0, 0.2, 1.1), nu, np.zeros((500, 0)))
    assert np.all(np.sum(made[:, PLANE] * nu, axis=1) < 0.0)


def test_a_submerged_hull_has_the_same_drag_up_and_down_as_sideways() -> None:
    """The bow goes to starboard with r > 0, and up with q > 0."""
    device = CrossFlow(1.6, 0.2, 1.1, submerged=True)
    vessel = Vessel("one", DOFS, (), np.zeros((0, 6)), devices={"it": device})
    nu = np.zeros((2, 6))
    nu[0, [1, 5]] = nu[1, [2, 4]] = 0.4, 0.7
    nu[1, 4] *= -1.0
    made = device_forces(vessel.installed, vessel.variables(np.zeros_like(nu), nu))
    assert made[1, 2] == pytest.approx(made[0, 1])
    assert made[1, 4] == pytest.approx(-made[0, 5])
    assert made[0, 2] == made[0, 4] == made[1, 1] == made[1, 5] == 0.0


def test_a_turned_azimuth_has_the_thrust_of_a_fixed_thruster_in_its_direction() -> None:
    """Its arm is the cross product; a tunnel thruster is an azimuth at right angles."""
    azimuth = Thruster("n_1", 50.0, 1.8, -0.4, alpha="alpha_1", advance=3.0, crossing=0.1)
    nu, angles = np.random.default_rng(0).normal(size=(20, 3)), np.linspace(-3.0, 3.0, 20)
    for k, angle in enumerate(angles):
        one = nu[k : k + 1]
        made = forces(azimuth, one, np.array([[4.0, angle]]))
        fixed = replace(azimuth, alpha=None, angle_rad=float(angle))
        np.testing.assert_allclose(made, forces(fixed, one, np.array([[4.0]])), atol=1e-12)
        thrust = np.cos(angle) * made[0, 0] + np.sin(angle) * made[0, 1]
        across = np.cos(angle) * made[0, 1] - np.sin(angle) * made[0, 0]
        assert across == pytest.approx(0.0, abs=1e-9 * abs(thrust))
        assert made[0, 5] == pytest.approx(1.8 * made[0, 1] + 0.4 * made[0, 0])


def test_thrust_falls_with_the_inflow_and_in_a_flow_across() -> None:
    """T = k n^2 - a n V_a; a tunnel thruster loses exp(-c u^2) in a vessel that moves ahead."""
    speeds = np.column_stack([np.linspace(0.0, 2.0, 5), np.zeros(5), np.zeros(5)])
    n = np.full((5, 1), 3.0)
    ahead = forces(Thruster("n_1", 10.0, 0.0, 0.0, advance=4.0), speeds, n)[:, 0]
    np.testing.assert_allclose(ahead, 90.0 - 12.0 * speeds[:, 0])
    tunnel = Thruster("n_1", 10.0, 2.0, 0.0, angle_rad=np.pi / 2.0, crossing=0.3)
    across = forces(tunnel, speeds, n)
    np.testing.assert_allclose(across[:, 1], 90.0 * np.exp(-0.3 * speeds[:, 0] ** 2))
    np.testing.assert_allclose(across[:, 5], 2.0 * across[:, 1])


@pytest.mark.parametrize(("v", "r", "c_2"), [(-0.3, 0.1, 1.6), (0.4, 0.02, 1.1), (0.0, -0.2, 1.1)])
def test_the_wake_of_yasukawa_depends_on_the_side_of_the_drift(
    v: float, r: float, c_2: float
) -> None:
    """(1 - w_P) / (1 - w_P0) = 1 + (1 - exp(-C_1 |beta_P|)) (C_2 - 1), beta_P = beta - x_P' r'."""
    screw = Propeller(
        0.2, 0.3, -0.28, -0.14, 0.4, 0.2, 7.0, C_1=2.0, C_2_plus=1.6, C_2_minus=1.1, wake="yasukawa"
    )
    u, n = 1.2, np.array([[10.0]])
    beta = np.arctan2(-v, u) + 0.5 * r * 7.0 / np.hypot(u, v)
    flow = (1.0 - 0.4) * (1.0 + (1.0 - np.exp(-2.0 * abs(beta))) * (c_2 - 1.0))
    same = replace(screw, wake="exponential", C_1=0.0, w_P0=1.0 - flow)
    nu = np.array([[u, v, r]])
    np.testing.assert_allclose(forces(screw, nu, n), forces(same, nu, n), rtol=1e-12)


def test_a_pwm_signal_has_a_dead_band_and_its_limits() -> None:
    """No thrust within the band, the stated thrusts at both ends, monotonic between."""
    device = Thruster("pwm_1", 55.0, 0.0, -0.285, 27.5, dead_band=0.06, curvature=0.4)
    signal = np.linspace(-1.0, 1.0, 201)[:, None]
    thrust = forces(device, np.zeros((201, 3)), signal)[:, 0]
    assert thrust[0] == pytest.approx(-27.5)
    assert thrust[-1] == pytest.approx(55.0)
    within = np.abs(signal[:, 0]) <= 0.06
    assert np.all(thrust[within] == 0.0)
    assert np.all(np.diff(thrust)[~within[1:] & ~within[:-1]] > 0.0)


def test_four_azimuths_turn_the_ferry_on_the_spot_and_push_it_aside() -> None:
    """Along the circle about the centre: yaw alone; all to starboard: sway alone."""
    ferry = configured("milliampere_azimuths").nominal()
    places = [(1.8, 0.8), (1.8, -0.8), (-1.8, -0.8), (-1.8, 0.8)]
    around, aside = [np.arctan2(x, -y) for x, y in places], [np.pi / 2.0] * 4
    inputs, still = np.array([[0.5] * 4 + around, [0.5] * 4 + aside]), np.zeros((2, 3))
    made = device_forces(ferry.installed, ferry.variables(still, still, inputs=inputs))[:, PLANE]
    moment = 4.0 * 130.0 * np.hypot(1.8, 0.8)
    np.testing.assert_allclose(made, [[0.0, 0.0, moment], [0.0, 520.0, 0.0]], atol=1e-9)


def test_the_ferry_of_2025_has_the_hull_of_the_ferry() -> None:
    ferry, azimuths = configured("milliampere"), configured("milliampere_azimuths")
    assert azimuths.derivatives == ferry.derivatives
    assert azimuths.inertia == ferry.inertia


def recorded(name: str, run: str, *columns_of: str) -> tuple[Array, Array]:
    """Times [s] and columns of one topic of the ferry's recordings."""
    folder = oracle_file("").parent / "milliampere" / run
    with (folder / name).open(newline="") as stream:
        rows = [
            (row["time"], *(row[column] for column in columns_of)) for row in DictReader(stream)
        ]
    times = [datetime.strptime(row[0][:26], "%Y/%m/%d %H:%M:%S.%f").timestamp() for row in rows]
    return np.array(times), np.array([row[1:] for row in rows], dtype=np.float64)


@pytest.mark.data
def test_four_azimuths_give_the_force_that_the_ferry_reports() -> None:
    """From throttles and azimuths in a field run: at least 93 % of the variance of each axis."""
    ferry = configured("milliampere_azimuths").nominal()
    force = ("wrench_force_x", "wrench_force_y", "wrench_torque_z")
    t, reported = recorded("tau_actual.csv", "nlp1", *force)
    inputs = np.empty((len(t), 8))
    for i in range(4):
        command = "throttle_reference", "angle_reference"
        at, rows = recorded(f"actuator_ref_{i + 1}.csv", "nlp1", *command)
        held = rows[np.clip(np.searchsorted(at, t), 0, len(at) - 1)]
        inputs[:, i], inputs[:, 4 + i] = held[:, 0] / 1000.0, np.radians(held[:, 1])
    still = np.zeros((len(t), 3))
    made = device_forces(ferry.installed, ferry.variables(still, still, inputs=inputs))[:, PLANE]
    explained = 1.0 - np.var(reported - made, axis=0) / np.var(reported, axis=0)
    assert np.all(explained > 0.93)


def test_the_blueboat_reaches_its_recorded_speed() -> None:
    """Within 15 % at the 55 N per thruster of the recordings, where it made 3.4 m/s at the most."""
    boat = configured("blueboat")
    speed = steady_speed(boat.nominal(), np.array([1.0, 1.0]), 10.0)
    assert speed == pytest.approx(3.42, rel=0.15)
    turned = boat.nominal().forward(
        np.zeros((1, 3)), np.zeros((1, 3)), inputs=np.array([[0.5, 0.0]])
    )
    assert turned[0, 2] > 0.0  # the left one alone turns it to starboard


def test_drag_ahead_is_linear_at_first_and_quadratic_in_the_end() -> None:
    """And as large astern as ahead."""
    speeds = np.array([1e-4, 20.0, -1e-4, -20.0])
    nu = np.column_stack([speeds, np.zeros((4, 2))])
    made = forces(SurgeDrag(5.0, 3.0, 2.0), nu, np.zeros((4, 0)))[:, 0]
    np.testing.assert_allclose(made[:2], [-5e-4, -1200.0], rtol=1e-3)
    np.testing.assert_allclose(made[2:], -made[:2])


@pytest.mark.data
def test_the_remus_accelerates_as_in_python_vehicle_simulator() -> None:
    """All six degrees of freedom, at its limits of the inputs.

    There the drag of cross flow is summed over 21 stations, of a hull longer by a strip.
    """
    rows, remus = oracle("pvs_remus100_nudot.csv"), configured("remus100")
    flow = remus.devices["cross_flow"]
    assert isinstance(flow, CrossFlow)
    devices = {**remus.devices, "cross_flow": replace(flow, rule="ends")}
    vessel = replace(remus, devices=devices).nominal()
    inputs = columns(rows, "delta_r", "delta_s", "n") / np.array([1.0, 1.0, 60.0])
    limits = remus.inputs.values()
    inputs = np.clip(inputs, [each.low for each in limits], [each.high for each in limits])
    nu, attitude = columns(rows, *VELOCITIES), columns(rows, "phi", "theta", "psi")
    found = vessel.forward(np.zeros_like(nu), nu, attitude, inputs=inputs)
    close(found, accelerations(rows), 1e-9)


def test_the_remus_makes_its_published_speed() -> None:
    """2.5 m/s at 1525 rpm."""
    speed = steady_speed(configured("remus100").nominal(), np.array([0.0, 0.0, 1525 / 60]), 10.0)
    assert speed == pytest.approx(2.5, rel=0.1)


def test_fins_turn_to_their_side() -> None:
    """Aft, delta > 0 turns to starboard, and bow down; ahead of the origin to the other side."""
    nu = np.array([[2.0, 0.0, 0.0]])
    turns = []
    for x in (-0.8, 0.8):
        rudder = forces(Fin("delta_r", "rudder", 0.01, 0.5, x), nu, np.array([[0.1]]))[0]
        plane = forces(Fin("delta_s", "plane", 0.01, 0.5, x), nu, np.array([[0.1]]))[0]
        assert rudder[0] < 0.0
        assert plane[0] < 0.0
        turns.append((rudder[5] > 0.0, plane[4] < 0.0))
    assert turns == [(True, True), (False, False)]
