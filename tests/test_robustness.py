"""The tables of docs/identification.md count what was run."""

import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from docs.robustness import Case, Cells, Outcome, cell, outcomes, page, ratios
from seatrial.runner.compare.frame import open_results
from tests.runner.programs import completed

CASE = Case("ferry", "noise", recorded=False)
SHORT = (
    "vessel=surge_nonlinear", "excitation=multisine", "excitation.length_s=120", "controller=none",
    "disturbance=noise", "evaluation=none", "plant.scale=0.8", "seed=0",
)  # fmt: skip


def outcome(identifier: str, fit: float, *to_none: float, diverged: bool = False) -> Outcome:
    axes = dict(zip(("surge", "sway"), to_none, strict=True))
    return Outcome(CASE, identifier, fit, axes, axes, diverged, 1.0)


def counted(cells: Cells) -> dict[str, list[str]]:
    """The rows of the summary by identifier."""
    lines = [re.split(r" *\| *", line.strip("| ")) for line in cells.summary().splitlines()[2:]]
    return {line[0].strip("`"): line[1:] for line in lines}


@pytest.mark.nightly
def test_two_runs_of_the_command_line_fill_the_tables(tmp_path: Path) -> None:
    words = ("-m", *SHORT, f"results_dir={tmp_path}", "identifier=none,ls")
    assert completed(sys.executable, "-m", "runner", *words).returncode == 0
    with open_results(str(tmp_path / "results.db")) as results:
        none, ls = sorted(outcomes(results), key=lambda one: one.identifier != "none")
        shown = page(results)
    assert none.case == ls.case == Case("surge_nonlinear", "noise", recorded=False)
    assert none.to_none == {"surge": 1.0}
    assert not none.diverged
    # one axis: NRMSE, the error over the spread, in proportion to the error over that of none
    nrmse = [1.0 - one.fit / 100.0 for one in (none, ls)]
    assert ls.to_none["surge"] == pytest.approx(nrmse[1] / nrmse[0], rel=1e-2)
    assert 0.0 < none.seconds < 600.0
    assert "| `none` | 1 | 0 | 0 |" in shown
    assert f"| `ls` | {cell([ls])} |" in shown


def test_worse_on_one_axis_is_worse_than_none_however_good_the_mean() -> None:
    none, own = outcome("none", 50.0, 1.0, 1.0), outcome("ls", 80.0, 0.2, 1.03)
    assert counted(Cells([none, own]))["ls"][1] == "1"
    assert counted(Cells([none, outcome("ls", 80.0, 0.2, 1.01)]))["ls"][1] == "0"


def test_one_diverged_run_counts_but_does_not_move_the_median() -> None:
    lost = Outcome(CASE, "ls", -math.inf, {}, {}, diverged=True, seconds=1.0)
    good = [outcome("ls", 80.0, 0.2, 0.4)] * 2
    assert cell([*good, lost]) == "80.0 · 1/3 · 0.40 · 1.0 s"
    row = counted(Cells([outcome("none", 50.0, 1.0, 1.0), *good, lost]))["ls"]
    assert row[1:3] == ["0", "1"]
    assert cell([lost]) == "- · 1/1 · - · 1.0 s"
    row = counted(Cells([outcome("none", 50.0, 1.0, 1.0), lost]))["ls"]
    assert row[1:4] == ["1", "1", "0 (0 %)"]


def test_the_best_single_identifier_is_not_auto_itself() -> None:
    found = [outcome("none", 50.0, 1.0, 1.0), outcome("ls", 80.0, 0.4, 0.4)]
    assert counted(Cells([*found, outcome("auto", 78.1, 0.4, 0.4)]))["auto"][3] == "1 (100 %)"
    assert counted(Cells([*found, outcome("auto", 77.9, 0.4, 0.4)]))["auto"][3] == "0 (0 %)"
    with_better_auto = counted(Cells([*found, outcome("auto", 95.0, 0.1, 0.1)]))
    assert with_better_auto["ls"][3] == "1 (100 %)"


def test_axes_of_recordings_are_counted_against_both() -> None:
    recorded = replace(CASE, name="random-1", recorded=True)
    run = replace(outcome("ls", 10.0, 0.5, 0.9), case=recorded, to_mean={"surge": 2.0, "sway": 0.5})
    assert "| `ls` | 2, 1 of 2 |" in Cells([run]).recordings()
    assert Cells([outcome("ls", 10.0, 0.5, 0.9)]).recordings() == ""


def test_ratios_of_errors() -> None:
    spread = {"surge": 1.0, "sway": 1.0}
    assert ratios({"surge": 0.2, "sway": 0.1}, {"surge": 0.1, "sway": 0.2}, spread) == {
        "surge": 2.0, "sway": 0.5,
    }  # fmt: skip
    # neither is worse where both are negligible beside the motion
    assert ratios({"surge": 9e-4}, {"surge": 1e-9}, {"surge": 1.0}) == {"surge": 1.0}
    # no prediction is worse than any; better than a model without one
    assert ratios({}, {"surge": 0.1}, {"surge": 1.0}) == {"surge": math.inf}
    assert ratios({"surge": 0.1}, {}, {"surge": 1.0}) == {"surge": 0.0}
