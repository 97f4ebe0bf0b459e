"""Odd names, numbers beyond a column, damaged cells: readable output or one line each time."""

import csv
import io
import json
import re
from pathlib import Path

import pytest

from seatrial.models.diagnostics import Diagnostic
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program

CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]")
NAMES = (
    *("Ny-Ålesund", "船 1", "two words", "O'Hara", 'the "old" hull', "a,b;c", "R&D <5 kn>", "50 %"),
    *("$5 hull", "x_1^2", "{draft}", "C:\\new\\table", "../up/a:b", "#3", "[/bold]", "null"),
    *("=1+1", "-2", "line\nbreak", "tab\tstop", "\x1b[31mred\x1b[0m", " ", "long " * 200),
)


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A logbook with these names of vessels, identifiers, options, terms and messages."""
    folder = tmp_path_factory.mktemp("named")
    with stored.logbook_at(folder) as logbook:
        for seed, name in enumerate(NAMES):
            config = {f"odd {name}": name}
            begin = stored.start(name, name, seed, vessel=name, config=config, overrides=[name])
            terms = [stored.coefficient(name, 1.0, 0.1, 1.0)]
            warnings = [Diagnostic("warning", "all", None, label=name)]
            stored.finish(logbook, begin, [stored.force_mse(1.0 + seed)], terms, warnings)
            stored.fail(logbook, stored.start(name, name, 100 + seed, vessel=name), error=name)
    return folder / "results.db"


@pytest.mark.parametrize("form", ["rich", "json"])
def test_odd_names_command_no_terminal(program: Program, named: Path, form: str) -> None:
    for words in (["runs"], ["show", "1"], ["table"], ["table", "--coefficients"],
                  ["table", "--rows", "vessel"], ["sql", "SELECT * FROM run"]):  # fmt: skip
        code, out, err = program(*words, "--database", named, "--format", form)
        assert (code, CONTROL.search(out + err)) == (0, None), (words, err)


def test_json_and_csv_give_the_names_back(program: Program, named: Path) -> None:
    query = ("sql", "SELECT vessel FROM run WHERE seed < 100 ORDER BY id", "--database", named)
    _, out, _ = program(*query, "--format", "json")
    assert [row["vessel"] for row in json.loads(out)] == [*NAMES]
    _, out, _ = program(*query, "--format", "csv")
    (_, *rows) = csv.reader(io.StringIO(out, newline=""))
    texts = [row[0].removeprefix("'").replace("\\x1b", "\x1b") for row in rows]
    assert texts == [*NAMES]


@pytest.mark.slow
def test_odd_names_are_drawn_and_are_names_of_files(
    program: Program, named: Path, tmp_path: Path
) -> None:
    """Each in its own figure; and a report, whose names are text and no marks."""
    words = ("--facet", "vessel", "--where", "seed in (6, 8, 10, 12, 18, 22)")
    code, out, err = program("plot", "bars", "--database", named, *words, "--output", tmp_path)
    assert code == 0, err
    assert len({Path(line).resolve() for line in out.splitlines()}) == 2 * 6  # PNG and SVG
    assert all(Path(line).parent == tmp_path and Path(line).exists() for line in out.splitlines())
    page = tmp_path / "report.html"
    code, _, err = program("report", "--database", named, "--where", "seed=6", "--output", page)
    assert (code, err) == (0, "")
    text = page.read_text(encoding="utf-8")
    assert "R&amp;D &lt;5 kn&gt;" in text
    assert "<5 kn>" not in text
