"""Refused in one line before any work: what is too large, and unused options that are wrong."""

import time
from pathlib import Path

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.trials import budget
from tests.runner.command import Command
from tests.trials import composed

BILLION = 10**9
# Simulations that are too long, and counts beyond their bounds: the arguments, and the message.
LONG = "(limits.samples)"
TOO_LARGE = {
    "excitation=prbs excitation.length_s=1e12": ("excitation.length_s: got 1e+12, 1e+13 ", LONG),
    "sample_time_s=1e-9 integration_step_s=1e-9": ("excitation.interval_s: got 60, ", LONG),
    "integration_step_s=1e-12": ("excitation.interval_s: got 60, 7.2e+03 samples of ", LONG),
    "evaluation=square evaluation.duration_s=1e12": ("evaluation.duration_s: got 1e+12,", LONG),
    "excitation=prbs excitation.length_s=1e9": ("excitation.length_s: ", "(limits.memory)"),
    "excitation=prbs excitation.signal.shortest_s=1e-12": (
        "excitation.signal.shortest_s must be at least 0.001", "got 1e-12",
    ),
    f"excitation=optimal_design excitation.sub_experiments={BILLION}": (
        "excitation.sub_experiments must be at most 1000000", "got 1000000000",
    ),
    "controller=mpc_standard controller.horizon=1000000": ("controller.horizon must be at ", ""),
    f"identifier=nsga2 identifier.population={BILLION}": ("identifier.population must be at ", ""),
    f"identifier=plsr identifier.bootstrap={BILLION}": ("identifier.bootstrap must be at ", ""),
    "identifier=dsr identifier.L=1000000": ("identifier.L must be at most 1000, got 1000000", ""),
    f"identifier=auto identifier.folds={BILLION}": ("identifier.folds must be at most 1000, ", ""),
    "identifier=none evaluation=none sample_time_s=2000": (
        "excitation=waypoints: got 720 s, 0 samples of sample_time_s=2000; expected at least 4", "",
    ),
    "evaluation=square evaluation.duration_s=1e-9": (
        "evaluation=square: got 1e-09 s, 0 samples of sample_time_s=0.1; expected at least 4", "",
    ),
}  # fmt: skip


def test_what_is_too_large_is_refused_at_once(seatrial: Command) -> None:
    begin = time.process_time()
    reasons = seatrial.reasons(TOO_LARGE)
    assert time.process_time() - begin < 10.0  # modules are imported the first time
    for reason, (first, last) in zip(reasons, TOO_LARGE.values(), strict=True):
        assert reason.startswith(first)
        assert reason.endswith(last)


def test_limits_are_options_and_make_no_other_trial(seatrial: Command) -> None:
    # 720 s in steps of 0.025 s, of 1200 bytes for each of 7200 samples.
    fits = ["limits.samples=28800", "limits.memory=0.00865", "dry_run=true"]
    seatrial.succeeds("identifier=ls", *fits)
    assert "(limits.samples)" in seatrial.refuses("identifier=ls", *fits, "limits.samples=28799")
    assert "(limits.memory)" in seatrial.refuses("identifier=ls", *fits, "limits.memory=0.0086")
    assert "must be positive" in seatrial.refuses("identifier=ls", *fits, "limits.memory=0")
    fake = seatrial.pretend()
    seatrial("seed=5")
    assert "already in the logbook as run 1" in seatrial("seed=5", "limits.samples=1e12").out
    assert fake.ran == [5]


def test_a_measured_file_is_checked_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.truncate(10**13)  # sparse
    trial = composed("vessel=surge_linear", "excitation=recording", f"excitation.path={path}")
    with pytest.raises(ConfigurationError, match=r"excitation.path: got .* of about 1e\+05 GB in"):
        budget.check(trial)


@pytest.mark.slow
def test_trials_are_counted_before_they_are_listed(seatrial: Command) -> None:
    seatrial.pretend()
    begin = time.process_time()
    message = seatrial.refuses("-m", f"seed=range(0,{BILLION})", "disturbance=calm,noise")
    assert message == (
        "seed: got 1e+09 values, 2e+09 trials; expected at most 1e+06 (limits.trials)"
    )
    assert time.process_time() - begin < 10.0
    assert "(limits.trials)" in seatrial.refuses("-m", "seed=range(0,9)", "limits.trials=8")
    variants = ("-m", "--variant", "plant.scale=0.5", "--variant", "plant.scale=0.6")
    message = seatrial.refuses(*variants, "seed=range(0,5)", "limits.trials=8")
    assert message.startswith("seed: got 5 values, 10 trials")
    for sweep in (  # the last of two overrides of one option counts
        ("-m", "seed=range(0,8)", "limits.trials=8"),
        (*variants, "seed=range(0,5)", "limits.trials=10"),
        ("-m", "seed=range(0,9)", "seed=1,2", "limits.trials=2"),
    ):
        seatrial.succeeds(*sweep, "dry_run=true")


# Options that no chosen part uses are refused if they cannot be right.
UNUSED = ("controller=none", "excitation=prbs")
WRONG = {
    "vessel.tuning.pid.kp=[nan,1,1]": "vessel.tuning.pid.kp[0]: got nan, expected a finite number",
    "vessel.tuning.reference.interval_s=inf": (
        "vessel.tuning.reference.interval_s: got inf, expected a finite number"
    ),
    "+vessel.tuning.mine=1": "vessel.tuning.mine: unknown option, expected one of pid, reference",
    "+extra=nan": "extra: unknown option, expected one of vessel, ",
    f"seed={2**70}": "seed must be at most 9223372036854775807, got 11805",
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
    "+excitation.amplitude.heel=1": "excitation: amplitude: got heel, expected a number for each ",
}


def test_unused_options_that_cannot_be_right(seatrial: Command) -> None:
    reasons = seatrial.reasons(WRONG, *UNUSED)
    for reason, (argument, message) in zip(reasons, WRONG.items(), strict=True):
        assert reason.startswith(message), argument


def test_schedules_and_parameter_sets_that_are_not_chosen(seatrial: Command) -> None:
    said = seatrial.refuses("evaluation=setpoints", "evaluation.schedules.appendix_h=[[0,0]]")
    assert said.startswith("evaluation.schedules.appendix_h"), said
    said = seatrial.refuses("vessel=supply_vessel", "+vessel.parameter_sets.as_printed.Z_w=1")
    assert "Z_w: got heave, expected one of surge, sway, yaw" in said


def test_unused_options_that_are_accepted(seatrial: Command) -> None:
    seatrial.pretend()
    condition = "vessel.coriolis=false vessel.inertia=[[1,0,0],[0,1e-12,0],[0,0,1]]"
    read = "controller.ki=${vessel.tuning.pid.kp}"
    variants = ("--variant", condition, "--variant", f"'{read}'")
    assert "2 trials: 2 new" in seatrial("-m", *variants, "dry_run=true").out
