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

from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.runner import search_space
from seatrial.runner import trial as trials
from seatrial.runner.compare.plots import draw
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.results import open_results
from seatrial.runner.compare.search_candidates import candidates, front, objectives_in, search_sweep
from seatrial.runner.config import Trial
from seatrial.runner.database import Logbook
from seatrial.runner.record.rows import Metric, Results
from tests.runner.command import Command
from tests.runner.programs import ended, finished, program, rows, wait

pytest.importorskip("optuna")
DATABASE = "sqlite:///results/results.db"
SEARCH = ("-m", "hydra/sweeper=optuna")
SPACE = ("controller.kp=[tag(log,interval(20,2000)),550,940]", "seed=range(0,4)")
OPTIMUM = 300.0
Value = Callable[[float, int], float]  # of a gain and a seed


def error(kp: float, seed: int) -> float:
    """A tracking error that is least at OPTIMUM; the seeds shift it."""
    return 1.0 + math.log(kp / OPTIMUM) ** 2 + 0.01 * seed


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
        value = self.value(kp, trial.seed)
        return Results(
            metrics=[
                Metric("deployment", "identified", "position", "e_pos_mae", value, "m"),
                Metric("deployment", "identified", "heading", "e_psi_mae", kp / 100.0, "deg"),
            ]
        )


def numbers(line: str) -> list[float]:
    return [float(text) for text in re.findall(r"= (\d\S*)", line)]


def line_of(out: str, start: str) -> str:
    (line,) = [line for line in out.splitlines() if line.startswith(start)]
    return line


@pytest.mark.slow
def test_it_finds_the_known_optimum(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = Fake(monkeypatch)
    answer = seatrial(*SEARCH, *SPACE, "search.trials=40")
    assert answer.code == 0, answer
    best = numbers(line_of(answer.out, "best:"))[0]
    assert best == pytest.approx(error(OPTIMUM, 0) + 0.015, abs=0.01)  # the median of four seeds
    assert fake.ran[0][0] == 100.0  # the ferry's own gain first
    assert numbers(line_of(answer.out, "candidate 1:"))[0] == pytest.approx(
        error(100.0, 0) + 0.015, rel=1e-3
    )
    assert len({kp for kp, _ in fake.ran}) == 40


def test_the_command_of_the_best_repeats_it(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = Fake(monkeypatch)
    out = seatrial(*SEARCH, *SPACE, "search.trials=12").out.splitlines()
    (i,) = [i for i, line in enumerate(out) if line.startswith("best:")]
    before = len(fake.ran)
    again = seatrial(*shlex.split(out[i + 1])[3:])
    assert len(fake.ran) == before
    assert "4 finished (4 already in the logbook)" in again.out


@pytest.mark.slow
def test_a_search_goes_on_where_it_was_stopped(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = (*SEARCH, *SPACE, "search.trials=30")
    whole = Fake(monkeypatch)
    assert seatrial(*words, "results_dir=whole").code == 0
    part = Fake(monkeypatch)
    for stop in (1, 17, 50):
        part.stop_after = stop
        assert seatrial(*words).code == 130
    part.stop_after = math.inf
    answer = seatrial(*words)
    assert answer.code == 0
    assert part.ran == whole.ran  # the same trials in the same order, none of them twice
    assert max(Counter(part.ran).values()) == 1
    longer = seatrial(*words[:-1], "search.trials=35")
    assert part.ran[: len(whole.ran)] == whole.ran
    assert "35 candidates" in longer.out


@pytest.mark.slow
def test_bad_candidates_are_stopped_after_some_seeds(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = Fake(monkeypatch)
    out = seatrial(*SEARCH, *SPACE, "search.trials=40").out
    sailed = Counter(kp for kp, _ in fake.ran)
    stopped = [kp for kp, seeds in sailed.items() if seeds < 4]
    kept = [kp for kp, seeds in sailed.items() if seeds == 4]
    assert len(stopped) > 10
    assert min(sailed.values()) == 2  # of one seed nothing is concluded
    assert min(error(kp, 0) for kp in kept) < min(error(kp, 0) for kp in stopped)
    assert f"{len(kept)} complete, {len(stopped)} pruned, 0 infeasible" in out
    free = Fake(monkeypatch)
    seatrial(*SEARCH, *SPACE, "search.trials=20", "search.prune=false", "results_dir=free")
    assert set(Counter(kp for kp, _ in free.ran).values()) == {4}


@pytest.mark.slow
def test_what_fails_or_diverges_is_infeasible(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def value(kp: float, seed: int) -> float:
        if kp > 250.0 and seed == 1:
            raise Diverged("|r| = 11 rad/s exceeds 10", 3.0, "r")
        if kp < 40.0:
            raise ZeroDivisionError("aground")
        return error(kp, seed)

    fake = Fake(monkeypatch, value)
    answer = seatrial(*SEARCH, *SPACE, "search.trials=40")
    assert answer.code == 0
    best = float(re.findall(r"controller.kp=\[([\d.]+)", answer.out)[-1])
    assert 220.0 < best <= 250.0  # the border of what is feasible
    late = [kp for kp, seed in fake.ran if seed == 0][30:]
    assert sum(40.0 <= kp <= 250.0 for kp in late) > len(late) / 2  # it has learnt the border
    fake.value = lambda kp, seed: 1 / 0
    answer = seatrial(*SEARCH, *SPACE, "search.trials=3", "results_dir=other")
    assert answer.code == 1
    assert "0 complete, 0 pruned, 3 infeasible" in answer.out
    assert "Traceback" not in answer.out + answer.err


@pytest.mark.slow
def test_several_objectives_have_a_front(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fake(monkeypatch)
    words = (
        "search.metric=e_pos_mae,e_psi_mae:heading",
        "search.trials=25",
        "search.statistic=mean",
    )
    answer = seatrial(*SEARCH, *SPACE, *words)
    assert answer.code == 0
    with open_results(DATABASE) as results:
        sweep = search_sweep(results, None)
        objectives = objectives_in(sweep.overrides)
        found = candidates(results, sweep, objectives)
        best = front(found, objectives)
        (path, _) = draw("search", results, PlotRequest(), Path("figures"))
    assert path.exists()
    assert len(found) == 25
    assert {len(one.runs) for one in found} == {4}  # nothing is pruned
    assert len(best) == answer.out.count("best: ")
    # A lower gain turns less, so the front is the gains up to the optimum.
    gains = sorted(one.values[1] * 100.0 for one in best)
    feasible = sorted(one.values[1] * 100.0 for one in found)
    nearest = min(feasible, key=lambda kp: error(kp, 0))
    assert gains == [kp for kp in feasible if kp <= nearest]


def test_higher_and_target_are_known_from_the_catalogue() -> None:
    from seatrial.runner.compare.search_candidates import objective_of
    from seatrial.runner.record.catalogue import all_declared

    for metric in all_declared():
        dof = next(iter(metric.unit)) if not isinstance(metric.unit, str) else "all"
        if metric.better is None:
            with pytest.raises(ConfigurationError, match="expected minimize or maximize"):
                objective_of(metric.name, dof, None, "identified", "median", "auto")
            continue
        one = objective_of(metric.name, dof, None, "identified", "median", "auto")
        if isinstance(metric.better, str):
            good, bad = {"lower": (1.0, 2.0), "higher": (2.0, 1.0)}[metric.better]
            assert one.loss(good) < one.loss(bad), metric.name
        else:
            away = [one.loss(metric.better + shift) for shift in (-0.2, 0.0, 0.1)]
            assert sorted(away) == [away[1], away[2], away[0]], metric.name


@pytest.mark.slow
def test_the_figure_shows_the_best_so_far(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fake(monkeypatch)
    seatrial(*SEARCH, *SPACE, "search.trials=30")
    from seatrial.runner.compare.figures import drawings_of
    from seatrial.runner.compare.plots.style import drawn

    with open_results(DATABASE) as results, drawn():
        (drawing,) = drawings_of("search")(results, PlotRequest())
        found = candidates(results, search_sweep(results, "1"), objectives_in(
            search_sweep(results, "1").overrides))  # fmt: skip
        lines = {str(line.get_label()): line for line in drawing.figure.axes[0].lines}
    best = [float(y) for y in lines["best so far"].get_ydata()]  # type: ignore[union-attr]
    complete = [one.values[0] for one in found if one.state == "complete"]
    assert best == sorted(best, reverse=True)
    assert best[-1] == min(complete)
    assert len(lines["complete"].get_ydata()) == len(complete)  # type: ignore[arg-type]
    with open_results(DATABASE) as results, pytest.raises(ConfigurationError, match="is none"):
        draw("search", results, PlotRequest(sweep="7"), Path("figures"))


@pytest.mark.slow
def test_the_sweep_of_a_search_is_over_when_it_ends(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = Fake(monkeypatch)
    seatrial(*SEARCH, *SPACE, "search.trials=20", "sweep.name=gains")
    with Logbook.read(DATABASE) as logbook:
        (sweep,) = logbook.sweeps()
    assert (sweep.name, sweep.planned) == ("gains", len(fake.ran))
    assert sweep.finished_at is not None


def test_a_dry_run_shows_the_space(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = Fake(monkeypatch)
    answer = seatrial(*SEARCH, *SPACE, "dry_run=true")
    assert answer.code == 0
    assert "controller.kp[0]: 20 to 2000, logarithmic" in answer.out
    assert "100 candidates, at most 400 trials" in answer.out
    assert fake.ran == []
    assert list(seatrial.folder.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["seed=0,1"], "hydra/sweeper=optuna: got no option to search"),
        ([*SPACE, "search.metric=e_pos_mea"], "search.metric: got 'e_pos_mea', did you mean"),
        ([*SPACE, "search.metric=force_mse"], "search.dof: got None for force_mse, expected "),
        ([*SPACE, "search.statistic=mode"], "search.statistic: got 'mode', expected mean"),
        ([*SPACE, "search.trials=0"], "search.trials must be at least 1, got 0"),
        ([*SPACE, "search.bogus=1"], "search.bogus: unknown option"),
        ([*SPACE, "limits.trials=100"], "search.trials: got 100 values, 400 trials"),
        (["plant.scale=interval(2,1)"], "plant.scale: "),
        ([*SPACE, "--variant", "seed=1", "--variant", "seed=2"], "hydra/sweeper=optuna: got 2 var"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    fake = Fake(monkeypatch)
    assert seatrial.refuses(*SEARCH, *words).startswith(said)
    assert fake.ran == []


def test_a_grid_has_no_values_inside_of_lists(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fake(monkeypatch)
    said = seatrial.refuses("-m", "controller.kp=[interval(1,2),2,3]")
    assert "or a search (hydra/sweeper=optuna)" in said


def test_without_optuna_it_says_what_to_install(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fake(monkeypatch)
    monkeypatch.setattr("seatrial.runner.search.find_spec", lambda name: None)
    said = seatrial.refuses(*SEARCH, *SPACE)
    assert said == "hydra/sweeper=optuna is not installed: pip install 'seatrial[search]'"


def test_without_optuna_nothing_hangs(tmp_path: Path) -> None:
    """A lazily loaded module that is lacking would import everything else in its place."""
    code = (
        "import sys, importlib.abc\n"
        "class Lacking(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name.partition('.')[0] == 'optuna':\n"
        "            raise ModuleNotFoundError(name)\n"
        "sys.meta_path.insert(0, Lacking())\n"
        "sys.argv = ['seatrial', 'seed=1', 'dry_run=true']\n"
        "from seatrial.runner.__main__ import main\n"
        "sys.exit(main())\n"
    )
    status, out, err = ended(program("-c", code, folder=tmp_path))
    assert (status, err) == (0, "")
    assert "1 trial: 1 new" in out


def test_a_metric_that_trials_do_not_store_is_named(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    Fake(monkeypatch)
    answer = seatrial(*SEARCH, *SPACE, "search.metric=e_psi_mse")
    assert answer.code == 2
    assert "search.metric: run 1 has no e_psi_mse (deployment, identified, heading)" in answer.err


@pytest.mark.parametrize(
    ("text", "values", "expected"),
    [
        ("a=interval(1,3)", {"a": 1.23456789}, "a=1.23457"),
        ("a=int(interval(1,9))", {"a": 4}, "a=4"),
        ("a=range(0,10,3)", {"a": 9}, "a=9"),
        ("a=range(0,0.5,0.1)", {"a": 0.4}, "a=0.4"),
        ("a=x,y", {"a": "y"}, "a=y"),
        ("a=choice([1,2],[3])", {"a": "[3]"}, "a=[3]"),
        ("a=[interval(1,2),7,choice(x,y)]", {"a[0]": 1.5, "a[2]": "x"}, "a=[1.5,7,x]"),
        ("a={b:interval(1,2),c:null}", {"a.b": 2.0}, "a={b:2.0,c:null}"),
    ],
)
def test_parameters_and_overrides(text: str, values: dict[str, Any], expected: str) -> None:
    one = search_space.dimension(OverridesParser.create().parse_override(text))
    space = search_space.distributions([one])
    assert space.keys() == values.keys()
    for name, distribution in space.items():
        assert distribution._contains(distribution.to_internal_repr(values[name]))
    assert one.override(search_space.rounded(values, space)) == expected


def test_a_rounded_value_stays_inside_its_interval() -> None:
    text = "a=interval(0.98765432,1.23456789)"
    space = search_space.distributions(
        [search_space.dimension(OverridesParser.create().parse_override(text))]
    )
    for value in (0.98765432, 1.23456789):
        assert search_space.rounded({"a": value}, space) == {"a": value}
    assert search_space.rounded({"a": 1.11111111}, space) == {"a": 1.11111}


# The ferry's gains under noise and wind, searched within a factor of five of its own.
FERRY = (
    "identifier=none", "disturbance=[noise,wind]",
    "controller.kp=[tag(log,interval(20,500)),tag(log,interval(110,2750)),tag(log,interval(190,4700))]",
    "controller.ki=[tag(log,interval(6,150)),tag(log,interval(6,150)),tag(log,interval(2,50))]",
    "controller.kd=[tag(log,interval(170,4250)),tag(log,interval(180,4450)),"
    "tag(log,interval(370,9250))]",
)  # fmt: skip


@pytest.mark.slow
def test_the_gains_of_the_ferry_are_better_on_seeds_that_were_not_searched(tmp_path: Path) -> None:
    """At least 15 % below the shipped gains, by a search that was killed in between."""
    words = ("-m", "runner", *SEARCH, *FERRY, "seed=0,1", "search.trials=40")
    killed = program(*words, folder=tmp_path)
    wait(lambda: finished(tmp_path) >= 20)
    killed.kill()
    killed.communicate()
    code, out, err = ended(program(*words, folder=tmp_path))
    assert code == 0, err
    query = "SELECT fingerprint, count(*) FROM run WHERE status = 'finished' GROUP BY fingerprint"
    assert {count for _, count in rows(tmp_path, query)} == {1}
    best = shlex.split(out.splitlines()[-1])[3:]
    held_out = [word if not word.startswith("seed=") else "seed=100,101,102" for word in best]
    assert ended(program("-m", "runner", *held_out, folder=tmp_path))[0] == 0
    shipped = ("-m", "identifier=none", "disturbance=[noise,wind]", "seed=100,101,102")
    assert ended(program("-m", "runner", *shipped, folder=tmp_path))[0] == 0
    values = rows(
        tmp_path,
        "SELECT value FROM metric JOIN run ON run.id = run_id WHERE run.seed >= 100 "
        "AND name = 'e_pos_mae' AND model = 'identified' ORDER BY run.id",
    )
    found, own = values[:3], values[3:]
    assert len(own) == 3
    assert max(found)[0] < 0.85 * min(own)[0]  # type: ignore[operator]


@pytest.mark.slow
def test_candidates_side_by_side(tmp_path: Path) -> None:
    """A batch of candidates runs at once in workers, and another start changes nothing."""
    words = (
        "-m", "runner", *SEARCH, "identifier=none", "controller.kp=[interval(50,400),550,940]",
        "seed=0,1", "search.trials=4", "search.batch=2", "hydra/launcher=processes",
    )  # fmt: skip
    code, out, err = ended(program(*words, folder=tmp_path))
    assert code == 0, err
    assert "4 candidates, 4 complete" in out
    assert finished(tmp_path) == 8
    again = ended(program(*words, folder=tmp_path))[1]
    assert finished(tmp_path) == 8
    assert again.splitlines()[2:] == out.splitlines()[2:]
