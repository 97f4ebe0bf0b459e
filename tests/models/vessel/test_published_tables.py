"""Steered vessels that are tables alone, against MSS and PythonVehicleSimulator.

The tables of these programs (`shared/data/oracles`) have 300 random states each.
"""

import json
from dataclasses import replace
from functools import cache

import numpy as np

from docs.vessels import parameters_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.table import Vessel
from tests.models.vessel.oracles import close, columns, oracle, oracle_file

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


def test_the_tanker_accelerates_as_in_mss() -> None:
    rows = oracle("mss_tanker_xdot.csv")
    expected = columns(rows, "udot", "vdot", "rdot")
    close(tanker_accelerations(rows, rows["h"], "n"), expected, 1e-12)


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
