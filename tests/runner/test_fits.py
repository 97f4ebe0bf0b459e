"""`seatrial fits`: what a vessel can have is what is planned, with the reasons for the rest."""

import re
from collections.abc import Sequence

import pytest

from seatrial.runner.commands import fits
from seatrial.runner.sweeps import in_process
from seatrial.runner.sweeps.job import shown
from tests.runner.command import Command

WORDS = ("fits", "vessel=surge_linear", "excitation=prbs", "identifier=ls")


def test_what_fits_is_planned_and_the_rest_has_a_reason(seatrial: Command) -> None:
    answer = seatrial(*WORDS, "controller=none", "database=sqlite")
    assert answer.code == 0, answer
    text = re.sub(r"\s+", " ", answer.out)
    fitting = text.partition("evaluation ")[2].partition(" not ")[0].split(", ")
    assert {"none", "replay"} <= set(fitting)
    assert "not operation: " in text
    for name in fitting:
        planned = seatrial(*WORDS[1:], "controller=none", f"evaluation={name}", "dry_run=true")
        assert planned.out.startswith("new"), (name, planned)
    assert list(seatrial.folder.iterdir()) == []


def test_a_word_that_is_no_choice_is_one_line(seatrial: Command) -> None:
    said = seatrial.refuses("fits", "kvlcc2")
    assert said == "fits: got 'kvlcc2', expected vessel=NAME or GROUP=OPTION"
    several = seatrial.refuses("fits", "vessel=kvlcc2", "controller=autopilot,none")
    assert several.startswith("fits: got 'controller=autopilot,none', expected vessel=NAME or")
    assert "vessel" in seatrial.refuses("fits", "vessel=tugg", "excitation=prbs")


def test_stored_trials_fit_and_vessels_that_can_have_the_same_are_shown_together(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run_sweep(listing: fits._Listing, words: Sequence[str]) -> None:
        trials = [shown(variant) for variant in listing.variants]
        assert all("excitation=prbs evaluation=none" in trial for trial in trials)
        states = ["refused"] * (2 if "vessel=otter" in trials[0] else 1) + ["finished"] * 99
        listing.list_trials([*zip(states, trials, "x" * len(trials), strict=False)])

    monkeypatch.setattr(in_process, "run_sweep", run_sweep)
    fits.main(["vessel=osv,otter,frigate", "excitation=prbs", "evaluation=none"])
    groups = capsys.readouterr().out.split("\n\n")
    assert [group.partition("\n")[0] for group in groups] == ["osv, frigate", "otter"]
