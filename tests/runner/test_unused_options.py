"""Options that no chosen part uses are refused if they cannot be right."""

from pathlib import Path

import pytest

from tests.runner.command import Command

ROOT = Path(__file__).parents[2]
UNUSED = ("controller=none", "excitation=prbs")
REFUSED = {
    "vessel.tuning.pid.kp=[nan,1,1]": "vessel.tuning.pid.kp[0]: got nan, expected a finite number",
    "vessel.tuning.reference.interval_s=inf": (
        "vessel.tuning.reference.interval_s: got inf, expected a finite number"
    ),
    "+vessel.tuning.mine=-inf": "vessel.tuning.mine: got -inf, expected a finite number",
    "+vessel.tuning.mine=1": "vessel.tuning.mine: unknown option, expected one of pid, reference",
    "+extra=nan": "extra: got nan, expected a finite number",
    "+limits.extra=nan": "limits.extra: got nan, expected a finite number",
    "hydra.sweeper.params={x: nan}": "hydra.sweeper.params.x: got nan, expected a finite",
    f"seed={2**70}": "seed: got an integer of 71 bits, expected 64",
    "vessel.tuning.reference.interval_s=abc": (
        "vessel.tuning.reference.interval_s: got 'abc', expected a number or null"
    ),
    "vessel.tuning.pid.kp=3": "vessel.tuning.pid.kp: got 3, expected a list",
    "+vessel.tuning.pid.kpp=3": "vessel.tuning.pid.kpp: unknown option, did you mean ",
    "+vessel.sources.inertai=book": "vessel: sources.inertai: got a source of an option",
    "vessel.dofs=[surge,sway,heel]": "vessel: dofs: got heel, expected different ones of surge, ",
    "vessel.dofs=[surge,sway,sway]": "vessel: dofs: got surge, sway, sway, expected different ",
    "vessel.inertia=[[1,2],[1,2,3],[3,4,5]]": (
        "vessel: inertia: got rows of 2, 3, 3 numbers, expected 3 rows of 3"
    ),
    "vessel.inertia=[[1,0,0],[0,nan,0],[0,0,1]]": "vessel.inertia[1][1]: got nan, ",
    "vessel.inertia=[[1,0,0],[0,1e-16,0],[0,0,1]]": (
        "vessel: inertia has a condition number of 1.0e+16, expected at most 1e+15"
    ),
    "+excitation.amplitude.heel=1": "excitation: amplitude.heel: expected some of surge, ",
}


@pytest.mark.parametrize("argument", REFUSED)
def test_an_option_that_cannot_be_right(argument: str, seatrial: Command) -> None:
    said = seatrial.refuses(*UNUSED, argument)
    assert said.startswith(REFUSED[argument])


def test_schedules_and_parameter_sets_that_are_not_chosen(seatrial: Command) -> None:
    said = seatrial.refuses("evaluation=setpoints", "evaluation.schedules.appendix_h=[[0,0]]")
    assert "schedules.appendix_h: expected a list of (north, east, heading)" in said
    said = seatrial.refuses("vessel=supply_vessel", "+vessel.parameter_sets.as_printed.Z_w=1")
    assert "Z_w: got heave, expected one of surge, sway, yaw" in said


def test_a_condition_below_the_limit_is_accepted(seatrial: Command) -> None:
    seatrial.pretend()
    inertia = "vessel.inertia=[[1,0,0],[0,1e-12,0],[0,0,1]]"
    assert seatrial("vessel.coriolis=false", inertia, "dry_run=true").code == 0


def test_every_vessel_is_accepted(seatrial: Command) -> None:
    seatrial.pretend()
    for path in sorted((ROOT / "conf" / "vessel").glob("*.yaml")):
        assert seatrial(f"vessel={path.stem}", "dry_run=true").code == 0, path.stem


def test_a_value_that_an_override_reads(seatrial: Command) -> None:
    seatrial.pretend()
    assert seatrial("controller.ki=${vessel.tuning.pid.kp}", "dry_run=true").code == 0
