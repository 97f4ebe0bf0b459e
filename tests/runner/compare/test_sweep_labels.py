"""Names, tags and notes of sweeps: they select runs, and are shown with them."""

import json
from pathlib import Path

import pytest

from tests.runner.command import Command
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database

SWEEPS = {
    "calm sea": (["thesis", "calm"], "first look", "calm", (0, 1)),
    "noisy": (["thesis"], None, "noise", (0, 1, 2)),
    "sweep": ([], None, "wind", (0,)),
}


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs 1 and 2 of `calm sea`, 3 to 5 of `noisy`, 6 of a sweep without labels."""
    folder = tmp_path_factory.mktemp("labelled")
    with stored.logbook_at(folder) as logbook:
        for name, (tags, note, disturbance, seeds) in SWEEPS.items():
            sweep = logbook.begin_sweep(name, "command", [], len(seeds), tags=tags, note=note)
            for seed in seeds:
                metrics = [stored.force_mse(10.0 + seed)]
                begin = stored.start("ls", disturbance, seed)
                stored.finish(logbook, begin, metrics, drawn=["noise"], sweep=sweep)
            logbook.end_sweep(sweep)
    return folder


def test_sweeps_select_runs(program: Program, labelled: Path) -> None:
    for words, runs in (
        ((), [6, 5, 4, 3, 2, 1]),
        (("--sweep", "all"), [6, 5, 4, 3, 2, 1]),
        (("--sweep", "noisy"), [5, 4, 3]),
        (("--sweep", "3"), [6]),
        (("--sweep", "thesis"), [5, 4, 3, 2, 1]),
        (("--sweep", "calm"), [2, 1]),
        (("--sweep", "thesis", "--where", "seed=1"), [4, 2]),
        (("--where", "sweep='calm sea'"), [2, 1]),
        (("--where", "not sweep in (noisy, sweep) and seed=0"), [1]),
    ):
        _, out, _ = program("runs", *database(labelled), *words, "-f", "json")
        assert [row["run_id"] for row in json.loads(out)] == runs, words


def test_an_unknown_label_is_refused(program: Program, labelled: Path) -> None:
    known = "all, a number or one of calm sea, thesis, calm, noisy, sweep"
    for command in (("runs",), ("table",), ("plot", "bars"), ("report",)):
        said = program(*command, *database(labelled), "--sweep", "thesys")
        message = f"seatrial-results: --sweep: got 'thesys', expected {known}\n"
        assert said == (2, "", message)


def test_runs_are_listed_with_name_and_tags(program: Program, labelled: Path) -> None:
    _, out, _ = program("runs", *database(labelled), "--format", "json")
    shown = [(row["sweep"], row["tags"]) for row in json.loads(out)]
    assert shown == [("sweep", None)] + 3 * [("noisy", "thesis")] + 2 * [
        ("calm sea", "thesis, calm")
    ]


def test_a_table_is_of_all_sweeps_with_the_tag(program: Program, labelled: Path) -> None:
    command = ("table", *database(labelled), "--dof", "surge")
    for words, expected in (
        ((), {"wind": 1}),
        (("--sweep", "thesis"), {"calm": 2, "noise": 3}),
        (("--sweep", "1"), {"calm": 2}),
    ):
        rows = json.loads(program(*command, *words, "--format", "json")[1])
        assert {row["disturbance"]: row["n"] for row in rows} == expected, words
    shown = program(*command, "--format", "md", "--sweep", "thesis")[1]
    assert "5 runs, sweep 1 (calm sea), 2 (noisy)" in shown


def test_a_figure_is_of_the_sweeps_with_the_tag(
    program: Program, labelled: Path, tmp_path: Path
) -> None:
    command = ("plot", "bars", *database(labelled), "-o", tmp_path / "figures")
    assert program(*command, "--sweep", "calm")[0] == 0
    code, _, err = program(*command, "--sweep", "calm", "--where", "disturbance=noise")
    assert (code, "no runs match" in err) == (2, True)


def test_show_and_report_name_the_sweep(program: Program, labelled: Path) -> None:
    out = program("show", 1, *database(labelled), "--format", "csv")[1]
    for text in ("sweep,calm sea", 'tags of the sweep,"thesis, calm"', "note on the sweep,first"):
        assert text in out
    assert "of the sweep" not in program("show", 6, *database(labelled))[1]
    page = labelled / "page.html"
    command = ("report", *database(labelled), "-o", page)
    assert program(*command, "--sweep", "calm")[0] == 0
    text = page.read_text()
    assert "calm sea" in text
    assert "; tags: thesis, calm; first look" in text
    assert program(*command, "--sweep", "sweep")[0] == 0
    assert "tags:" not in page.read_text()


def test_a_table_names_the_runs_that_are_newer_than_its_sweep(
    seatrial: Command, program: Program
) -> None:
    seatrial.pretend()
    table = ("table", "--metric", "force_mse")
    assert seatrial("-m", "seed=0,1").code == 0
    assert program(*table)[2] == ""
    assert seatrial("seed=2").code == 0
    _, out, hint = program(*table)
    assert "2 runs" in out
    assert hint == "1 newer run is of no sweep and left out: --sweep all\n"
    _, out, hint = program(*table, "--sweep", "all")
    assert ("3 runs" in out, hint) == (True, "")
    assert program(*table, "--where", "id=3")[2] == ""
