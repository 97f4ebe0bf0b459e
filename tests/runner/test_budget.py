"""What a trial would take is judged before any work, and refused in one line."""

import time
from pathlib import Path

import pytest

from seatrial.models.demand import Demand, amount
from seatrial.models.errors import ConfigurationError
from seatrial.runner import budget
from seatrial.runner.config import Limits
from tests.runner.command import Command

BILLION = 10**9
AREA = "excitation.route.area=[[0,0],[60,0],[60,40],[0,40]]"
# The arguments, and the option that the message names.
TOO_LARGE = {
    "excitation=prbs excitation.length_s=1e12": "excitation.length_s",
    "sample_time_s=1e-9 integration_step_s=1e-9": "sample_time_s",
    "integration_step_s=1e-12": "integration_step_s",
    "excitation.interval_s=1e12": "excitation.interval_s",
    "evaluation=square evaluation.duration_s=1e12": "evaluation.duration_s",
    "excitation=constant_velocity excitation.run_s=1e12": "excitation.run_s",
    "excitation=prbs excitation.signal.shortest_s=1e-12": "excitation.signal.shortest_s",
    "excitation=multisine excitation.signal.highest_hz=1e12": "excitation.signal.highest_hz",
    "excitation=mix excitation.length_s=1e12": "excitation.length_s",
    f"excitation=mix excitation.sub_experiments={BILLION}": "excitation.sub_experiments",
    f"excitation=mix excitation.design=random excitation.repeats={10**15}": "excitation.repeats",
    f"excitation=mix {AREA} excitation.route.cell_m=1e-9": "excitation.route.cell_m",
    f"excitation=mix {AREA} excitation.route.hold_s=1e12": "excitation.route.hold_s",
    f"excitation=mix {AREA} excitation.route.speed_m_s=1e-12 excitation.route.cell_m=1": (
        "excitation.route.speed_m_s"
    ),
    "controller=mpc_standard controller.horizon=1000000": "controller.horizon",
    "controller=mpc_condensed controller.horizon=1000000": "controller.horizon",
    f"identifier=nsga2 identifier.population={BILLION}": "identifier.population",
    f"identifier=nsga2 identifier.generations={BILLION}": "identifier.generations",
    f"identifier=plsr identifier.bootstrap={BILLION}": "identifier.bootstrap",
    f"identifier=ls identifier.bootstrap={BILLION}": "identifier.bootstrap",
    f"identifier=iv identifier.bootstrap={BILLION}": "identifier.bootstrap",
    f"identifier=iv identifier.iterations={BILLION}": "identifier.iterations",
    f"identifier=dsr identifier.bootstrap={BILLION}": "identifier.bootstrap",
    "identifier=dsr identifier.L=1000000": "identifier.L",
    f"identifier=dsr identifier.markov_parameters={10**15}": "identifier.markov_parameters",
    f"identifier=least_squares identifier.bootstrap={BILLION}": "identifier.bootstrap",
    f"identifier.folds={BILLION}": "identifier.folds",
    f"identifier=auto identifier.folds={BILLION}": "identifier.folds",
}


@pytest.mark.parametrize("arguments", TOO_LARGE)
def test_what_is_too_large_is_refused_at_once(arguments: str, seatrial: Command) -> None:
    begin = time.process_time()
    message = seatrial.refuses(*arguments.split())
    assert message.startswith(f"{TOO_LARGE[arguments]}: got ")
    assert "; expected at most " in message
    assert message.endswith(("(limits.samples)", "(limits.memory)"))
    assert time.process_time() - begin < 10.0  # modules are imported the first time


def test_the_line_names_what_it_would_take(seatrial: Command) -> None:
    message = seatrial.refuses("excitation=prbs", "excitation.length_s=1e12")
    assert message.startswith("excitation.length_s: got 1e+12 s, 1e13 samples of 0.1 s, 4e13 ")
    assert " PB; expected at most 1e11 samples of work (limits.samples)" in message


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "identifier=none evaluation=none sample_time_s=2000",
            "excitation=waypoints: got 720 s, 0 samples of sample_time_s=2000; expected at least 4",
        ),
        (
            "excitation=prbs controller=none excitation.length_s=0.3",
            "excitation=prbs: got 0.3 s, 3 samples of sample_time_s=0.1; expected at least 4",
        ),
        (
            "evaluation=square evaluation.duration_s=1e-9",
            "evaluation=square: got 1e-09 s, 0 samples of sample_time_s=0.1; expected at least 4",
        ),
    ],
)
def test_a_mission_without_samples_is_refused(
    arguments: str, message: str, seatrial: Command
) -> None:
    assert seatrial.refuses(*arguments.split()) == message


def test_limits_are_options(seatrial: Command) -> None:
    trial = ("identifier=ls", "dry_run=true")
    assert seatrial(*trial).code == 0
    # 720 s in steps of 0.1 s, for the excitation and two deployments of four steps each.
    assert seatrial(*trial, "limits.samples=86401").code == 0
    assert "(limits.samples)" in seatrial.refuses(*trial, "limits.samples=86399")
    assert "(limits.memory)" in seatrial.refuses(*trial, "limits.memory=0.001")
    assert "must be positive" in seatrial.refuses(*trial, "limits.memory=0")


def test_a_higher_limit_accepts_a_longer_trial(seatrial: Command) -> None:
    long = ("excitation=prbs", "identifier=ls", "controller=none", "dry_run=true")
    long += ("excitation.length_s=1e10",)
    seatrial.refuses(*long)
    assert "limits.memory" in seatrial.refuses(*long, "limits.samples=1e15", "limits.memory=1000")


def test_trials_of_a_sweep_are_counted_before_they_are_listed(seatrial: Command) -> None:
    seatrial.pretend()
    begin = time.process_time()
    message = seatrial.refuses("-m", f"seed=range(0,{BILLION})", "disturbance=calm,noise")
    assert message.startswith("seed: got 1e9 values, 2e9 trials with up to 1.2e10 files; ")
    assert message.endswith("expected at most 1e6 trials (limits.trials)")
    assert time.process_time() - begin < 10.0
    assert "(limits.trials)" in seatrial.refuses("-m", "seed=range(0,9)", "limits.trials=8")
    assert seatrial("-m", "seed=range(0,8)", "limits.trials=8", "dry_run=true").code == 0


def test_trials_of_all_variants_count_together(seatrial: Command) -> None:
    seatrial.pretend()
    sweep = ("-m", "--variant", "plant.scale=0.5", "--variant", "plant.scale=0.6", "dry_run=true")
    message = seatrial.refuses(*sweep, "seed=range(0,5)", "limits.trials=8")
    assert message.startswith("seed: got 5 values, 10 trials")
    assert seatrial(*sweep, "seed=range(0,5)", "limits.trials=10").code == 0
    # The last of two overrides of one option counts.
    assert (
        seatrial("-m", "seed=range(0,9)", "seed=1,2", "limits.trials=2", "dry_run=true").code == 0
    )


def test_limits_do_not_make_another_trial(seatrial: Command) -> None:
    fake = seatrial.pretend()
    seatrial("seed=5")
    assert "already in the logbook as run 1" in seatrial("seed=5", "limits.samples=1e12").out
    assert fake.ran == [5]


def test_demands_add_up_and_the_largest_is_named() -> None:
    parts = [
        Demand("a", 1, "one", 40.0),
        Demand("b", 2, "two", 50.0),
        Demand("c", 3, "three", 20.0),
    ]
    budget.judge(parts[:2], Limits(samples=100.0))
    with pytest.raises(ConfigurationError, match=r"^b: got 2, two, 110 samples of work; "):
        budget.judge(parts, Limits(samples=100.0))
    heavy = Demand("d", 4, "four", 0.0, memory=3e9)
    with pytest.raises(ConfigurationError, match=r"^d: got 4, four, 3 GB; expected at most 2 GB "):
        budget.judge([*parts, heavy], Limits(memory=2.0))


def test_a_file_is_judged_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.truncate(10**12)  # sparse
    demand = budget.file_demand("excitation.path", path)
    with pytest.raises(ConfigurationError, match=r"excitation.path: got .*a file of 1 TB"):
        budget.judge([demand], Limits())


def test_numbers_in_words() -> None:
    assert [amount(n) for n in (7.0, 9999, 1e9, 2.345e13)] == ["7", "9999", "1e9", "2.3e13"]
    sizes = [budget.in_bytes(size) for size in (12.0, 2.3e15, 432e9)]
    assert sizes == ["12 B", "2.3 PB", "432 GB"]
    assert 0.0 < budget.available_bytes() < float("inf")
