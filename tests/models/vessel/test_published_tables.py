"""Steered vessels that are tables alone, against MSS and PythonVehicleSimulator.

The tables of these programs (`shared/data/oracles`) have 300 random states each.
"""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.derivatives import derivative_table
from seatrial.models.vessel.table import Vessel
from tests.models.vessel.oracles import close, columns, oracle, oracle_file

HULL = ("Y", "sway"), ("N", "yaw")
DRAUGHT = 18.46  # of the tanker [m]


@cache
def tanker_in(depth: str) -> Vessel:
    """The tanker's table in deep or shallow water."""
    return replace(parameters_of("tanker"), parameters=depth).nominal()


def tanker_accelerations(
    rows: dict[str, Array], depth_m: Array, revolutions: str, over: bool = False
) -> Array:
    """From its tables for z = T / (h - T) = 0 and 1, by X_vvzz z^2 and Y_uvz = -0.85 (z - 0.8);
    `over`: with v / u for the drift angle atan(v / u)."""
    deep, shallow = tanker_in("deep"), tanker_in("shallow").on(tanker_in("deep").terms)
    inputs = np.column_stack([rows["delta"], rows[revolutions] / 60.0])
    nu = columns(rows, "u", "v", "r")
    x = deep.variables(np.zeros_like(nu), nu, inputs=inputs)
    if over:
        x[:, INDEX["beta"]] = nu[:, 1] / nu[:, 0]
    phi, found = basis.evaluate(deep.terms, x), np.empty_like(nu)
    for k, z in enumerate(DRAUGHT / (depth_m - DRAUGHT)):
        shares = np.full(deep.theta.shape, z)
        shares[deep.terms.index(basis.term("v^2")), 0] = z**2
        shares[deep.terms.index(basis.term("uv")), 1] = max(z - 0.8, 0.0) / 0.2
        theta = deep.theta + shares * (shallow.theta - deep.theta)
        found[k] = np.linalg.solve(replace(deep, theta=theta).inertia, -phi[k] @ theta)
    return found


@pytest.mark.data
def test_the_tanker_accelerates_as_in_mss() -> None:
    rows = oracle("mss_tanker_xdot.csv")
    expected = columns(rows, "udot", "vdot", "rdot")
    close(tanker_accelerations(rows, rows["h"], "n"), expected, 1e-12)


@pytest.mark.data
def test_the_tanker_accelerates_as_in_python_vehicle_simulator() -> None:
    """But for the drift angle, there v / u and here, as in MSS, atan(v / u)."""
    rows = oracle("pvs_tanker_nudot.csv")
    expected = columns(rows, "udot", "vdot", "rdot")
    close(tanker_accelerations(rows, rows["depth"], "rpm", over=True), expected, 1e-12)
    record = json.loads(oracle_file("mss_vs_pvs_nudot_differences.json").read_text())
    apart = record["result"]["tanker [udot vdot rdot]"]["rel_rms"]
    rows = oracle("mss_tanker_xdot.csv")
    own, theirs = (tanker_accelerations(rows, rows["h"], "n", over) for over in (False, True))
    rms = np.sqrt(np.mean((own - theirs) ** 2, axis=0) / np.mean(own**2, axis=0))
    np.testing.assert_allclose(rms, apart, rtol=1e-9)


def test_shallow_water_slows_the_tanker_and_widens_its_turn() -> None:
    """At the same shaft speed: less acceleration ahead, and less turning by the same rudder."""
    inputs, nu = np.array([[-0.2, 1.3]]), np.array([[6.0, 0.0, 0.0]])
    deep, shallow = (
        tanker_in(depth).forward(np.zeros((1, 3)), nu, inputs=inputs)[0]
        for depth in ("deep", "shallow")
    )
    assert shallow[0] < deep[0]
    assert 0.0 < shallow[2] < deep[2]


def nomoto(name: str, speed: Array, outside: bool) -> tuple[Array, Array, Array]:
    """1 / T, n_3 / T and K / T from the table's speeds, by linear K, T and n_3 between them."""
    sets = parameters_of(name).parameter_sets.items()
    speeds = np.array([float(key.removeprefix("speed_").replace("_", ".")) for key, _ in sets])
    rows = np.array([(values["N_r"], values["N_rrr"], values["N_delta"]) for _, values in sets])
    T, n_3, K = -1.0 / rows[:, 0], rows[:, 1] / rows[:, 0], -rows[:, 2] / rows[:, 0]
    at = speed if outside else np.clip(speed, speeds[0], speeds[-1])
    right = np.clip(np.searchsorted(speeds, at), 1, len(speeds) - 1)
    share = (at - speeds[right - 1]) / (speeds[right] - speeds[right - 1])
    T, n_3, K = (c[right - 1] + share * (c[right] - c[right - 1]) for c in (T, n_3, K))
    return 1.0 / T, n_3 / T, K / T


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "file", "speed", "outside"),
    [
        ("frigate", "mss_frigate_xdot.csv", "U", True),
        ("frigate", "pvs_frigate_nudot.csv", "u", False),
        ("zeefakkel", "mss_zeefakkel_xdot.csv", "U", True),
        ("zeefakkel", "pvs_ROVzefakkel_nudot.csv", "u", False),
    ],
)
def test_ships_of_nomoto_accelerate_as_in_mss_and_python_vehicle_simulator(
    name: str, file: str, speed: str, outside: bool
) -> None:
    """Outside of the speeds of the table MSS extrapolates and the other program holds."""
    rows, ship = oracle(file), parameters_of(name).nominal()
    damping, cubic, rudder = nomoto(name, rows[speed], outside)
    limit = parameters_of(name).inputs["delta"].high
    delta = rows["delta"] if outside else np.clip(rows["delta"], -limit, limit)
    moment = np.zeros(len(delta)) if not outside else rows["d_r"] * damping
    found = np.empty((len(delta), 1))
    for k, r in enumerate(rows["r"]):
        values = {"r": -damping[k], "r^3": -cubic[k], "delta": rudder[k]}
        theta = [[-values[t.name] if t.name in values else 1.0] for t in ship.terms]
        at = replace(ship, theta=np.array(theta))
        found[k] = at.forward(moment[k : k + 1, None], np.array([[r]]), inputs=delta[k, None, None])
    close(found, rows["rdot"][:, None], 1e-12)


@pytest.mark.data
@pytest.mark.parametrize(
    ("file", "limit_deg"), [("mss_DSRV_xdot.csv", 30.0), ("pvs_DSRV_nudot.csv", 20.0)]
)
def test_the_rescue_vehicle_accelerates_as_in_mss(file: str, limit_deg: float) -> None:
    """Each with its own limit of the stern plane, and but for a slip that both have.

    They multiply the coefficients of the prime system with w and q in m/s and rad/s. So their
    numbers are those of w' and q' here, and their accelerations are those in the prime system.
    """
    rows, vehicle = oracle(file), parameters_of("dsrv").nominal()
    cruise, length = parameters_of("dsrv").speed_m_s or 0.0, parameters_of("dsrv").length_m or 0.0
    w, speed = rows["w"], np.hypot(cruise, rows["w"])
    nu = np.column_stack([np.sqrt(1.0 - w**2), w, rows["q"] / length]) * speed[:, None]
    attitude = np.zeros_like(nu)
    attitude[:, 1] = rows["theta"]
    plane = np.clip(rows["delta_s"], *np.radians([-limit_deg, limit_deg]))
    found = vehicle.forward(np.zeros_like(nu), nu, attitude, inputs=plane[:, None])
    assert np.all(found[:, 0] == 0.0)
    scaled = found[:, 1:] * length ** np.array([1.0, 2.0]) / speed[:, None] ** 2
    close(scaled, columns(rows, "wdot", "qdot"), 1e-12)


@pytest.mark.data
def test_the_ship_of_clarke_accelerates_as_in_python_vehicle_simulator() -> None:
    """But for two of its slips: U + 1 mm/s in the hull, and a rudder that drives the ship ahead."""
    rows, ship = oracle("pvs_shipClarke83_nudot.csv"), parameters_of("ship_clarke83").nominal()
    nu, delta = columns(rows, "u", "v", "r"), rows["delta"]
    added = {f"{a}_{b}": -1e-3 * ship.coefficient(dof, f"{b}U") for a, dof in HULL for b in "vr"}
    theirs = ship + derivative_table("slip", ship.dofs, added)
    made = ship.inverse(np.zeros_like(nu), nu) - ship.inverse(
        np.zeros_like(nu), nu, inputs=delta[:, None]
    )
    assert np.all(made[:, 0] <= 0.0)  # the rudder's resistance
    tau = np.column_stack([-2.0 * made[:, 0], np.zeros_like(made[:, 1:])])
    found = theirs.forward(tau, nu, inputs=delta[:, None])
    close(found, columns(rows, "udot", "vdot", "rdot"), 1e-12)
