"""Turning circles and zig-zags of KVLCC2 over time against mmgdynamics, model and full scale.

The wake of that program has a misplaced bracket,

    (1 - w_P) / (1 - w_P0) = 1 + (1 - exp(-C_1 |beta_P|) (C_2 - 1)),

which on each side of beta_P is the wake of Yasukawa with C_2' = 2 / (3 - C_2) and
1 - w_P0' = (3 - C_2) (1 - w_P0). So two ships are sailed in turn, one for each side.
"""

import json
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from docs.vessels import parameters_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import Prime
from seatrial.models.vessel.devices.propeller import Propeller
from seatrial.models.vessel.devices.rudder import Rudder
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.table import Vessel
from tests.models.vessel.oracles import columns, oracle, oracle_file

SPEEDS = {"L7": (1.179, 14.0838827196762), "full": (7.973888889, 1.93463423121133)}
RATES = {"L7": np.radians(15.82128765), "full": np.radians(2.34)}
LENGTHS = {"L7": 7.0, "full": 320.0}


class Ship(NamedTuple):
    """KVLCC2 for beta_P >= 0 and for beta_P < 0, at one scale."""

    sides: tuple[Vessel, Vessel]
    length: float
    x_P: float  # in lengths

    def rate(self, y: Array, helm: float, n: float) -> Array:
        """Time derivative of (u, v, r, x, y, psi)."""
        u, v, r = y[:3]
        drift = np.arctan2(-v, u) - self.x_P * r * self.length / np.hypot(u, v)
        side = self.sides[0 if drift >= 0.0 else 1]
        nu_dot = side.forward(np.zeros((1, 3)), y[None, :3], inputs=np.array([[helm, n]]))[0]
        c, s = np.cos(y[5]), np.sin(y[5])
        return np.array([*nu_dot, u * c - v * s, u * s + v * c, r])


def parameters(scale: str) -> dict[str, float]:
    record = json.loads(oracle_file(f"mmgdynamics_kvlcc2_{scale}_params.json").read_text())
    return {name: entry["value"] for name, entry in record["parameters"].items()}


def configured(scale: str) -> VesselParameters:
    """KVLCC2 of the configuration, with main dimensions, propeller and rudder of the program."""
    ship, p = parameters_of("kvlcc2_full"), parameters(scale)
    mass, x_g, length = p["displ"] * p["rho"], p["x_G"], p["Lpp"]
    turning = mass * ((0.25 * length) ** 2 + x_g**2)
    propeller, rudder = ship.devices["propeller"], ship.devices["rudder"]
    assert isinstance(propeller, Propeller)
    assert isinstance(rudder, Rudder)
    rows = ((mass, 0.0, 0.0), (0.0, mass, mass * x_g), (0.0, mass * x_g, turning))
    place = p["x_P"] / length
    screw = replace(propeller, diameter_m=p["D_p"], k_2=p["k_2"], length_m=length, x_P=place)
    blade = replace(rudder, area_m2=p["A_R"], length_m=length)
    return replace(
        ship, inertia=rows, prime=Prime(length_m=length, draught_m=p["d"], rho_kg_m3=p["rho"]),
        devices={"propeller": screw, "rudder": blade}, length_m=length,
    )  # fmt: skip


def with_its_wake(scale: str) -> Ship:
    """The ship with the wake of mmgdynamics."""
    ship, p, sides = configured(scale), parameters(scale), []
    for name in ("C_2_plus", "C_2_minus"):
        factor = 3.0 - p[name]
        screw: Any = ship.devices["propeller"]
        screw = replace(
            screw, wake="yasukawa", C_1=p["C_1"], C_2_plus=2.0 / factor, C_2_minus=2.0 / factor,
            w_P0=1.0 - factor * (1.0 - p["w_P0"]),
        )  # fmt: skip
        sides.append(replace(ship, devices={**ship.devices, "propeller": screw}).nominal())
    return Ship((sides[0], sides[1]), LENGTHS[scale], p["x_P"] / p["Lpp"])


def sailed(scale: str, helm_deg: float, turn_deg: float, t: Array) -> Array:
    """(u, v, r, x, y, psi) at instants t (N,), shape (N, 6).

    The helm is put to the other side each time the heading has changed by `turn_deg`.
    """
    ship, (speed, n), rate = with_its_wake(scale), SPEEDS[scale], RATES[scale]
    order, turn = np.radians(helm_deg), np.radians(turn_deg)
    now, helm, y = 0.0, 0.0, np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = [y[:, None]]
    while now < t[-1]:
        slope = rate * np.sign(order - helm)
        end = min(t[-1], now + abs(order - helm) / rate if slope else np.inf)

        def motion(at: float, y: Array, a: float = now, b: float = helm, c: float = slope) -> Array:
            return ship.rate(y, b + c * (at - a), n)

        def turned(_: float, y: Array, side: float = np.sign(order)) -> float:
            return float(side * y[5] - turn)

        turned.terminal, turned.direction = True, 1.0  # type: ignore[attr-defined]
        leg = solve_ivp(
            motion, (now, end), y, "DOP853", t[(t > now) & (t <= end)], events=turned,
            rtol=1e-8, atol=1e-10, dense_output=True,
        )  # fmt: skip
        executed = bool(len(leg.t_events[0]))
        stop = leg.t_events[0][0] if executed else end
        found.append(leg.y[:, leg.t <= stop] if leg.y.size else np.zeros((6, 0)))
        y, helm = leg.sol(stop), helm + slope * (stop - now)
        helm, now = (order if stop == end and slope else helm), stop
        order = -order if executed else order
    return np.concatenate(found, axis=1).T


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("scale", ["L7", "full"])
@pytest.mark.parametrize(
    ("file", "helm_deg", "turn_deg"),
    [
        ("turn_p35", 35.0, np.inf), ("turn_m35", -35.0, np.inf), ("zigzag1010", 10.0, 10.0),
        ("zigzag2020", 20.0, 20.0),
    ],
)  # fmt: skip
def test_kvlcc2_moves_as_in_mmgdynamics(
    scale: str, file: str, helm_deg: float, turn_deg: float
) -> None:
    """Within 1e-3 L and 0.05 degrees over ten minutes; here 25 times closer and more."""
    rows = oracle(f"mmgdynamics_kvlcc2_{scale}_nself_{file}.csv")
    t = rows["t"][rows["t"] <= 600.0]
    found = sailed(scale, helm_deg, turn_deg, t)
    expected = columns(rows, "x", "y", "psi")[: len(t)]
    np.testing.assert_allclose(found[:, 3:5], expected[:, :2], atol=1e-5 * LENGTHS[scale])
    np.testing.assert_allclose(found[:, 5], expected[:, 2], atol=np.radians(2e-3))
    velocity = columns(rows, "u", "v", "r")[: len(t)]
    np.testing.assert_allclose(found[:, :3], velocity, atol=1e-5 * SPEEDS[scale][0])
