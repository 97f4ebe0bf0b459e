"""`seatrial next`: its YAML sails what its sheet says; `seatrial fits`: planned, or why not."""

import json
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.excitation.helm_sequence import HelmSequence
from seatrial.models.identification.next_experiment import ranked
from seatrial.runner.commands.fits import fits_of
from seatrial.runner.commands.next import Planner, nominal, purpose_of
from tests.runner.command import Command
from tests.trials import options

SQUARE = '{"type": "Polygon", "coordinates": [[[0,0],[%s,0],[%s,%s],[0,%s],[0,0]]]}'
OTTER = ("next", "--vessel", "otter", "--database", "sqlite:///none.db")


def _area(folder: Path, side: float) -> Path:
    path = folder / "area.geojson"
    path.write_text(SQUARE.replace("%s", f"{side:g}"))
    return path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--for", "advance"), "next: --for advance: expected PURPOSE=WIDTH"),
        (("--for", "advance=0%"), "next: --for advance=0%: expected PURPOSE=WIDTH"),
        (("--for", "FIT=2", "--start", "1,2"), "next: --start 1,2: expected 3 numbers"),
        (("--for", "FIT=2", "--after", "1"), "next: expected --after RUNS, or --vessel NAME"),
        (("--for", "FIT=2", "--area", "none.geojson"), "none.geojson: cannot be read"),
        (("--for", "FIT=2", "--doubt", "2"), "next: expected --after RUNS, or --vessel"),
    ],
)
def test_words_that_are_wrong_are_one_line(
    seatrial: Command, words: tuple[str, ...], said: str
) -> None:
    assert seatrial.refuses(*OTTER, *words).startswith(said)


@pytest.mark.slow
def test_what_cannot_be_sailed_or_predicted_is_one_line(
    seatrial: Command, tmp_path_factory: pytest.TempPathFactory
) -> None:
    said = seatrial.refuses(*OTTER, "--for", "head_reach=3%")
    assert said.startswith(
        "next: otter has no measure head_reach, expected one of coefficients, FIT"
    )
    assert "tactical_diameter" in said
    said = seatrial.refuses(*OTTER, "--for", "e_pos=5%")
    assert said == "next: e_pos needs --after RUNS, the last with a controller"
    area = str(_area(tmp_path_factory.mktemp("area"), 6.0))
    said = seatrial.refuses(*OTTER, "--for", "FIT=2", "--area", area, "--start", "3,3,0")
    assert said.startswith("next: area: no turning circle fits")
    said = seatrial.refuses(*OTTER, "--for", "FIT=2", "--minutes", "0.1")
    assert re.match(r"next: none of \d+ manoeuvres fits into 0.1 min", said)


def test_runs_of_two_vessels_are_one_line(seatrial: Command) -> None:
    for vessel in ("milliampere", "modulus_ship"):
        seatrial.succeeds(f"vessel={vessel}", "identifier=none", "evaluation=none")
    said = seatrial.refuses("next", "--after", "1,2", "--for", "FIT=2%")
    assert said == "next: runs 1,2 are of milliampere and modulus_ship, expected one vessel"


@pytest.mark.slow
def test_the_sheet_stays_in_its_area_and_time_and_its_yaml_sails_it(seatrial: Command) -> None:
    side = 60.0
    words = f"--area {_area(Path(), side)} --start 30,30,90 --minutes 3 --clearance 2"
    answer = seatrial.succeeds(*OTTER, "--for", "coefficients=1%", *words.split())
    assert "1 % is not reached in 3 min: the best that was found is" in answer.out
    before, after = (float(n) for n in re.findall(r"± ([\d.]+) %", answer.out))
    assert after < before
    folder = Path("results/next")
    track = np.array(json.loads((folder / "track.geojson").read_text())["coordinates"])
    assert np.all((track >= 2.0) & (track <= side - 2.0))
    assert len(track) <= 181  # one a second
    assert np.hypot(*(track[-1] - track[0])) < 10.0
    seatrial.succeeds(
        "vessel=otter", f"excitation={folder}/excitation.yaml", "identifier=none",
        "controller=none", "evaluation=none",
    )  # fmt: skip


@pytest.mark.nightly
def test_what_came_is_of_the_size_that_was_expected(seatrial: Command) -> None:
    seatrial.succeeds("next", "--vessel", "kvlcc2", "--for", "tactical_diameter=2%")
    seatrial.succeeds(
        "vessel=kvlcc2", "excitation=results/next/excitation.yaml", "disturbance=noise",
        "identifier=robust", "model_error=false", "controller=none", "evaluation=none",
    )  # fmt: skip
    after = seatrial("next", "--after", "1", "--for", "tactical_diameter=9%")
    found = re.search(r"expected ± ([\d.]+) %, came ± ([\d.]+) %", after.out)
    assert found is not None, after
    assert 0.2 < float(found[2]) / float(found[1]) < 5.0


# What a vessel can have is what is planned, with the reasons for the rest.
WORDS = ("fits", "vessel=surge_linear", "excitation=prbs", "identifier=ls")


def test_what_fits_is_planned_and_the_rest_has_a_reason(seatrial: Command) -> None:
    answer = seatrial.succeeds(*WORDS, "controller=none", "database=sqlite")
    text = re.sub(r"\s+", " ", answer.out)
    fitting = text.partition("evaluation ")[2].partition(" not ")[0].split(", ")
    assert {"none", "replay"} <= set(fitting)
    assert "not operation: " in text
    for name in fitting:
        planned = seatrial(*WORDS[1:], "controller=none", f"evaluation={name}", "dry_run=true")
        assert planned.out.startswith("new"), (name, planned)
    assert list(seatrial.folder.iterdir()) == []


def test_a_word_that_is_no_choice_is_one_line(seatrial: Command) -> None:
    for word in ("kvlcc2", "vesel=kvlcc2", "--vessel=kvlcc2"):
        said = seatrial.refuses("fits", word)
        assert said.startswith(f"fits: got {word!r}, did you mean vessel=kvlcc2? expected vessel=")
    several = seatrial.refuses("fits", "vessel=kvlcc2", "controller=autopilot,none")
    assert several.startswith("fits: got 'controller=autopilot,none', did you mean")
    assert "vessel" in seatrial.refuses("fits", "vessel=tugg", "excitation=prbs")
    chosen = ("vessel=otter", "excitation=prbs", "controller=none", "evaluation=none")
    said = seatrial.refuses("fits", *chosen, "identifier=ls")
    assert said.startswith("fits: got a choice of each group")


def test_what_fits_is_what_a_sweep_plans(seatrial: Command) -> None:
    """The excitation follows a controller, and the controller an excitation."""
    given = ("identifier=none", "evaluation=none")
    answer = seatrial.succeeds("fits", "vessel=blueboat,osv,otter", *given, "controller=none")
    assert "2 of 3: osv" in answer.err
    heads = [part.partition("\n")[0] for part in answer.out.split("\n\n")]
    assert heads == ["blueboat, otter", "osv"]  # vessels that can have the same are together
    fits = fits_of(["osv", "otter"], {"identifier": "none", "evaluation": "none"})
    for group in ("excitation", "controller"):
        names = ",".join(options(group))
        words = ("-m", "vessel=osv,otter", f"{group}={names}", *given, "dry_run=true")
        lines = [line.split() for line in seatrial(*words).out.splitlines()]
        for state, vessel, choice, *_ in (line for line in lines if line[0] in ("new", "refused")):
            name, is_new = choice.partition("=")[2], state == "new"
            assert (fits[vessel.partition("=")[2]][group][name] == "") == is_new, (vessel, choice)


@pytest.mark.nightly
def test_two_hundred_candidates_are_ranked_in_30_seconds() -> None:
    """Of a rudder ship, with the gradient of the purpose, by one process."""
    begin, known = time.process_time(), nominal("kvlcc2", 0.2)
    family = known.trial.excitation
    assert isinstance(family, HelmSequence)
    size = tuple(np.setdiff1d(np.linspace(-1.0, 1.0, 13), [0.0]).tolist())
    varied = replace(family, variants={"size": size, "slowness": (1.0, 2.0, 3.0)})
    known = replace(known, trial=replace(known.trial, excitation=varied))
    purpose = purpose_of(known, "tactical_diameter")
    candidates = Planner(known, None, (0.0, 0.0, 0.0), 900.0).candidates
    told = np.array([each.information for each in candidates])
    seconds = np.array([each.seconds for each in candidates])
    order = ranked(purpose, np.zeros_like(told[0]), told, seconds, 1.0)
    assert len(order) >= 200
    assert time.process_time() - begin < 30.0
