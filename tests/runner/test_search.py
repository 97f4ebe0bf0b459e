"""Searches: they find what is known to be best, go on after a kill, and bear what fails."""

import math
import re
import shlex
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from seatrial.models.errors import ConfigurationError, Diverged, LogbookError
from seatrial.runner.compare.__main__ import run as compare
from seatrial.runner.compare.frame import open_results
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.catalogue import all_declared
from seatrial.runner.record.rows import Metric, Results
from seatrial.runner.sweeps.search import Objective, Space
from seatrial.runner.trials import trial as trials
from tests.runner.command import Command
from tests.runner.programs import ended, program

DATABASE = "sqlite:///results/results.db"
SEARCH = ("-m", "hydra/sweeper=optuna")
SPACE = ("controller.kp=[tag(log,interval(20,2000)),550,940]", "seed=range(0,4)")
OPTIMUM = 300.0
Value = Callable[[float, int], float]  # of a gain and a seed


def error(kp: float, seed: int) -> float:
    """A tracking error that is least at OPTIMUM; the seeds shift it."""
    return 1.0 + math.log(kp / OPTIMUM) ** 2 + 0.01 * seed**2


class Fake:
    """Trials that take no time, with known metrics; notes what was run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, value: Value = error) -> None:
        self.ran: list[tuple[float, int]] = []
        self.value = value
        self.stop_after = math.inf
        monkeypatch.setattr(trials, "check", lambda trial: None)
        monkeypatch.setattr(trials, "run", self.run)

    def run(self, trial: Trial) -> Results:
        node: Any = trial.config["controller"]
        kp = float(node["kp"][0])
        if len(self.ran) >= self.stop_after:
            raise KeyboardInterrupt
        self.ran.append((kp, trial.seed))
        place = ("deployment", "identified")
        error = Metric(*place, "position", "e_pos_mae", self.value(kp, trial.seed), "m")
        return Results([error, Metric(*place, "heading", "e_psi_mae", kp / 100.0, "deg")])


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Fake:
    return Fake(monkeypatch)


@pytest.mark.nightly
def test_it_finds_the_known_optimum_and_prunes(
    seatrial: Command, fake: Fake, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second line shows all candidates, the last one repeats the best."""
    answer = seatrial.succeeds(*SEARCH, *SPACE, "search.trials=40", "sweep.name=gains")
    lines = answer.out.splitlines()
    (first,) = [line for line in lines if line.startswith("candidate 1:")]
    assert first == f"candidate 1: median e_pos_mae = {error(100.0, 0) + 0.025:.4g} m"
    assert fake.ran[0][0] == 100.0  # the ferry's own gain
    best = float(lines[-2].split("= ")[1].split()[0])
    assert best == pytest.approx(error(OPTIMUM, 0) + 0.025, abs=0.01)  # median of four seeds
    seeds = Counter(kp for kp, _ in fake.ran)
    stopped = [kp for kp, count in seeds.items() if count < 4]
    kept = [kp for kp, count in seeds.items() if count == 4]
    assert len(seeds) == 40
    assert len(stopped) > 10
    assert min(seeds.values()) == 2  # of one seed nothing is concluded
    assert min(error(kp, 0) for kp in kept) < min(error(kp, 0) for kp in stopped)
    assert f"{len(kept)} complete, {len(stopped)} pruned, 0 infeasible" in answer.out
    with open_results(DATABASE) as results:
        (sweep,) = results.reader.sweeps()
    assert (sweep.name, sweep.planned) == ("gains", len(fake.ran))
    assert sweep.finished_at is not None
    (table,) = [line for line in lines if line.startswith("compare:")]
    assert compare(shlex.split(table)[4:]) == 0
    assert capsys.readouterr().out.count("(n=4)") == len(kept)
    again = seatrial(*shlex.split(lines[-1])[3:])
    assert "4 finished (4 already in the logbook)" in again.out


@pytest.mark.slow
def test_a_search_goes_on_where_it_was_stopped(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    space = (SPACE[0], "seed=0,1")
    words = (*SEARCH, *space, "search.prune=false", "search.startup=3", "search.trials=4")
    whole = Fake(monkeypatch)
    seatrial.succeeds(*words, "results_dir=whole")
    part = Fake(monkeypatch)
    for stop in (1, 5):
        part.stop_after = stop
        assert seatrial(*words).code == 130
    part.stop_after = math.inf
    seatrial.succeeds(*words)
    assert part.ran == whole.ran  # the same trials in the same order, none of them twice
    assert set(Counter(kp for kp, _ in part.ran).values()) == {2}  # nothing is pruned
    longer = seatrial(*words[:-1], "search.trials=5")
    assert part.ran[: len(whole.ran)] == whole.ran
    assert "5 candidates" in longer.out


@pytest.mark.slow
def test_a_search_stops_if_results_cannot_be_stored(
    seatrial: Command, fake: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object) -> None:
        raise LogbookError("the disk is full")

    words = (*SEARCH, *SPACE, "search.trials=2")
    with monkeypatch.context() as patched:
        patched.setattr("seatrial.runner.sweeps.sweep.perform", full)
        answer = seatrial(*words)
    assert answer.code == 2
    assert re.search(r"^seatrial: lost: .*: the disk is full$", answer.err, re.MULTILINE)
    seatrial.succeeds(*words)


@pytest.mark.nightly
def test_what_fails_or_diverges_is_infeasible(seatrial: Command, fake: Fake) -> None:
    def value(kp: float, seed: int) -> float:
        if kp > 250.0 and seed == 1:
            raise Diverged("|r| = 11 rad/s exceeds 10", 3.0, "r")
        if kp < 40.0:
            raise ZeroDivisionError("aground")
        return error(kp, seed)

    fake.value = value
    answer = seatrial.succeeds(*SEARCH, *SPACE, "search.trials=40")
    best = float(re.findall(r"controller.kp=\[([\d.]+)", answer.out)[-1])
    assert 220.0 < best <= 250.0  # the border of what is feasible
    late = [kp for kp, seed in fake.ran if seed == 0][30:]
    assert sum(40.0 <= kp <= 250.0 for kp in late) > len(late) / 2  # it has learnt the border


def test_a_search_that_finds_nothing_feasible(seatrial: Command, fake: Fake) -> None:
    fake.value = lambda kp, seed: 1 / 0
    answer = seatrial(*SEARCH, *SPACE, "search.trials=3")
    assert answer.code == 1
    assert "0 complete, 0 pruned, 3 infeasible" in answer.out
    assert "Traceback" not in answer.out + answer.err


@pytest.mark.slow
def test_several_objectives_have_a_front(seatrial: Command, fake: Fake) -> None:
    """A lower gain turns less, so the front is the gains up to the optimum."""
    words = ("search.metric=e_pos_mae,e_psi_mae:heading", "search.trials=8")
    answer = seatrial.succeeds(*SEARCH, *SPACE, *words, "search.batch=4")
    assert "8 complete, 0 pruned" in answer.out
    gains = sorted({kp for kp, _ in fake.ran})
    nearest = min(gains, key=lambda kp: error(kp, 0))
    best = sorted(map(float, re.findall(r"\n  .*controller.kp=\[([\d.]+)", answer.out)))
    assert best == [kp for kp in gains if kp <= nearest]


def test_what_is_better_is_known_from_the_catalogue() -> None:
    for metric in all_declared():
        dof = next(iter(metric.unit)) if not isinstance(metric.unit, str) else "all"
        words = (f"{metric.name}:{dof}", "auto")
        if metric.better is None:
            with pytest.raises(ConfigurationError, match="expected minimize or maximize"):
                Objective(*words)
        elif isinstance(metric.better, str):
            good, bad = {"lower": (1.0, 2.0), "higher": (2.0, 1.0)}[metric.better]
            assert Objective(*words).loss(good) < Objective(*words).loss(bad), metric.name
        else:
            away = [Objective(*words).loss(metric.better + shift) for shift in (-0.2, 0.0, 0.1)]
            assert sorted(away) == [away[1], away[2], away[0]], metric.name
    maximized = Objective("below_true_model:all", "maximize")
    assert maximized.loss(1.0) < maximized.loss(0.0)
    # Stored by two stages: that of the deployment counts.
    place = ("deployment", "identified", "all", "unreached_share")
    assert Objective("unreached_share:all", "auto").place == place


def test_a_dry_run_shows_the_space(seatrial: Command, fake: Fake) -> None:
    answer = seatrial.succeeds(*SEARCH, *SPACE, "dry_run=true")
    assert SPACE[0] in answer.out
    assert "100 candidates, at most 400 trials" in answer.out
    assert fake.ran == list(seatrial.folder.iterdir()) == []


def test_a_default_that_is_not_in_the_space_is_no_candidate(seatrial: Command, fake: Fake) -> None:
    """The default identifier has no basis; the ferry's own gain is 100."""
    words = ("identifier=ls,ridge", "identifier.basis=physical", "dry_run=true")
    answer = seatrial.succeeds(*SEARCH, *words)
    assert "identifier=ls" in answer.out or "identifier=ridge" in answer.out
    seatrial(*SEARCH, "controller.kp=[interval(20,99),550,940]", "search.trials=1")
    assert 20.0 <= fake.ran[0][0] <= 99.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["seed=0,1"], "hydra/sweeper=optuna: got no option to search"),
        ([*SPACE, "search.metric=e_pos_mea"], "search.metric: got 'e_pos_mea', did you mean"),
        ([*SPACE, "search.metric=force_mse"], "search.metric: got force_mse, expected one of "),
        ([*SPACE, "search.metric=e_pos_mae:surge"], "search.metric: got e_pos_mae:surge, expected"),
        ([*SPACE, "search.metric=below_true_model:all"], "search.direction: below_true_model has "),
        ([*SPACE, "search.metric=[]"], "search.metric: got none, expected at least one"),
        ([*SPACE, "search.stage=validation"], "search.stage is gone: the objective is of "),
        ([*SPACE, "search.statistic=max"], "search.statistic is gone: the objective is the median"),
        ([*SPACE, "search.dof=surge"], "search.dof is gone: write search.metric=name:dof"),
        ([*SPACE, "search.trials=0"], "search.trials must be at least 1, got 0"),
        ([*SPACE, "limits.trials=100"], "search.trials: got 100 values, 400 trials"),
        (["plant.scale=interval(2,1)"], "plant.scale: "),
        ([*SPACE, "--variant", "seed=1", "--variant", "seed=2"], "hydra/sweeper=optuna: got 2 var"),
        (["controller.kp=[range(3,3),2,3]"], "controller.kp[0]: got no values"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    seatrial: Command, fake: Fake, words: list[str], said: str
) -> None:
    assert seatrial.refuses(*SEARCH, *words).startswith(said)
    assert fake.ran == []


def test_without_optuna_it_says_what_to_install(
    seatrial: Command, fake: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("seatrial.runner.sweeps.search.find_spec", lambda name: None)
    said = seatrial.refuses(*SEARCH, *SPACE)
    assert said == "hydra/sweeper=optuna is not installed: pip install 'seatrial[search]'"


def test_a_metric_that_trials_do_not_store_is_named(seatrial: Command, fake: Fake) -> None:
    answer = seatrial(*SEARCH, *SPACE, "search.metric=e_psi_mse")
    assert answer.code == 2
    assert "search.metric: run 1 has no e_psi_mse (deployment, identified, heading)" in answer.err


@pytest.mark.parametrize(
    ("text", "values", "expected"),
    [
        ("a=interval(1,3)", {"a": 1.23456789}, "a=1.23457"),
        ("a=interval(0.98765432,1.23456789)", {"a": 1.23456789}, "a=1.23456789"),  # its end
        *(("a=int(interval(1,9))", {"a": 4}, "a=4"), ("a=x,y", {"a": "y"}, "a=y")),
        ("a=range(0,0.5,0.1)", {"a": 0.4}, "a=0.4"),
        ("a=[interval(1,2),7,choice(x,y)]", {"a[0]": 1.5, "a[2]": "x"}, "a=[1.5,7,x]"),
        ("a={b:interval(1,2),c:null}", {"a.b": 2.0}, "a={b:2.0,c:null}"),
    ],
)
def test_parameters_and_overrides(text: str, values: dict[str, Any], expected: str) -> None:
    space = Space([OverridesParser.create().parse_override(text)])
    assert space.distributions.keys() == values.keys()
    for name, distribution in space.distributions.items():
        assert distribution._contains(distribution.to_internal_repr(values[name]))
    assert space.overrides(values) == [expected]


@pytest.mark.nightly
def test_candidates_side_by_side(tmp_path: Path) -> None:
    """A batch of candidates runs at once in workers, and another start changes nothing."""
    words = (
        "-m", "runner", *SEARCH, "identifier=none", "controller.kp=[interval(50,400),550,940]",
        "seed=0,1", "search.trials=4", "search.batch=2", "hydra/launcher=processes",
    )  # fmt: skip
    code, out, err = ended(program(*words, folder=tmp_path))
    assert code == 0, err
    assert "4 candidates, 4 complete" in out
    again = ended(program(*words, folder=tmp_path))[1]
    assert again.splitlines()[2:] == out.splitlines()[2:]
