"""The size of a trial and of a sweep is checked before any work, and refused in one line."""

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


@pytest.mark.parametrize("arguments", TOO_LARGE)
def test_what_is_too_large_is_refused_at_once(arguments: str, seatrial: Command) -> None:
    begin = time.process_time()
    message = seatrial.refuses(*arguments.split())
    first, last = TOO_LARGE[arguments]
    assert message.startswith(first)
    assert message.endswith(last)
    assert time.process_time() - begin < 10.0  # modules are imported the first time


def test_limits_are_options_and_make_no_other_trial(seatrial: Command) -> None:
    # 720 s in steps of 0.025 s, of 1200 bytes for each of 7200 samples.
    fits = ["limits.samples=28800", "limits.memory=0.00865", "dry_run=true"]
    assert seatrial("identifier=ls", *fits).code == 0
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
        assert seatrial(*sweep, "dry_run=true").code == 0
