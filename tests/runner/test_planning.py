"""Plans of a sweep: what trials share is computed once, and nothing that differs is overlooked."""

import json
from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError
from seatrial.runner import trial as trials
from seatrial.runner.config import Trial
from seatrial.runner.database import Logbook
from seatrial.runner.fingerprint import _plain, fingerprint
from seatrial.runner.job import Order, Plan, prepare
from seatrial.runner.planning import Checks, Planner
from seatrial.runner.record.rows import Results
from seatrial.runner.shared import SharedNodes
from tests.runner.command import Command
from tests.runner.database.samples import make_start
from tests.trials import composed, ordered

JOBS = (
    "seed=1", "seed=2", "plant.scale=2", "sample_time_s=0.2",
    "identifier=ls identifier.lowpass_hz=0.3", "controller=none", "integration_step_s=1", "seed=-1",
    "excitation=prbs", "disturbance=wind", "disturbance=wind disturbance.wind.speed_m_s=-1",
    "seed=1", "identifier=ls identifier.lowpass_hz=90", "seed=2",
)  # fmt: skip


def planned(planner: Planner, order: Order) -> Plan | str:
    try:
        return planner.plan(order)
    except ConfigurationError as error:
        return str(error)


def alone(order: Order) -> str:
    """The fingerprint of an order that is prepared by itself, or its error."""
    try:
        prepare(order)
    except ConfigurationError as error:
        return str(error)
    return order.fingerprint("sources")


def test_a_trial_is_planned_among_others_as_alone() -> None:
    planner = Planner("sources")
    orders = [ordered(*job.split()) for job in JOBS]
    plans = [planned(planner, order) for order in orders]
    said = [plan.fingerprint if isinstance(plan, Plan) else plan for plan in plans]
    assert said == [alone(order) for order in orders]
    assert len({plan for plan in plans if isinstance(plan, str)}) >= 3  # several are refused


def test_a_check_is_repeated_for_what_it_reads_only(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def check(trial: Trial) -> None:
        calls.append((trial.vessel.name, trial.sample_time_s))
        if trial.sample_time_s > 1.0 and trial.seed == 3:
            raise ConfigurationError("slow")

    monkeypatch.setattr(trials, "check", check)
    check_once, first = Checks(), composed()
    for seed in range(5):
        check_once(replace(first, seed=seed))
    assert len(calls) == 1
    slow = replace(first, sample_time_s=2.0)
    for _ in range(2):
        check_once(slow)
        with pytest.raises(ConfigurationError, match="slow"):
            check_once(replace(slow, seed=3))
    assert len(calls) == 3


node = st.dictionaries(st.sampled_from("abc"), st.integers(0, 1) | st.floats(0, 1), max_size=2)


@given(st.dictionaries(st.sampled_from(["excitation", "seed", "x", "é", "database"]), node))
def test_the_text_of_parts_is_the_text_of_the_whole(config: dict[str, Any]) -> None:
    compared: Mapping[str, Any] = {"excitation": None} | config
    compared = {key: value for key, value in compared.items() if key != "database"}
    content = {"config": compared, "names": {"a": "b"}, "sources": "s", "parts": {}}
    text = json.dumps(_plain(content), sort_keys=True, separators=(",", ":"))
    nodes = SharedNodes()
    for given_config in (config, nodes.of(config), nodes.of(config)):
        assert fingerprint(given_config, {"a": "b"}, "s") == sha256(text.encode()).hexdigest()


@given(st.lists(node, max_size=6))
def test_nodes_are_shared_if_they_are_equal_in_types_too(contents: list[dict[str, Any]]) -> None:
    nodes = SharedNodes()
    shared = [nodes.of({"x": content})["x"] for content in contents]
    for one, first in zip(shared, contents, strict=True):
        for other, second in zip(shared, contents, strict=True):
            assert (one is other) == (repr(first) == repr(second))


def test_many_trials_are_looked_up_at_once(tmp_path: Path) -> None:
    with Logbook.open(f"sqlite:///{tmp_path}/results.db", results_dir=tmp_path) as logbook:
        starts = [make_start(seed) for seed in range(3)]
        runs = [logbook.begin_run(start).run_id for start in starts]
        logbook.finish_run(runs[0], Results())
        again = logbook.begin_run(starts[0], rerun=True).run_id
        logbook.finish_run(again, Results())
        unknown = [f"{number:064x}" for number in range(1200)]
        found = logbook.trials([*unknown, *(start.fingerprint for start in starts), *unknown])
        assert {key: run.run_id for key, run in found.items()} == {
            start.fingerprint: logbook.trial(start.fingerprint).run_id  # type: ignore[union-attr]
            for start in starts
        }
        assert found[starts[0].fingerprint].run_id == again


def test_runs_that_are_gone_are_not_taken_over(tmp_path: Path) -> None:
    with Logbook.open(f"sqlite:///{tmp_path}/results.db", results_dir=tmp_path) as logbook:
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
    assert seatrial("-m", "seed=3,1,2", "identifier=none,ls").code == 0
    assert fake.ran == [3, 3, 1, 1, 2, 2]
