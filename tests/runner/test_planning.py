"""Plans of a sweep: what trials share is computed once, and nothing that differs is overlooked."""

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.config import Trial
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Results
from seatrial.runner.sweeps.job import Checked, Order, PlannedTrial, plan_of, prepare
from seatrial.runner.trials import trial as trials
from tests.runner.command import Command
from tests.runner.compare.conftest import logbook as logbook
from tests.runner.database.samples import make_start
from tests.trials import ordered

JOBS = (
    "seed=1", "seed=2", "plant.scale=2", "sample_time_s=0.2",
    "identifier=ls identifier.lowpass_hz=0.3", "controller=none", "integration_step_s=1", "seed=-1",
    "excitation=prbs", "disturbance=wind", "disturbance=wind disturbance.wind.speed_m_s=-1",
    "seed=1", "identifier=ls identifier.lowpass_hz=90", "seed=2",
)  # fmt: skip


def planned(checked: Checked, order: Order) -> PlannedTrial | str:
    try:
        return plan_of(order, "sources", checked)
    except ConfigurationError as error:
        return str(error)


def alone(order: Order) -> str:
    """The fingerprint of an order that is prepared by itself, or its error."""
    try:
        prepare(order)
    except ConfigurationError as error:
        return str(error)
    return order.fingerprints("sources")[0]


def test_a_trial_is_planned_among_others_as_alone() -> None:
    checked = Checked()
    orders = [ordered(*job.split()) for job in JOBS]
    plans = [planned(checked, order) for order in orders]
    said = [plan.fingerprint if isinstance(plan, PlannedTrial) else plan for plan in plans]
    assert said == [alone(order) for order in orders]
    assert len({plan for plan in plans if isinstance(plan, str)}) >= 3  # several are refused


@pytest.mark.slow
def test_the_replicates_of_an_experiment_are_checked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def check(trial: Trial) -> None:
        calls.append(trial.sample_time_s)
        if trial.limits.samples < 10.0:
            raise ConfigurationError("slow")

    monkeypatch.setattr(trials, "check", check)
    checked = Checked()
    said = [
        planned(checked, ordered(f"seed={seed}", *others))
        for others in ([], ["sample_time_s=0.2"], ["limits.samples=1"])
        for seed in range(3)
    ]
    assert calls == [0.1, 0.2, 0.1]
    assert len({plan.fingerprint for plan in said if isinstance(plan, PlannedTrial)}) == 6
    assert said[6:] == ["slow"] * 3


def test_many_trials_are_looked_up_at_once(logbook: LogbookWriter) -> None:
    starts = [make_start(seed) for seed in range(3)]
    runs = [logbook.begin_run(start).run_id for start in starts]
    logbook.finish_run(runs[0], Results())
    again = logbook.begin_run(starts[0], rerun=True).run_id
    logbook.finish_run(again, Results())
    unknown = [f"{number:064x}" for number in range(1200)]
    found = logbook.trials([*unknown, *(start.fingerprint for start in starts), *unknown])
    assert found.keys() == {start.fingerprint for start in starts}
    assert found[starts[0].fingerprint].run_id == again


def test_runs_that_are_gone_are_not_taken_over(logbook: LogbookWriter) -> None:
    done, running = (logbook.begin_run(make_start(seed)).run_id for seed in range(2))
    logbook.finish_run(done, Results())
    sweep = logbook.begin_sweep("sweep", "command", [], 3)
    assert logbook.reuse(sweep, [done, running, 77]) == {done}
    assert logbook.reuse(sweep, [done]) == {done}
    assert logbook.sweep_status(sweep).reused == 1


def test_the_order_of_a_sweep_does_not_depend_on_its_choices(seatrial: Command) -> None:
    fake = seatrial.pretend()
    jobs = [f"seed={seed} identifier={name}" for seed in (3, 1, 2) for name in ("none", "ls")]
    answer = seatrial("-m", "seed=3,1,2", "identifier=none,ls", "dry_run=true")
    assert [line.removeprefix("new").strip() for line in answer.out.splitlines()[:-1]] == jobs
    seatrial.succeeds("-m", "seed=3,1,2", "identifier=none,ls")
    assert fake.ran == [3, 3, 1, 1, 2, 2]
