"""Options that no chosen part uses are refused if they cannot be right."""

from tests.runner.command import Command

UNUSED = ("controller=none", "excitation=prbs")
REFUSED = {
    "vessel.tuning.pid.kp=[nan,1,1]": "vessel.tuning.pid.kp[0]: got nan, expected a finite number",
    "vessel.tuning.reference.interval_s=inf": (
        "vessel.tuning.reference.interval_s: got inf, expected a finite number"
    ),
    "+vessel.tuning.mine=1": "vessel.tuning.mine: unknown option, expected one of pid, reference",
    "+extra=nan": "extra: got nan, expected a finite number",
    f"seed={2**70}": "seed: got an integer of 71 bits, expected 64",
    "vessel.tuning.reference.interval_s=abc": (
        "vessel.tuning.reference.interval_s: got 'abc', expected a number or null"
    ),
    "+vessel.tuning.pid.kpp=3": "vessel.tuning.pid.kpp: unknown option, did you mean ",
    "+vessel.sources.inertai=book": "vessel: sources.inertai: got a source of an option",
    "vessel.dofs=[surge,sway,heel]": "vessel: dofs: got heel, expected different ones of surge, ",
    "vessel.inertia=[[1,2],[1,2,3],[3,4,5]]": (
        "vessel: inertia: got rows of 2, 3, 3 numbers, expected 3 rows of 3"
    ),
    "vessel.inertia=[[1,0,0],[0,1e-16,0],[0,0,1]]": (
        "vessel: inertia has a condition number of 1.0e+16, expected at most 1e+15"
    ),
    "+excitation.amplitude.heel=1": "excitation: amplitude.heel: expected some of surge, ",
}


def test_options_that_cannot_be_right(seatrial: Command) -> None:
    variants = [word for argument in REFUSED for word in ("--variant", argument)]
    lines = seatrial("-m", *variants, *UNUSED, "dry_run=true").out.splitlines()
    for line, (argument, message) in zip(lines[:-1], REFUSED.items(), strict=True):
        state, reason = line.split()[0], line.split("  ")[-1].strip()
        assert (state, reason[: len(message)]) == ("refused", message), argument


def test_schedules_and_parameter_sets_that_are_not_chosen(seatrial: Command) -> None:
    said = seatrial.refuses("evaluation=setpoints", "evaluation.schedules.appendix_h=[[0,0]]")
    assert "schedules.appendix_h: expected a list of (north, east, heading)" in said
    said = seatrial.refuses("vessel=supply_vessel", "+vessel.parameter_sets.as_printed.Z_w=1")
    assert "Z_w: got heave, expected one of surge, sway, yaw" in said


def test_what_is_accepted(seatrial: Command) -> None:
    seatrial.pretend()
    condition = "vessel.coriolis=false vessel.inertia=[[1,0,0],[0,1e-12,0],[0,0,1]]"
    read = "controller.ki=${vessel.tuning.pid.kp}"
    variants = ("--variant", condition, "--variant", f"'{read}'")
    assert "2 trials: 2 new" in seatrial("-m", *variants, "dry_run=true").out
