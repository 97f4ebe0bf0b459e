"""Printed figures beside ours: reading, choosing, judging, showing."""

import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs.published import __main__ as program
from docs.published.figures import objective_figure, times_figure
from docs.published.page import NOTE, published_grid, summary_grids, write_published
from docs.published.printed import (
    COLUMNS,
    Judged,
    Printed,
    interval_of_a_run,
    judged,
    read_folder,
    verdict_of,
)
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.record.rows import Results
from tests.published.conftest import store
from tests.runner.compare import stored
from tests.runner.compare.browsers import check_phone
from tests.runner.compare.conftest import browser as browser

ROOT = Path(__file__).parents[2]
ONE = Printed(
    experiment="mine", document="Somebody (2020)", table="Table 1", page="7", row="with model",
    quantity="MSE", printed=100.0, reference=None, unit="N^2", way="",
    where="identifier=ls", source="metric", stage="validation", model="identified", dof="surge",
    name="force_mse", label="", factor=1.0, compare="lower", statistic="", information="", note="",
)  # fmt: skip
LINE = (
    "Somebody (2020),Table 1,7,with model,MSE,100,,N^2,,identifier=ls,metric,validation,identified,"
    "surge,force_mse,,,lower,,,"
)
EIGENVALUE = {"compare": "one", "printed": 1.0013, "rounding": 0.00005}
CALIBRATED = {"information": "calibrated; a known thruster lag"}
CERTAIN = {"information": "by construction"}


@pytest.mark.parametrize(
    ("changes", "value", "interval", "truth", "verdict"),
    [
        ({}, 90.0, (85.0, 94.0), None, "beaten"),
        ({}, 90.0, (85.0, 96.0), None, "not reproduced"),  # the interval reaches into 5 %
        ({}, 96.0, (96.0, 96.0), None, "reproduced"),
        ({}, 150.0, (99.0, 199.0), None, "reproduced"),
        ({}, 150.0, (99.0, 201.0), None, "not reproduced"),  # wider than the figure itself
        ({"compare": "value"}, 400.0, (-50.0, 850.0), None, "not reproduced"),
        ({"compare": "value"}, 101.0, (-50.0, 252.0), None, "not reproduced"),  # the mean is close
        ({"compare": "value"}, 101.0, (math.nan, math.nan), None, "reproduced"),  # a single run
        ({}, 90.0, (math.nan, math.nan), None, "beaten"),
        ({}, 150.0, (149.0, 151.0), None, "not reproduced"),
        ({"compare": "higher"}, 150.0, (149.0, 151.0), None, "beaten"),
        ({"compare": "higher"}, 50.0, (49.0, 51.0), None, "not reproduced"),
        ({"compare": "value"}, 50.0, (49.0, 51.0), None, "not reproduced"),
        ({"compare": "value"}, 104.0, (104.0, 104.0), None, "reproduced"),
        ({"compare": "truth"}, 61.0, (60.0, 62.0), 60.0, "beaten"),
        ({"compare": "truth"}, 61.0, (10.0, 109.0), 60.0, "reproduced"),  # too wide, and holds 100
        ({"compare": "truth"}, 0.0, (0.0, 0.0), 40.0, "not reproduced"),  # dropped: nearer, wrong
        ({"compare": "truth"}, 0.0, (0.0, 0.0), 0.0, "beaten"),
        ({"compare": "truth"}, 10.0, (9.0, 11.0), 60.0, "not reproduced"),
        ({"compare": "none"}, 10.0, (9.0, 11.0), None, "ours"),
        (EIGENVALUE, 1.00125, (1.0012, 1.0013), None, "reproduced"),
        # 0.1 % of 1, but 77 % of the distance to 1; stable or not, the interval does not say
        (EIGENVALUE, 1.0023, (1.0023, 1.0023), None, "not reproduced"),
        (EIGENVALUE, 1.0013, (0.9990, 1.0036), None, "not reproduced"),
        (CALIBRATED, 50.0, (50.0, 50.0), None, "calibrated"),
        (CALIBRATED, 200.0, (200.0, 200.0), None, "calibrated"),
        (CERTAIN, 50.0, (50.0, 50.0), None, "by construction"),
        (CERTAIN, 100.0, (100.0, 100.0), None, "by construction"),
        (CERTAIN, 200.0, (200.0, 200.0), None, "not reproduced"),  # though it cannot fail
    ],
)
def test_verdicts(
    changes: dict[str, Any], value: float, interval: tuple[float, float], truth: float | None,
    verdict: str,
) -> None:  # fmt: skip
    assert verdict_of(replace(ONE, **changes), value, interval, truth) == verdict


def test_a_lost_run_and_certainty_beat_nothing() -> None:
    better = 90.0, (85.0, 94.0), None
    assert verdict_of(ONE, *better, lost=1) == "not reproduced"
    assert verdict_of(ONE, *better, certain=True) == "by construction"
    assert verdict_of(ONE, 150.0, (149.0, 151.0), None, certain=True) == "not reproduced"


def test_the_interval_holds_one_further_run() -> None:
    """Not the mean of many: of ten runs of one law, an eleventh lies in it in 95 % of all cases."""
    draws = np.random.default_rng(3).normal(7.0, 2.0, (4000, 11))
    ends = np.array([interval_of_a_run(ten) for ten in draws[:, :10]])
    inside = (ends[:, 0] <= draws[:, 10]) & (draws[:, 10] <= ends[:, 1])
    assert np.mean(inside) == pytest.approx(0.95, abs=0.012)
    assert np.all(np.isnan(interval_of_a_run(draws[0, :1])))


@pytest.fixture
def book(tmp_path: Path) -> Path:
    """A logbook whose newest sweep `mine` has ls at 50, 51, 55 and a failed run; an older: 500."""
    for values in ((500.0,), (50.0, 51.0, 55.0)):
        sweep = store(tmp_path, *(
            Results([stored.force_mse(x)], [stored.coefficient("u_dot", 2.0 * x, None, 100.0)])
            for x in values
        ), first_seed=int(values[0]))  # fmt: skip
    with stored.logbook_at(tmp_path) as logbook:
        run = logbook.begin_run(stored.start("ls", seed=99), sweep_id=sweep).run_id
        logbook.fail_run(run, "failed", "ValueError", "broken", "Traceback")
        stored.finish(logbook, stored.start("ls", seed=1), [stored.force_mse(9.0)])  # no sweep
    return tmp_path


@pytest.fixture
def results(book: Path) -> Iterator[Queries]:
    with open_results(f"sqlite:///{book}/results.db") as opened:
        yield opened


@contextmanager
def stored_sweep(folder: Path, *runs: Results) -> Iterator[Queries]:
    """The results of the runs of a sweep `mine`."""
    store(folder, *runs)
    with open_results(f"sqlite:///{folder}/results.db") as results:
        yield results


def test_ours_is_the_mean_over_the_newest_sweep_with_its_interval(results: Queries) -> None:
    (one,) = judged(results, [ONE])
    assert one.value == pytest.approx(52.0)
    half = 4.302652729911275 * math.sqrt(7.0 * (1.0 + 1.0 / 3.0))  # t of 2 degrees, 97.5 %
    assert (one.low, one.high) == pytest.approx((52.0 - half, 52.0 + half))
    assert (one.n, one.lost, one.verdict) == (3, 1, "not reproduced")
    assert one.reason == "1 of 4 runs lack it"
    assert one.ratio == pytest.approx(0.52)


def test_a_median_a_factor_a_reference_and_a_coefficient(results: Queries) -> None:
    (median,) = judged(results, [replace(ONE, statistic="median", factor=10.0)])
    assert median.value == pytest.approx(510.0)
    (reference,) = judged(results, [replace(ONE, printed=None, reference=104.0)])
    assert (reference.verdict, reference.ratio) == ("ours", 0.5)
    mass = replace(ONE, source="coefficient", stage="", name="u_dot", compare="truth")
    (one,) = judged(results, [mass])
    assert one.value == pytest.approx(104.0)
    assert one.verdict == "reproduced"  # printed 100.0 is the truth itself: nothing beats it
    dropped = replace(mass, name="|u|u", printed=7.0)  # not stored: zero
    (one,) = judged(results, [dropped])
    assert (one.value, one.n, one.lost, one.verdict) == (0.0, 3, 1, "not reproduced")
    assert judged(results, [replace(dropped, model="other")])[0].n == 0


def test_two_models_of_one_run_as_a_ratio(tmp_path: Path) -> None:
    pairs = [(8.0, 2.0), (4.0, 2.0), (0.0, 1.0)]
    runs = [[stored.force_mse(a, model="nominal"), stored.force_mse(b)] for a, b in pairs]
    with stored_sweep(tmp_path, *map(Results, runs)) as results:
        (one,) = judged(results, [replace(ONE, model="identified/nominal", printed=0.375)])
    assert one.value == pytest.approx(0.375)  # not the ratio of the means
    assert (one.n, one.lost) == (2, 1)  # over nothing it is not defined


def test_what_cannot_be_answered_says_why(results: Queries) -> None:
    lines = [
        replace(ONE, source="", note="recordings are not public"),
        replace(ONE, where="identifier=plsr"),
        replace(ONE, name="force_mae"),
        replace(ONE, printed=None),
    ]
    found = judged(results, lines)
    verdicts = [one.verdict for one in found]
    assert verdicts == ["not reproducible", "no runs", "not reproduced", "ours"]
    assert found[0].reason == "recordings are not public"
    assert found[1].reason == "python -m runner experiment=mine"
    assert found[2].reason == "none of 4 runs has this figure"
    (other,) = judged(results, [replace(ONE, experiment="hoyer_figure_7_20")])
    assert other.verdict == "no runs"
    assert other.reason.endswith(" --config-dir docs/published experiment=hoyer_figure_7_20")


@pytest.mark.parametrize(
    ("plant", "flag", "verdict"),
    [
        (40.0, 0.0, "beaten"),
        (60.0, 0.0, "below the true model"),
        (40.0, 1.0, "below the true model"),
    ],
)
def test_a_fit_of_the_lag_beats_nothing(
    tmp_path: Path, plant: float, flag: float, verdict: str
) -> None:
    """The plant's own figure or the stored flag says so; for a ratio to the nominal model too."""
    metrics = [stored.force_mse(50.0), stored.force_mse(plant, model="plant"), stored.below(flag)]
    metrics += [stored.force_mse(500.0, model="nominal")]
    with stored_sweep(tmp_path, Results(metrics)) as results:
        ratio = replace(ONE, model="identified/nominal", printed=0.5)
        worse = replace(ONE, printed=30.0)
        found = judged(results, [ONE, ratio, worse])
    assert [one.verdict for one in found] == [verdict, verdict, "not reproduced"]
    assert math.isnan(found[0].low)  # a single run has no interval
    assert math.isnan(found[0].high)


def test_an_order_that_was_not_selected_is_shown_and_judged(tmp_path: Path) -> None:
    """The errors of every order are stored: ours at the printed order, and over the nominal one."""
    orders = [
        Diagnostic("order_mse", "surge", 900.0 / i, "N^2", i=i, label="test") for i in (1, 5, 9)
    ]
    surface = [Diagnostic("surface_mse", "surge", 70.0, "N^2", i=8, j=18, label="test")]
    metrics = [stored.force_mse(600.0, model="nominal"), stored.force_mse(150.0, model="plant")]
    fifth = replace(ONE, source="diagnostic", stage="", model="", name="order_mse", label="5")
    divided = replace(
        fifth, model="/nominal", stage="validation", name="order_mse/force_mse", printed=0.6
    )
    with stored_sweep(tmp_path, Results(metrics, [], [*orders, *surface])) as results:
        lines = [fifth, divided, replace(divided, label="9")]
        fit, ratio, below = judged(results, lines)
        (both,) = judged(results, [replace(fifth, name="surface_mse", label="8,18")])
    assert (fit.value, ratio.value, both.value) == (180.0, 0.3, 70.0)
    assert (ratio.verdict, below.verdict) == ("beaten", "below the true model")


def test_an_interval_wider_than_the_figure_says_so(results: Queries) -> None:
    (one,) = judged(results, [replace(ONE, compare="value", printed=1.0, factor=0.02)])
    assert one.verdict == "reproduced"  # [0.91, 1.17]
    (wide,) = judged(results, [replace(ONE, compare="one", printed=1.01, factor=0.0195)])
    assert wide.verdict == "not reproduced"
    assert wide.reason == "the interval is too wide for the printed figure"


# Reading.


def written(folder: Path, *lines: str, name: str = "mine") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.csv").write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")
    return folder


def test_printed_digits_give_the_rounding(tmp_path: Path) -> None:
    lines = LINE.replace(",100,", ",0.20/0.42,"), LINE.replace(",100,", ",-0.00,")
    ratio, zero = read_folder(written(tmp_path, *lines))["mine"]
    assert ratio.printed == pytest.approx(0.20 / 0.42)
    ends = [(0.20 + i) / (0.42 + j) for i in (-0.005, 0.005) for j in (-0.005, 0.005)]
    assert ratio.rounding == pytest.approx(max(ends) - 0.20 / 0.42, rel=0.02)
    assert ratio.digits == "0.20/0.42"
    assert verdict_of(zero, -0.0049, (-0.0049, -0.0049), None) == "reproduced"
    assert verdict_of(zero, 0.0051, (0.0051, 0.0051), None) == "not reproduced"


def test_tables_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    names = ["mine", "table_4_2", "table_4_10", "table_12"]
    for name in names:
        written(tmp_path, LINE, name=name)
    assert list(read_folder(tmp_path)) == names


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ([LINE.replace(",100,", ",many,")], "mine.csv, line 2: .*'many'"),
        ([LINE, LINE.replace("metric", "guess")], "mine.csv, line 3: source: got 'guess', expect"),
        ([LINE.replace("lower", "least")], "mine.csv, line 2: compare: got 'least', expected"),
        ([LINE + ",more"], "mine.csv, line 2: expected the 21 columns document,"),
        ([LINE[:-1]], "mine.csv, line 2: expected the 21 columns document,"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, lines: list[str], complaint: str) -> None:
    with pytest.raises(ConfigurationError, match=complaint):
        read_folder(written(tmp_path, *lines))


# The command and the page.


Asked = Callable[..., tuple[int, str, str]]


@pytest.fixture
def asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Asked:
    """asked(folder, *words) -> code, output and errors of the command, on printed figures."""

    def run(folder: Path, *words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(program, "read_folder", partial(read_folder, folder))
        options = ["--database", str(tmp_path / "results.db"), *map(str, words)]
        return program.main(options), *capsys.readouterr()

    return run


def test_the_command_prints_and_writes_the_page(book: Path, tmp_path: Path, asked: Asked) -> None:
    calibrated = LINE.replace(",,,lower,,,", ",,,lower,,calibrated,")
    folder = written(tmp_path / "printed", LINE, calibrated, LINE.replace(",100,,", ",,,"))
    page = tmp_path / "page" / "index.html"
    code, out, _ = asked(folder, "--page", page, "--format", "json")
    assert code == 0
    first, second, third = json.loads(out)
    assert (first["printed"], first["ours"], first["verdict"]) == (100.0, 52.0, "not reproduced")
    assert (second["verdict"], second["information"]) == ("calibrated", "calibrated")
    assert (third["printed"], third["ours"], third["verdict"]) == (None, 52.0, "ours")
    text = page.read_text()
    assert "Somebody (2020)" in text
    assert "<svg" in text
    code, out, _ = asked(folder, "--summary", "--format", "csv")
    counted, left_out = (part.splitlines()[1:] for part in out.split("\n\n"))
    assert counted == ["Somebody (2020),Table 1,mine,0,0,1,0,0"]
    assert [line.split(",")[3:5] for line in left_out] == [["calibrated", "1"], ["ours", "1"]]


def test_a_figure_counts_once_and_more_information_apart() -> None:
    lag = {"information": "a known thruster lag"}
    lines = [
        Judged(replace(ONE, digits="100"), "reproduced", ""),
        Judged(replace(ONE, digits="100", way="another method"), "beaten", ""),
        Judged(replace(ONE, digits="100", table="Table 2"), "beaten", ""),  # printed again
        Judged(replace(ONE, digits="7", row="other", **lag), "beaten", ""),
        Judged(replace(ONE, digits="8", row="exact"), "by construction", ""),
    ]
    counted, _ = summary_grids([lines])
    total = [cell.text for cell in counted.rows[-1]]
    assert total == ["all", "", "", "", "1", "", "", "1"]
    assert counted.notes[0] == (
        "2 printed figures are compared: 1 reproduced, 1 with more information; left out of this: "
        "1 by construction"
    )


def test_readme_says_what_the_page_counts() -> None:
    page = (ROOT / "docs" / "published.md").read_text()
    sentence = re.search(r"^\d+ printed figures are compared.*$", page, re.MULTILINE)
    assert sentence is not None
    assert sentence[0] in (ROOT / "README.md").read_text()


def test_what_a_user_gets_wrong_is_one_line(book: Path, tmp_path: Path, asked: Asked) -> None:
    folder, before = written(tmp_path / "printed", LINE), (book / "results.db").read_bytes()
    for words, complaint in (
        (("--experiment", "yours"), "--experiment: got 'yours', expected one of mine"),
        (("--page", book / "results.db"), "got a SQLite database, expected the name of the report"),
    ):
        code, out, err = asked(folder, *words)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert complaint in err
    assert (book / "results.db").read_bytes() == before


def test_figures_of_the_sources(tmp_path: Path) -> None:
    """A bowl whose lowest point of 5 x 4 is i = 3, j = 1; times with and without compilation."""
    bowl = [
        *(Diagnostic("topology_first", "surge", 9.0 + i, "kg", i, label="surge.u_dot")
          for i in range(5)),
        *(Diagnostic("topology_second", "surge", 10.0 * j, "kg/s", j, label="surge.u")
          for j in range(4)),
        *(Diagnostic("topology", "all", 0.1 + (i - 3.0) ** 2 + (j - 1.0) ** 2, "", i, j)
          for i in range(5) for j in range(4)),
    ]  # fmt: skip
    times = [
        Diagnostic(name, "all", first + each * n, "s", i=n, label=way)
        for way, compilation, each in (("without JIT", 0.0, 0.1), ("with JIT", 5.0, 1e-4))
        for name, first in (("prediction_time", compilation), ("prediction_time_compiled", 0.0))
        for n in (1, 10, 100)
    ]
    truth = [stored.coefficient(term, x, None, x) for term, x in (("u_dot", 12.0), ("u", 9.0))]
    config = {"identifier": {"objective": "mae"}}
    sweep = store(tmp_path, Results([], truth, [*bowl, *times]), identifier="grid", config=config)
    with open_results(f"sqlite:///{tmp_path}/results.db") as results:
        panel, _ = objective_figure(results, sweep).axes
        (axes,) = times_figure(results, sweep).axes
    places = {line.get_label(): (line.get_xdata()[0], line.get_ydata()[0]) for line in panel.lines}
    assert places == {"lowest": (12.0, 10.0), "true values": (12.0, 9.0)}
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("surge.u_dot [kg]", "surge.u [kg/s]")
    drawn = [(line.get_label(), line.get_linestyle(), line.get_ydata()[0]) for line in axes.lines]
    assert [drawn[0], drawn[2]] == [("without JIT", "-", 0.1), ("with JIT", "-", 5.0001)]
    assert [(style, first) for _, style, first in (drawn[1], drawn[3])] == [(":", 0.1), (":", 1e-4)]


def test_beaten_is_marked_by_a_sign_that_the_legend_names_and_never_bold() -> None:
    grid = published_grid([Judged(ONE, "beaten", ""), Judged(ONE, "reproduced", "")])
    assert [row[7].text for row in grid.rows] == ["+ beaten", "reproduced"]
    assert not any(cell.bold for row in grid.rows for cell in row)
    assert "+ beaten: the whole interval" in NOTE


def test_the_page_fits_a_phone(browser: Any, results: Queries, tmp_path: Path) -> None:
    page = tmp_path / "published.html"
    write_published(results, [[Judged(ONE, "beaten", ""), Judged(ONE, "reproduced", "")]], page)
    check_phone(browser, page)
