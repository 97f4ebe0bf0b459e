"""The vessels of conf/vessel: other programs' accelerations, printed equations, and laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from docs.vessels import parameters_of
from seatrial.models.identification.physical_constraints import dissipated
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from tests.models.vessel.oracles import close, columns, constants, oracle
from tests.trials import FORCED, STEERED

motions = arrays(np.float64, 3, elements=st.floats(-2.0, 2.0))
# A fraction of random motions at which the damping creates energy: none, but for CyberShip II,
# whose identified Y_r couples more than Y_v and N_r dissipate at low speed.
CREATES = {"cybership2": 0.01}


@pytest.mark.data
def test_the_supply_vessel_has_the_accelerations_of_mss() -> None:
    table = oracle("mss_supply_xdot.csv")
    tau, nu = columns(table, "tau_X", "tau_Y", "tau_N"), columns(table, "u", "v", "r")
    found = parameters_of("supply_fossen").nominal().forward(tau, nu)
    close(found, columns(table, "udot", "vdot", "rdot"), 1e-12)


def propelled(name: str) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """States of a ship of PythonVehicleSimulator, its arrays, and the force B |n| n [N, Nm]."""
    table = oracle(f"pvs_{name}_nudot.csv")
    held = constants(f"pvs_{name}_params.json")
    ship = {key: np.array(held[key]) for key in ("B", "n_max", *{"M", "D"} & set(held))}
    speeds = columns(table, *(f"n{i}" for i in range(1, 7)))
    n = np.clip(speeds, -ship["n_max"], ship["n_max"])
    return table, ship, np.abs(n) * n @ ship["B"].T


def largest_forces(ship: dict[str, Array]) -> list[float]:
    """All propellers in surge and sway, the four tunnel thrusters in yaw [N, N, Nm]."""
    forces = np.abs(ship["B"]) * ship["n_max"] ** 2
    return [float(np.sum(forces[0])), float(np.sum(forces[1])), float(np.sum(forces[2, :4]))]


@pytest.mark.data
def test_the_supply_vessel_has_the_accelerations_of_python_vehicle_simulator() -> None:
    table, ship, tau = propelled("supply")
    vessel = parameters_of("supply_fossen")
    found = vessel.nominal().forward(tau, columns(table, "u", "v", "r"))
    close(found, columns(table, "udot", "vdot", "rdot"), 1e-12)
    np.testing.assert_allclose(vessel.force_limits or (), largest_forces(ship), rtol=1e-3)


@pytest.mark.data
def test_the_semisubmersible_has_the_accelerations_of_python_vehicle_simulator() -> None:
    """There it heaves, rolls and pitches too, which acts on the plane by these rows of M and D."""
    table, ship, tau = propelled("semisub")
    plane, held = [0, 1, 5], [2, 3, 4]
    other = columns(table, "w", "p", "q"), columns(table, "wdot", "pdot", "qdot")
    for matrix, motion in zip((ship["D"], ship["M"]), other, strict=True):
        tau = tau - motion @ matrix[np.ix_(plane, held)].T
    vessel = parameters_of("semisub")
    found = vessel.nominal().forward(tau, columns(table, "u", "v", "r"))
    close(found, columns(table, "udot", "vdot", "rdot"), 1e-12)
    np.testing.assert_allclose(vessel.force_limits or (), largest_forces(ship), rtol=1e-3)


@given(motions, motions)
def test_cybership_is_the_printed_model(nu: Array, nu_dot: Array) -> None:
    """M nu_dot + C(nu) nu + D(nu) nu, Skjetne et al. (2004), with the numbers of its tables."""
    u, v, r = nu
    m, x_g, I_z, X_udot, Y_vdot, N_rdot = 23.8, 0.046, 1.760, -2.0, -10.0, -1.0
    M = np.array([[m - X_udot, 0.0, 0.0], [0.0, m - Y_vdot, m * x_g], [0.0, m * x_g, I_z - N_rdot]])
    c_13 = -m * (x_g * r + v) + Y_vdot * v
    c_23 = (m - X_udot) * u
    C = np.array([[0.0, 0.0, c_13], [0.0, 0.0, c_23], [-c_13, -c_23, 0.0]])
    d_11 = 0.72253 + 1.32742 * abs(u) + 5.86643 * u**2
    d_22 = 0.88965 + 36.47287 * abs(v) + 0.805 * abs(r)
    d_23 = 7.250 + 0.845 * abs(v) + 3.450 * abs(r)
    d_32 = -0.03130 - 3.95645 * abs(v) - 0.130 * abs(r)
    d_33 = 1.900 - 0.080 * abs(v) + 0.750 * abs(r)
    D = np.array([[d_11, 0.0, 0.0], [0.0, d_22, d_23], [0.0, d_32, d_33]])
    force = parameters_of("cybership2").nominal().inverse(nu_dot[None], nu[None])[0]
    np.testing.assert_allclose(force, M @ nu_dot + C @ nu + D @ nu, rtol=1e-12, atol=1e-12)


# Motions for which coefficients of manoeuvring are measured: drift angle [rad], r' = r L / U, and
# the other rates, as p L / U; from half of the speed of the approach up to that speed.
DRIFT, TURN, OTHER = 0.35, 0.8, 0.1
# Published tables about the speed of the approach that include the engine: its force is the one of
# the straight motion. The fraction of motions at which the rest of the table creates energy: none
# at four fifths of the speed, some at the half, where its derivatives in u are no longer small.
DRIVEN = {"mariner": 0.072, "ship_clarke83": 0.0}


def inertia_is_positive(model: Vessel) -> bool:
    return float(np.min(np.linalg.eigvalsh(model.inertia + model.inertia.T))) > 0.0


@pytest.mark.parametrize("name", FORCED)
def test_kinetic_energy_is_positive_and_damping_takes_it_away(name: str) -> None:
    """x' M x > 0, and nu' d(nu) >= 0 within the attainable speeds."""
    vessel = parameters_of(name)
    model = vessel.nominal()
    assert inertia_is_positive(model)
    nu = np.random.default_rng(0).uniform(-1.0, 1.0, (5000, len(model.dofs)))
    power = dissipated(model, nu * vessel.scales.speeds)
    share = float(np.mean(power < 0.0))
    assert share <= CREATES.get(name, 0.0)
    assert (share > 0.0) == (name in CREATES)


def manoeuvres(name: str, slowest: float) -> Array:
    """Random motions of a steered vessel, from a fraction of the speed of its approach."""
    vessel, rng = parameters_of(name), np.random.default_rng(0)
    nu = np.zeros((5000, len(vessel.dofs)))
    speed = vessel.approach_speed_m_s * rng.uniform(slowest, 1.0, len(nu))
    drift, rate = rng.uniform(-DRIFT, DRIFT, len(nu)), speed / vessel.scales.length_m
    for i, dof in enumerate(vessel.dofs):
        turn = TURN if dof == "yaw" else OTHER
        nu[:, i] = turn * rng.uniform(-1.0, 1.0, len(nu)) * (speed if dof == "heave" else rate)
    for dof, part in (("surge", np.cos(drift)), ("sway", -np.sin(drift))):
        if dof in vessel.dofs:
            nu[:, vessel.dofs.index(dof)] = speed * part
    return nu


def taken(name: str, nu: Array) -> Array:
    """Power [W] that the water takes with helm amidships and engine off: -d/dt (nu' M nu / 2)."""
    model, still = parameters_of(name).nominal(), np.zeros_like(nu)
    inputs = np.zeros((len(nu), len(model.inputs)))
    force = model.inverse(still, nu, inputs=inputs)
    if name in DRIVEN:
        straight = np.where([dof == "surge" for dof in model.dofs], nu, 0.0)
        force = force - model.inverse(still, straight, inputs=inputs)
    return np.asarray(np.sum(nu * force, axis=1))


@pytest.mark.parametrize("name", STEERED)
def test_the_water_takes_energy_from_a_manoeuvring_vessel(name: str) -> None:
    """x' M x > 0, and -nu' M nu_dot >= 0 at the motions that a steered vessel makes."""
    assert inertia_is_positive(parameters_of(name).nominal())
    assert np.all(taken(name, manoeuvres(name, 0.8)) >= 0.0)
    share = float(np.mean(taken(name, manoeuvres(name, 0.5)) < 0.0))
    assert share <= DRIVEN.get(name, 0.0)
    assert (share > 0.0) == (DRIVEN.get(name, 0.0) > 0.0)
