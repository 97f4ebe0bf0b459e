"""Vessels with inputs against other programs: accelerations, time series and measures."""

import json
from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.dynamics import rates, scratch
from seatrial.models.simulation.manoeuvre_sheet import Track, turn, zigzag
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.derivatives import Prime
from seatrial.models.vessel.devices.device import device_forces
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.pose import kinematics_of
from seatrial.runner.trials.checks import check
from tests.models.control.sailing import weather
from tests.models.vessel.oracles import close, columns, oracle, oracle_file
from tests.trials import composed, sailed

STILL = weather(0)
TURN = {  # quantities and their names in the program's record
    "advance": "advance_over_L", "transfer": "transfer_over_L",
    "tactical diameter": "tactical_diameter_over_L",
    "steady diameter": "steady_turning_diameter_over_L_2U_over_r_L",
}  # fmt: skip
OPEN = ("identifier=none", "controller=none", "evaluation=none", "disturbance=calm")


def vessel(name: str) -> VesselParameters:
    return composed(f"vessel={name}", "excitation=rudder_turn", *OPEN).vessel


def steered(*options: str) -> Voyage:
    trial = composed(*options, *OPEN)
    check(trial)
    return sailed(trial).voyage


def track(voyage: Voyage, length_m: float, *, ordered: bool = False) -> Track:
    """The motion with the helm as it moves, or as it is ordered."""
    eta, speed = voyage.log.eta, np.hypot(*voyage.log.nu[:, :2].T)
    helm = voyage.log.tau_actual[:, 0]
    if ordered:
        helm = np.concatenate([helm[:1], voyage.log.tau[1:, 0]])
    return Track(voyage.t, *eta[:, :3].T, helm, speed, length_m)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "file", "column"),
    [
        ("kvlcc2", "compare_shipmmg_mmgdynamics_L7_nudot.csv", "mmgd_xG0p25"),
        ("kvlcc2_full", "mmgdynamics_kvlcc2_full_nudot.csv", "expwake"),
    ],
)
def test_kvlcc2_accelerates_as_in_mmgdynamics(name: str, file: str, column: str) -> None:
    """The consistent midship form, all 300 states, with the wake exp(-4 beta_P^2).

    The bracket of its own wake is misplaced, and shipmmg's U and beta are not those of midship.
    """
    rows = oracle(file)
    nu, inputs = columns(rows, "u", "v", "r"), columns(rows, "delta", "n")
    found = vessel(name).nominal().forward(np.zeros_like(nu), nu, inputs=inputs)
    expected = columns(rows, *(f"{a}_{column}" for a in ("udot", "vdot", "rdot")))
    close(found, expected, 1e-12)


@pytest.mark.data
def test_mariner_accelerates_as_in_mss() -> None:
    """About its own speed and about the random ones of the rows."""
    rows, ship = oracle("mss_mariner_xdot.csv"), vessel("mariner")
    expected = columns(rows, "udot", "vdot", "rdot")
    found = np.empty_like(expected)
    for k, speed in enumerate(rows["U0"]):
        about = replace(ship, prime=replace(ship.prime or Prime(1.0), speed_m_s=speed))
        nu = np.array([[rows["u"][k] + speed, rows["v"][k], rows["r"][k]]])
        inputs = rows["delta"][k, None, None]
        found[k] = about.nominal().forward(np.zeros((1, 3)), nu, inputs=inputs)[0]
    close(found, expected, 1e-11)


@pytest.mark.data
def test_container_accelerates_as_in_mss() -> None:
    """With roll, 300 states; there the shaft speed is in revolutions a minute."""
    rows = oracle("mss_container_xdot.csv")
    nu = columns(rows, "u", "v", "p", "r")
    inputs = np.stack([rows["delta"], rows["n"] / 60.0], axis=1)
    attitude = np.zeros((len(nu), 3))
    attitude[:, 0] = rows["phi"]
    ship = vessel("container").nominal()
    found = ship.forward(np.zeros_like(nu), nu, attitude, inputs=inputs)
    expected = columns(rows, "udot", "vdot", "pdot", "rdot")
    close(found, expected, 1e-11)
    table = ship.plant_table()
    work, kinematics = scratch(len(table.codes), 4, 4), kinematics_of(ship.dofs)
    for k in range(20):
        eta = np.array([0.0, 0.0, rows["phi"][k], rows["psi"][k]])
        eta_dot, nu_dot = np.zeros(4), np.zeros(4)
        rates(kinematics, table, eta, nu[k], inputs[k], STILL, 0, work, eta_dot, nu_dot)
        moved = [rows[name][k] for name in ("xdot", "ydot", "phidot", "psidot")]
        np.testing.assert_allclose(eta_dot, moved, rtol=1e-12)
        np.testing.assert_allclose(nu_dot, expected[k], rtol=1e-9)


@pytest.mark.data
@pytest.mark.parametrize(("helm", "file"), [(-35, "turn_p35"), (35, "turn_m35")])
def test_mariner_turns_as_in_mss(helm: int, file: str) -> None:
    """Ten minutes; in MSS the helm has the sign of the turn."""
    rows = oracle(f"mss_mariner_{file}_t0_rk4.csv")
    voyage = steered(
        "vessel=mariner", "excitation=rudder_turn", f"excitation.helm_deg={helm}",
        "excitation.duration_s=601", "sample_time_s=0.5", "integration_step_s=0.05",
    )  # fmt: skip
    eta, nu = voyage.log.eta[::2], voyage.log.nu[::2]
    assert len(eta) == len(rows["t"]) == 601
    for i, name in enumerate(("x", "y", "psi")):
        np.testing.assert_allclose(eta[:, i], rows[name], atol=1e-6)
    np.testing.assert_allclose(nu[:, 0] - 7.7175, rows["u"], atol=1e-8)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "case", "step_s"),
    [
        ("kvlcc2", "mmgdynamics_with_shipmmg_L7_params_nself", 0.02),
        ("kvlcc2_full", "mmgdynamics_kvlcc2_full_expwake_nself", 0.2),
    ],
)
def test_kvlcc2_turns_and_zigzags_as_in_mmgdynamics(name: str, case: str, step_s: float) -> None:
    """Measures of the program without the slips D1 and D2, with equal parameters."""
    record = json.loads(oracle_file("mmg_measures_and_comparison.json").read_text())
    printed, length = record["measures"][case], vessel(name).length_m or 0.0
    start = (
        f"vessel={name}", f"excitation.speed_m_s={printed['u0']}",
        f"integration_step_s={step_s}", f"sample_time_s={step_s}",
        f"excitation.duration_s={30000 * step_s}", f"vessel.inputs.n.start={printed['n_rps']}",
        f"vessel.inputs.delta.rate_limit={printed['rudder_rate_rad_s']}",
    )  # fmt: skip
    for sign, file in ((1, "turn_p35"), (-1, "turn_m35")):
        voyage = steered(*start, "excitation=rudder_turn", f"excitation.helm_deg={sign * 35}")
        measures = turn(track(voyage, length, ordered=True))
        for quantity, key in TURN.items():
            assert measures[quantity] == pytest.approx(printed[file][key], abs=0.01), quantity
    for angle in (10, 20):
        voyage = steered(
            *start, "excitation=rudder_zigzag", f"excitation.helm_deg={angle}",
            f"excitation.turn_deg={angle}",
        )  # fmt: skip
        of_zigzag = printed[f"zigzag_{angle}_{angle}"]
        expected = [of_zigzag[f"overshoot_{k}_deg"] for k in (1, 2, 3)]
        found = zigzag(track(voyage, length))
        overshoots = [found[f"{n} overshoot"] for n in ("first", "second", "third")]
        np.testing.assert_allclose(overshoots, expected, atol=0.1)


@pytest.mark.parametrize("name", ["kvlcc2", "mariner"])
def test_the_loop_has_the_accelerations_of_the_table(name: str) -> None:
    """What is compiled for the simulation is what the table says."""
    ship = vessel(name).nominal()
    rng = np.random.default_rng(0)
    table = ship.plant_table()
    work, kinematics = scratch(len(table.codes), 3, 3), kinematics_of(ship.dofs)
    for _ in range(20):
        nu = np.array([1.5, 0.3, 0.05]) * rng.normal(size=3)
        inputs = (np.array([0.4, 12.0]) * rng.uniform(-1.0, 1.0, 2))[: len(ship.inputs)]
        eta_dot, nu_dot = np.zeros(3), np.zeros(3)
        rates(kinematics, table, np.zeros(3), nu, inputs, STILL, 0, work, eta_dot, nu_dot)
        expected = ship.forward(np.zeros((1, 3)), nu[None], inputs=inputs[None])[0]
        np.testing.assert_allclose(nu_dot, expected, rtol=1e-12)


def test_a_device_comes_after_what_it_is_behind_and_has_its_input() -> None:
    ship = vessel("kvlcc2")
    backwards = dict(reversed(ship.devices.items()))
    with pytest.raises(ConfigurationError, match=r"behind 'propeller', expected .* before"):
        replace(ship, devices=backwards)
    with pytest.raises(ConfigurationError, match="got delta, but a device needs 'n'"):
        replace(ship, inputs={"delta": ship.inputs["delta"]})


def test_thrust_is_continuous_where_the_shaft_stands_still() -> None:
    ship = vessel("kvlcc2").nominal()
    nu, still = np.tile([1.0, 0.0, 0.0], (3, 1)), np.zeros((3, 3))
    x = ship.variables(still, nu, inputs=np.array([[0.0, n] for n in (-1e-9, 0.0, 1e-9)]))
    thrust = device_forces(ship.installed, x)[:, 0]
    assert np.ptp(thrust) < 1e-6 * abs(thrust[1])


@pytest.mark.data
def test_overshoots_of_a_measured_ship() -> None:
    """MARIN's zig-zags of KVLCC2, full scale; within 0.2 degrees of what is published."""
    folder = oracle_file("").parent / "kvlcc2" / "marin"
    expected = {"10": (9.5, 15.0), "-10": (8.2, 21.9), "20": (15.1,), "-20": (13.7,)}
    for angle, overshoots in expected.items():
        rows = np.loadtxt(folder / f"MARIN_FREE_KVLCC2_zz_{angle}_m.dat", skiprows=3)
        t = np.linspace(0.0, rows[-1, 0] - rows[0, 0], len(rows))  # three digits: it repeats
        psi, helm = np.radians(rows[:, 4]), np.radians(rows[:, 9])
        speed = np.hypot(rows[:, 5], rows[:, 6])
        measures = zigzag(Track(t, rows[:, 1], rows[:, 2], psi, helm, speed, 320.0))
        found = [measures[f"{n} overshoot"] for n in ("first", "second")[: len(overshoots)]]
        np.testing.assert_allclose(found, overshoots, atol=0.2)


@pytest.mark.data
@pytest.mark.parametrize(
    ("run", "helm", "within"),
    [
        ("14-Oct-2020_14_29_49", 20, 0.2),
        ("14-Oct-2020_14_56_07", -20, 0.25),
        ("14-Sep-2020_13_51_45", 35, 0.4),
        ("14-Sep-2020_14_16_04", -35, 0.4),
    ],
)
def test_the_first_model_of_esso_osaka_turns_like_the_ship(
    run: str, helm: int, within: float
) -> None:
    """At 10 1/s: the steady rate of turn of recorded circles, as far as regressions reach.

    It is lower in the model, most at the largest helm.
    """
    folder = oracle_file("").parent / "esso" / "turning"
    rows = np.genfromtxt(folder / f"turn_{run}.csv", delimiter=",", skip_header=1)
    steady = rows[int(0.6 * len(rows)) : int(0.95 * len(rows))]
    at = np.abs(np.degrees(steady[:, 8]) - helm) < 2.0
    recorded = float(np.mean(steady[at, 6]))
    voyage = steered(
        "vessel=esso_osaka", "excitation=rudder_turn", f"excitation.helm_deg={helm}",
        "excitation.duration_s=300", "sample_time_s=0.1", "integration_step_s=0.1",
    )  # fmt: skip
    found = voyage.log.nu[-1, 2]
    assert np.sign(found) == np.sign(recorded) == np.sign(helm)
    assert 1.0 - within < found / recorded < 1.0


def test_the_first_model_of_esso_osaka_has_the_speed_of_the_ship() -> None:
    """0.33 to 0.38 m/s at 10 1/s before the circles."""
    assert vessel("esso_osaka").approach_speed_m_s == pytest.approx(0.355, abs=0.025)
