"""Derived gains and weights track within 5 % of the hand-tuned ones, calm and under noise.

The missions and the noise are the vessel's own in both cases; the means under noise are
over two seeds.
"""

import sqlite3

import pytest

from tests.runner.command import Command

PID = tuple(f"vessel.tuning.pid.{gain}=null" for gain in ("kp", "ki", "kd"))
LINEAR = tuple(
    f"vessel.tuning.control.{name}=null"
    for name in (
        *("period_s", "horizon", "error_weight", "input_weight", "increment_weight"),
        *("process", "measurement", "bias_walk"),
    )
)
LAP = ("controller=pid_ff",)
RUNS = ("controller=pid_ff", "excitation=constant_velocity")
CORNERS = ("excitation=single_ramp", "evaluation=four_corner")
PLANAR = ("milliampere", "modulus_ship", "supply_vessel")
CASES = {
    **{f"{vessel} pid_ff": (vessel, LAP, PID) for vessel in PLANAR},
    **{f"{name} pid_ff": (name, RUNS, PID) for name in ("beluga_diagonal", "beluga_full")},
    **{
        f"{vessel} {controller}": (vessel, (*CORNERS, f"controller={controller}"), LINEAR)
        for vessel in PLANAR
        for controller in ("lqi", "mpc_standard", "mpc_integral")
    },
}


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES)
def test_tracking_error(case: str, seatrial: Command) -> None:
    vessel, mission, derived = CASES[case]
    weather = ("--variant", "disturbance=calm seed=0", "--variant", "disturbance=noise seed=0,1")
    for own in ((), derived):
        chosen = (f"vessel={vessel}", *mission, *own, "identifier=none")
        answer = seatrial("-m", *weather, *chosen)
        assert answer.code == 0, answer.err
    with sqlite3.connect(seatrial.folder / "results" / "results.db") as database:
        rows = database.execute(
            "select disturbance, sweep_id, avg(value) from metric join run on run.id = run_id"
            " where name = 'e_pos_mae' and model = 'nominal' group by 1, 2 order by 1, 2"
        ).fetchall()
    errors = [value for *_, value in rows]
    assert len(errors) == 4
    for by_hand, found in zip(errors[::2], errors[1::2], strict=True):
        assert found <= 1.05 * by_hand
