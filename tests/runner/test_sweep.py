"""Sweeps: checked as a whole, run once, resumed, summed up; options that change together."""

from pathlib import Path
from typing import Any

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.records import RunSummary
from tests.runner.command import Command

DATABASE = "sqlite:///results/results.db"


def runs() -> list[RunSummary]:
    with LogbookWriter.read(DATABASE) as logbook:
        return logbook.runs()


def test_all_combinations_are_run(seatrial: Command) -> None:
    fake = seatrial.pretend()
    answer = seatrial.succeeds("-m", "identifier=none,ls", "seed=range(0,3)")
    assert sorted(fake.ran) == [0, 0, 1, 1, 2, 2]
    assert {(run.identifier, run.seed, run.status, run.sweep_id) for run in runs()} == {
        (name, seed, "finished", 1) for name in ("none", "ls") for seed in range(3)
    }
    assert answer.out.splitlines() == [
        "sweep 1, 6 runs: 6 finished, 0 failed, 0 diverged",
        "results: sqlite:///results/results.db",
        "compare: python -m runner.compare table --rows identifier --sweep 1",
    ]


def test_only_what_is_missing_is_run_again(seatrial: Command) -> None:
    fake = seatrial.pretend()
    fake.failing = {1}
    assert seatrial("-m", "seed=0,1").code == 1
    fake.failing, fake.ran = set(), []
    answer = seatrial.succeeds("-m", "seed=0,1,2")
    assert sorted(fake.ran) == [1, 2]
    assert "seed=0: already in the logbook as run 1" in answer.err
    assert "sweep 2, 3 runs: 3 finished (1 already in the logbook), 0 failed" in answer.out
    fake.ran = []
    assert "3 finished (3 already in the logbook)" in seatrial("-m", "seed=0,1,2").out
    assert fake.ran == []
    seatrial.succeeds("-m", "seed=0,1", "rerun=true")
    assert fake.ran == [0, 1]


def test_a_failure_does_not_end_the_sweep(seatrial: Command) -> None:
    fake = seatrial.pretend()
    fake.failing, fake.diverging = {1, 3}, {2}
    answer = seatrial("-m", "seed=range(0,5)")
    assert answer.code == 1
    assert sorted(fake.ran) == [0, 1, 2, 3, 4]
    assert "sweep 1, 5 runs: 2 finished, 2 failed, 1 diverged" in answer.out
    for run, status, why in (
        (2, "failed", "ZeroDivisionError: seed 1 ran aground"),
        (3, "diverged", "Diverged: |r| = 11 rad/s exceeds 10 at t = 3.0 s"),
        (4, "failed", "ZeroDivisionError: seed 3 ran aground"),
    ):
        assert f"run {run} {status} (vessel=milliampere " in answer.out
        assert why in answer.out
    assert "Traceback" not in answer.err + answer.out


def test_one_bad_trial_stops_the_sweep_before_it_starts(seatrial: Command) -> None:
    fake = seatrial.pretend()
    fake.refused = {3}
    said = seatrial.refuses("-m", "plant.scale=1,2,3")
    assert said == "plant.scale=3: plant.scale: 3 is not seaworthy"
    fake.refused = {2, 3}
    said = seatrial.refuses("-m", "plant.scale=1,2,3")
    assert said.startswith("plant.scale=2: plant.scale: 2 is not seaworthy (and 1 more: dry_run")
    said = seatrial.refuses("-m", "identifier=ls,foo", "seed=0")
    assert said.startswith("identifier=foo seed=0: identifier: no option 'foo', expected one of")
    assert fake.ran == []


def test_a_sweep_over_no_values_is_refused(seatrial: Command) -> None:
    seatrial.pretend()
    for option in ("seed=glob(*)", "seed=range(3,3)"):
        assert seatrial.refuses("-m", option).startswith(f"{option}: got no values that can be")


def test_the_same_trial_twice_is_one_run(seatrial: Command) -> None:
    fake = seatrial.pretend()
    answer = seatrial("-m", "plant.scale=1,1.0,1")
    assert (answer.code, fake.ran) == (0, [0])
    assert "sweep 1, 1 run: 1 finished" in answer.out


def test_one_sweep_has_one_logbook(seatrial: Command) -> None:
    seatrial.pretend()
    said = seatrial.refuses("-m", "results_dir=a,b")
    assert said == "database.url, results_dir: got 2 logbooks in one sweep, expected one"


def test_a_dry_run_lists_every_trial(seatrial: Command) -> None:
    fake = seatrial.pretend()
    fake.failing = {1}
    seatrial("-m", "seed=0,1", "plant.scale=1")
    fake.ran, fake.refused = [], {3}
    answer = seatrial.succeeds("-m", "seed=0,1,2", "plant.scale=1,3", "dry_run=true")
    assert answer.out.splitlines() == [
        "finished     seed=0 plant.scale=1  run 1",
        "refused      seed=0 plant.scale=3  plant.scale: 3 is not seaworthy",
        "failed       seed=1 plant.scale=1  run 2: seed 1 ran aground",
        "refused      seed=1 plant.scale=3  plant.scale: 3 is not seaworthy",
        "new          seed=2 plant.scale=1",
        "refused      seed=2 plant.scale=3  plant.scale: 3 is not seaworthy",
        "6 trials: 1 finished, 3 refused, 1 failed, 1 new; nothing was run",
    ]
    assert fake.ran == []
    assert len(runs()) == 2


@pytest.mark.parametrize("spelling", ["+dry_run=true", "++dry_run=True", "dry_run=yes"])
def test_a_dry_run_of_any_spelling_runs_nothing(seatrial: Command, spelling: str) -> None:
    fake = seatrial.pretend()
    seatrial("-m", "seed=0,1", spelling)
    seatrial("seed=3", spelling)
    assert fake.ran == list(seatrial.folder.iterdir()) == []


def test_an_interrupted_sweep_is_taken_up_again(seatrial: Command) -> None:
    fake = seatrial.pretend()
    fake.interrupted = {2}
    answer = seatrial("-m", "seed=range(0,5)")
    assert answer.code == 130
    assert answer.err.splitlines()[-1].startswith("seatrial: interrupted")
    assert [run.status for run in runs()] == ["finished", "finished", "interrupted"]
    fake.interrupted, fake.ran = set(), []
    seatrial.succeeds("-m", "seed=range(0,5)")
    assert fake.ran == [2, 3, 4]


def test_what_the_logbook_cannot_take_is_lost_and_said(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    seatrial.pretend()

    def full(self: LogbookWriter, *_: Any, **__: Any) -> None:
        raise LogbookError("results.db: database or disk is full")

    monkeypatch.setattr(LogbookWriter, "finish_run", full)
    answer = seatrial("-m", "seed=0,1")
    assert answer.code == 1
    assert "2 not done" in answer.out
    assert "  lost: seed=0: results.db: database or disk is full" in answer.out
    assert seatrial("seed=0").code == 2


def test_a_bug_is_not_hidden(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    seatrial.pretend()

    def bug(self: LogbookWriter, *_: Any, **__: Any) -> None:
        raise AssertionError("a bug")

    monkeypatch.setattr(LogbookWriter, "begin_run", bug)
    with pytest.raises(RuntimeError, match="AssertionError: a bug"):
        seatrial("-m", "seed=0,1")


def test_after_a_sweep_the_database_file_alone_is_whole(seatrial: Command, tmp_path: Path) -> None:
    seatrial.pretend()
    seatrial.succeeds("-m", "seed=0,1")
    with LogbookWriter.read(DATABASE) as reader:  # so the sweep is not the last to close the file
        reader.runs()
        seatrial.succeeds("-m", "seed=2,3")
        assert Path("results/results.db-wal").stat().st_size == 0
        copy = tmp_path / "copy.db"
        copy.write_bytes(Path("results/results.db").read_bytes())
    with LogbookWriter.read(f"sqlite:///{copy}") as logbook:
        assert [run.status for run in logbook.runs()] == ["finished"] * 4
        assert [sweep.finished_at is not None for sweep in logbook.sweeps()] == [True, True]


def trials(seatrial: Command, *arguments: str) -> list[str]:
    """The trials of a dry run, as their overrides."""
    answer = seatrial.succeeds("-m", *arguments, "evaluation=none", "dry_run=true")
    lines = [line for line in answer.out.splitlines() if line.startswith("new ")]
    return [" ".join(line.split()[1:]).replace(" evaluation=none", "") for line in lines]


def test_an_option_is_left_out_where_a_choice_does_not_have_it(seatrial: Command) -> None:
    assert trials(seatrial, "identifier=none,ls", "identifier.basis=physical,full") == [
        "identifier=none",
        "identifier=ls identifier.basis=physical",
        "identifier=ls identifier.basis=full",
    ]
    # nor does the default
    seeds = ("identifier=none,plsr", "identifier.bootstrap=null", "seed=1,2")
    choices = ("identifier=none", "identifier.bootstrap=null identifier=plsr")
    assert trials(seatrial, *seeds) == [f"{one} seed={n}" for one in choices for n in (1, 2)]


def test_an_option_that_no_choice_has_is_refused(seatrial: Command) -> None:
    said = seatrial.refuses("-m", "identifier=none,ls", "identifier.bases=physical")
    assert "identifier.bases" in said
    said = seatrial.refuses("-m", "identifier=none", "identifier.basis=physical", "seed=1,2")
    assert "basis" in said


def test_variants_change_options_together(seatrial: Command) -> None:
    variants = ("--variant", "identifier=ls identifier.basis=physical", "--variant=identifier=none")
    choices = ("identifier=ls identifier.basis=physical", "identifier=none")
    expected = [f"{one} seed={n}" for one in choices for n in (1, 2)]
    assert trials(seatrial, *variants, "seed=1,2") == expected
    assert trials(seatrial, "--variant", "identifier=ls,none disturbance='[wind,noise]'") == [
        f"identifier={name} disturbance=[wind,noise]" for name in ("ls", "none")
    ]


def test_a_wrong_variant_is_refused(seatrial: Command) -> None:
    for arguments, message in (
        (["-m", "--variant"], "--variant: expected a value"),
        (["-m", "--variant", "identifier"], "--variant: got 'identifier', expected"),
        (
            ["-m", "--variant", "identifier='ls"],
            '--variant: got "identifier=\'ls", which cannot be read',
        ),
        (["--variant", "identifier=ls"], "--variant: got one trial, expected a sweep (-m)"),
    ):
        assert seatrial.refuses(*arguments).startswith(message)
