"""Laws of the leaderboard: who is first, who is not told apart from it, what a case counts."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from seatrial.runner.compare.benchmark import Score, cells, task_of
from seatrial.runner.compare.leaderboard import Board
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program

TASK = """
title: {name}
trial: [vessel={name}, evaluation=none]
cases: {{{cases}}}
outputs: [surge]
horizons_s: [1]
score: {score}
seeds: {seeds}
entrants: {{{entrants}}}
"""
MEASURED = np.tile([1.0, -1.0], 30)  # m/s, of deviation 1: the mean motion has an NRMSE of 1
T = 1.0 * np.arange(len(MEASURED))
FIRST, RIVALS = 2, 5  # columns of the summary
Losses = Sequence[Sequence[float | None]]  # by case and seed; None: the run failed


def store(name: str, losses: Mapping[str, Losses], score: str = "free_run") -> None:
    """Run a task in which entrants reach an NRMSE; that over 1 s is one less that."""
    cases_of, *_ = losses.values()
    labels = ("calm", "noise", "wind")[: len(cases_of)]
    text = TASK.format(
        name=name, score=score, seeds=len(cases_of[0]),
        cases=", ".join(f"{label}: {{options: [disturbance={label}]}}" for label in labels),
        entrants=", ".join(f"{entrant}: [identifier={entrant}]" for entrant in losses),
    )  # fmt: skip
    file = Path("conf", "benchmark", f"{name}.yaml")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    values = [loss for own in losses.values() for of_case in own for loss in of_case]
    with stored.logbook_at(Path()) as logbook:
        for cell, loss in zip(cells(task_of(name)), values, strict=True):
            begin = stored.start(
                cell.entrant, cell.case, cell.seed, vessel=name, overrides=cell.options
            )
            if loss is None:
                stored.fail(logbook, begin)
                continue
            columns = {"t": T, "start": 1.0 * (T == 0.0), "surge": MEASURED}
            columns["surge_identified"] = MEASURED + loss
            columns |= {"sway": 0.0 * T, "x": 0.5 * MEASURED, "y": 0.0 * T, "psi": 0.0 * T}
            columns["x_identified_1s"] = np.where(T > 0.0, columns["x"] + loss, np.nan)
            columns["y_identified_1s"] = np.where(T > 0.0, 0.0, np.nan)
            columns["surge_identified_1s"] = np.where(T > 0.0, MEASURED + 1.0 - loss, np.nan)
            stored.finish(logbook, begin, series=[stored.series("prediction", columns)])


@pytest.fixture
def shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: Program) -> Callable[..., str]:
    """What `leaderboard` prints, in Markdown, of the tasks that a test stores."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> str:
        named = [
            word for file in Path("conf/benchmark").iterdir() for word in ("--task", file.stem)
        ]
        words = ("leaderboard", "--database", "sqlite:///results.db", "-f", "md", *named, *words)
        code, out, _ = program(*words)
        assert code == 0
        return out

    return call


def rows(text: str) -> dict[str, list[str]]:
    """Cells of the rows of a table in Markdown, by the first one."""
    lines = [line[2:-2].split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return {cells[0].strip("*"): cells for cells in lines}


def test_ranks_decide_from_the_number_of_cells_at_which_they_can(shown: Callable[..., str]) -> None:
    """Better in all of five cells has a p of 2 / 2^5: there the errors are drawn again instead.

    In one of six cells the better entrant loses, which ranks take for chance and errors do not.
    """
    store("five", {"ls": [[0.1] * 5], "ridge": [[0.5] * 5]})
    store("six", {"ls": [[0.1] * 5 + [0.5]], "ridge": [[0.5] * 5 + [0.4]]})
    found = rows(shown("--summary"))
    assert {name: found[name][FIRST] for name in ("five", "six")} == {"five": "ls", "six": "ls"}
    assert {name: found[name][RIVALS] for name in ("five", "six")} == {"five": "–", "six": "ridge"}


def test_runs_of_another_folder_of_data_count_also_where_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: Program
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SEATRIAL_DATA", "/data/of/another")
    task = task_of("blueboat")
    (cell,) = cells(task, ["none"])
    assert cell.lacking
    columns = {"t": T, "start": 1.0 * (T == 0.0)}
    for dof in task.outputs:
        columns |= {dof: MEASURED, f"{dof}_identified": MEASURED + 0.5}
    with stored.logbook_at(Path()) as logbook:
        begin = stored.start("none", vessel="blueboat", overrides=cell.options)
        stored.finish(logbook, begin, series=[stored.series("prediction", columns)])
    monkeypatch.delenv("SEATRIAL_DATA")
    words = ("leaderboard", "--database", "sqlite:///results.db", "-f", "md", "--task", "blueboat")
    assert rows(program(*words)[1])["none"][FIRST].strip("*") == "50.0"


def test_a_case_counts_once_by_the_median_over_its_seeds(shown: Callable[..., str]) -> None:
    """One seed of three that goes astray decides nothing between entrants over several tasks."""
    for name in ("one", "other"):
        store(name, {"ls": [[0.1, 0.1, 9.0]] * 2, "ridge": [[0.2, 0.2, 0.2]] * 2})
    store("third", {"ls": [[0.1]], "iv": [[0.2]]})  # of other entrants: not ranked together
    ranks, said = "ls 1.0, ridge 2.0, mean_motion 3.0, persistence 4.0", shown("--summary")
    assert f"mean ranks over 4 cases of one; other: {ranks}" in said
    assert said.count("mean ranks") == 1


@pytest.mark.parametrize(
    ("losses", "first"),
    [
        ({"ls": 0.9}, "ls"), ({"ls": 1.1}, "ls (no skill)"), ({"ls": 1.0}, "ls (no skill)"),
        ({"ls": 0.5, "none": 0.6}, "ls"), ({"ls": 0.5, "none": 0.5}, "ls (no skill)"),
        ({"ls": 0.6, "none": 0.5}, "none (no skill)"),
    ],
)  # fmt: skip
def test_who_is_no_better_than_a_trivial_rival_has_no_skill(
    shown: Callable[..., str], losses: dict[str, float], first: str
) -> None:
    store("task", {name: [[loss] * 2] for name, loss in losses.items()})
    assert rows(shown("--summary"))["task"][FIRST] == first


def test_scores_that_do_not_match_are_no_rivals() -> None:
    """There is no p-value of them, which is not a large one."""
    scores = [Score(np.full((n, 1), 0.1), np.arange(n) == 0, 1) for n in (20, 20, 30)]
    rows = {"entrant": ["ls", "iv", "auto"], "score": scores, "loss": [0.1, 0.1, 0.1]}
    board = Board(task_of("beluga"), pd.DataFrame(rows).assign(task="beluga", case="", seed=0))
    assert board.rivals == ["ls", "iv"]


@pytest.mark.parametrize("cells_lost", [1, 9])
def test_who_lost_every_cell_is_no_rival(shown: Callable[..., str], cells_lost: int) -> None:
    """Not even of another one: that both have no score does not make them equal."""
    store("task", {name: [[None] * cells_lost] for name in ("ls", "ridge")})
    assert rows(shown("--summary"))["task"][RIVALS] == "–"


def test_bold_is_the_best_of_those_that_lost_no_cell(shown: Callable[..., str]) -> None:
    """Not who is merely not significantly worse, nor who is compared with nobody."""
    lost = {"ridge": [[0.3] * 4 + [None]], "iv": [[None] * 5]}
    store("two", {"ls": [[0.1] * 5], "auto": [[0.12] * 3 + [0.09] * 2], **lost})
    store("alone", {"ls": [[0.1] * 5], **lost})
    text = shown()
    assert sum(line.count("**") == 4 for line in text.splitlines() if line.startswith("| ")) == 1
    found = rows(text)
    assert "1 of 5" in found["ridge"]
    assert "5 of 5" in found["iv"]
    summary = rows(shown("--summary"))
    assert (summary["two"][3], summary["two"][RIVALS]) == ("**90.0**", "auto")
    assert summary["two"][RIVALS + 1] == summary["two"][RIVALS + 1].strip("*")
    assert summary["alone"][3] == "90.0"
    assert summary["alone"][RIVALS] == "–"


def test_ranks_know_the_resolution_and_leave_out_who_is_at_rest(shown: Callable[..., str]) -> None:
    """Positions to a nanometre are equal; a task of position has a trivial rival more."""
    store("near", {"ls": [[1e-9] * 5], "ridge": [[3e-9] * 5]}, "position")
    store("other", {"ls": [[0.1]], "ridge": [[0.2]]})
    said = shown("--summary")
    assert said.count("mean ranks over 2 cases") == 1
    assert ": ls 1.2, ridge 1.8" in said


def test_a_task_of_restarts_is_ranked_by_them(shown: Callable[..., str]) -> None:
    """The better the free run of an entrant, the worse it is after a second."""
    losses = {"ls": [[0.1] * 5], "ridge": [[0.4] * 5]}
    store("task", losses, "restarts")
    found = rows(shown("--summary"))["task: FIT after 1 s [%]"]
    assert found[FIRST : FIRST + 2] == ["ridge", "**40.0**"]


def test_a_task_of_position_is_ranked_by_the_distance(shown: Callable[..., str]) -> None:
    """It moves to and fro by 1 m: so far from it is who stays where it was."""
    store("task", {"ls": [[0.1] * 5], "ridge": [[0.4] * 5]}, "position")
    found = rows(shown("--summary"))["task: position error after 1 s [m]"]
    assert found[FIRST : FIRST + 3] == ["ls", "**0.100**", "–"]
    assert found[-1] == "1.00"
    assert rows(shown())["ls"][2] == "**0.100**"
