"""Hostile arguments, damaged databases and hostile names: one line or a marked cell each time."""

import csv
import io
import json
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pyarrow.csv
import pyarrow.parquet
import pytest
from typer.main import get_command

from seatrial.models.findings import Finding
from seatrial.runner.compare.cli import app
from seatrial.runner.database import Logbook
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.postgres import Postgres

BIG = str(10**30)
ECHOED = re.compile(r"(.)\1{1000}")
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
COMMANDS: dict[str, Any] = dict(get_command(app).commands)  # type: ignore[attr-defined]
TEXTS = ["", "x" * 5000, "\udcff", "\x1b[31mred", "a\x00b", "'" * 3000, "a," * 3000, ".."]
NUMBERS = [BIG, f"-{BIG}", str(2**63), str(2**31), "-1", "1e400", "nan", "9" * 5000, ""]
CONDITIONS = [
    *(f"id={BIG}", f"seed<{2**63}", f"seed in ({2**62}, {BIG}, 1.5)", "id=-1e999"),
    *(f"attempt={2**40}", f"pid={10**17}", f"plant.scale={BIG}", "duration_s<1e999"),
    *("started_at<9999-12-31T23:59:59", "started_at<0001-01-01T00:00:00+14:00"),
    *("started_at>9999-12-31T23:00:00-14:00", "vessel='\udcff'", f"seed={'9' * 5000}"),
    *(f"vessel='{'x' * 5000}'", f"{'x' * 5000}=1", "not " * 200 + "seed=1"),
    *("plant.scale in (" + "1," * 3000 + "2)", "seed=1" + " and seed=1" * 3000),
]
AGES = ["999999w", "9" * 400 + "d", "٣d", "1e3d", "-1d"]
KINDS = [".x", "a..b", "os", "x." * 2000 + "x"]
BASE = {
    "show": ["1"], "stats": ["1"], "sql": ["SELECT 1"], "plot": ["track"],
    "prune": ["--status", "failed"],
    "report": ["--where", "seed>99"], "export": ["out"], "model": ["1", "--to", "yaml"],
}  # fmt: skip


def values_of(parameter: Any) -> list[str]:
    """Hostile values for one option or argument, by its name and type."""
    special = {"where": CONDITIONS, "older_than": AGES, "kind": KINDS}.get(parameter.name, [])
    kind = getattr(parameter.bare_type, "__name__", "")
    return [*special, *(NUMBERS if kind in ("int", "float") else []), *TEXTS]


def tries() -> Iterator[tuple[str, str]]:
    for name, command in COMMANDS.items():
        for parameter in command.params:
            if not getattr(parameter, "is_flag", False):
                yield name, parameter.name


def refused_or_answered(code: int, out: str, err: str, what: object) -> None:
    """One line on stderr at most, without control characters and without a long echo."""
    assert code in (0, 1, 2), what
    assert code != 2 or err.count("\n") == 1, (what, err)
    assert not CONTROL.search(err), what
    assert not ECHOED.search(err), (what, err)
    assert len(err) <= 1100, what


@pytest.mark.slow
@pytest.mark.parametrize(("command", "option"), list(tries()))
def test_every_option_takes_any_value(
    program: Program,
    plain: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    option: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("http.server.ThreadingHTTPServer.serve_forever", lambda server: None)
    parameter = next(one for one in COMMANDS[command].params if one.name == option)
    for value in values_of(parameter):
        words = (
            [command] if option == "database" else [command, "--database", f"{plain}/results.db"]
        )
        words = [command] if command == "metrics" else words
        if parameter.param_type_name == "argument":
            words += ["--", value]
        else:
            words += [f"{max(parameter.opts, key=len)}={value}", *BASE.get(command, [])]
        refused_or_answered(*program(*words), words)


def test_the_tries_know_every_command(program: Program) -> None:
    _, help_text, _ = program("--help")
    listed = re.findall(r"^\W*([a-z][a-z-]*)  ", help_text.partition("Commands")[2], re.MULTILINE)
    assert set(listed) == set(COMMANDS)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["show", BIG], f"there is no run {BIG}"),
        (["stats", str(2**63)], f"there is no run {2**63}"),
        (["runs", "--limit", BIG], "1000000000"),
        (["plot", "track", "--run", BIG], "no runs match"),
        (["report", "--sweep", BIG], f"--sweep: got '{BIG}'"),
        (["runs", "--where", f"seed={BIG}"], "no runs match"),
        (["plot", ".track"], "or the name of a module"),
    ],
)
@pytest.mark.parametrize("server", [False, True], ids=["sqlite", "postgresql"])
def test_numbers_beyond_64_bits_are_just_not_there(
    program: Program, request: pytest.FixtureRequest, plain: Path,
    words: list[str], expected: str, server: bool,
) -> None:  # fmt: skip
    url = f"sqlite:///{plain}/results.db"
    if server:
        url = request.getfixturevalue("served_plain")
    code, out, err = program(*words[:1], "--database", url, *words[1:])
    assert (code, out) == (2, "")
    assert expected in err


@pytest.fixture
def served_plain(postgres: Postgres, tmp_path: Path) -> str:
    """The small logbook of `plain`, on PostgreSQL."""
    url = postgres.new_database()
    with Logbook.open(url, results_dir=tmp_path) as logbook:
        stored.fill_plain(logbook)
    return url


def test_conditions_beyond_a_column_compare_on_postgresql(
    program: Program, served_plain: str, plain: Path
) -> None:
    for condition in CONDITIONS:
        answers = [
            program("runs", "--database", url, "--where", condition, "--format", "json")
            for url in (served_plain, f"{plain}/results.db")
        ]
        for answer in answers:
            refused_or_answered(*answer, condition)
        if condition.count(" and ") < 1000:  # too deep for SQLite
            assert answers[0][0] == answers[1][0], condition
    everything = program("runs", "--database", served_plain, "--where", f"seed<{BIG}", "-f", "json")
    assert len(json.loads(everything[1])) == 17
    half = program("runs", "--database", served_plain, "--where", "seed<0.5", "-f", "json")
    assert {row["seed"] for row in json.loads(half[1])} == {0}


def test_an_age_beyond_the_calendar_is_older_than_every_run(program: Program, plain: Path) -> None:
    code, out, _ = program("prune", "--older-than", "999999w", "--database", f"{plain}/results.db")
    assert (code, out.splitlines()[0]) == (0, "0 runs with 0 files")


DAMAGES = {  # what is done to run 4, and how `verify` reports it
    "run SET config = replace(hex(zeroblob(50000)), '00', '[')": "table run: damaged: a cell",
    "run SET started_at = 5": "table run: damaged: a cell cannot be read",
    "run SET vessel = CAST(x'fffe' AS TEXT)": "table run: Could not decode to UTF-8",
    "coefficient SET true_value = 'y'": "table coefficient: damaged: a cell cannot be read",
}
READERS = [
    *(["runs"], ["show", "4"], ["table"], ["table", "--coefficients"]),
    *(["table", "--rows", "plant.scale"], ["stats", "4"], ["retry"], ["prune", "--where", "id=4"]),
    *(["sql", "SELECT * FROM metric"], ["plot", "track"], ["report", "--where", "id=4"]),
    ["export", "out"],
]


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    with stored.logbook_at(tmp_path) as logbook:
        stored.fill_plain(logbook)
    return tmp_path / "results.db"


def change(file: Path, statement: str) -> None:
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute(statement)


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_cell_is_one_line_and_verify_reports_it(
    program: Program, damaged: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    monkeypatch.chdir(damaged.parent)
    key = "id" if damage.startswith("run") else "run_id"
    change(damaged, f"UPDATE {damage} WHERE {key} = 4")
    code, out, err = program("verify", "--database", damaged, "--format", "json")
    assert (code, err) == (1, "")
    problems = [": ".join(row.values()) for row in json.loads(out)]
    assert DAMAGES[damage] in "\n".join(problems), problems
    for words in READERS:
        code, out, err = program(*words[:1], "--database", damaged, *words[1:])
        refused_or_answered(code, out, err, words)
    assert code == 2  # of the export, which reads every cell
    assert DAMAGES[damage].rpartition(": ")[2][:20] in err


NASTY = (
    *("\x1b[31mred\x1b]0;title\x07", "=cmd|'/C calc'!A0", "a" * 5000, "\u202egnp.exe", "$\\bad{$"),
    *("[/bold]", "nul\x9bx", "-1+2", "\r over", "x\ny", "<script>", "\\n&%_#", " ", "@x"),
)


@pytest.fixture(scope="module")
def nasty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A logbook whose names, messages and keys are hostile."""
    folder = tmp_path_factory.mktemp("nasty")
    with stored.logbook_at(folder) as logbook:
        for seed, name in enumerate(NASTY):
            begin = stored.start(name, name, seed, name, {f"odd {name}": name}, overrides=[name])
            warning = Finding("warning", "all", None, label=name)
            terms = [stored.coefficient(name, 1.0, 0.1, 1.0)]
            stored.finish(logbook, begin, [stored.force_mse(1.0 + seed)], terms, [warning])
            stored.fail(logbook, stored.start(name, name, 100 + seed, name), error=name)
    return folder / "results.db"


@pytest.mark.parametrize(
    "words",
    [
        *(["runs"], ["show", "1"], ["show", "2"]),
        *(["table"], ["table", "--coefficients"], ["verify"]),
        *(
            ["table", "--rows", "vessel"],
            ["sql", "SELECT * FROM run"],
            ["prune", "--status=failed"],
        ),
        *(
            ["plot", "bars", "--where", "seed in (4, 5)"],
            ["plot", "coefficients", "--where", "seed=4"],
        ),
    ],
)
def test_hostile_names_command_no_terminal(
    program: Program, nasty: Path, tmp_path: Path, words: list[str]
) -> None:
    forms = ("rich", "json", "html")  # the others hold the texts as they are
    formats = "--format" in {o for one in COMMANDS[words[0]].params for o in one.opts}
    output = [["--output", str(tmp_path)]] if words[0] == "plot" else [[]]
    for more in [["--format", form] for form in forms] if formats else output:
        answer = program(*words[:1], "--database", nasty, *words[1:], *more)
        refused_or_answered(*answer, (words, more))
        assert not CONTROL.search(answer[1]), (words, more)


def test_json_gives_hostile_names_back(program: Program, nasty: Path) -> None:
    _, out, _ = program("runs", "--database", nasty, "--format", "json", "--where", "seed<100")
    assert [row["vessel"] for row in reversed(json.loads(out))] == list(NASTY)


def test_long_names_are_file_names(program: Program, nasty: Path, tmp_path: Path) -> None:
    words = ("--facet", "vessel", "--where", "seed in (2, 4)", "--output", tmp_path)
    code, out, err = program("plot", "bars", "--database", nasty, *words)
    assert code == 0, err
    assert len(out.splitlines()) == 4
    assert all(Path(line).stat().st_size for line in out.splitlines())


def test_csv_holds_the_texts_as_they_are(program: Program, nasty: Path, tmp_path: Path) -> None:
    query = "SELECT vessel FROM run WHERE seed IN (1, 7, 9, 13) ORDER BY id"
    _, out, _ = program("sql", query, "--database", nasty, "--format", "csv")
    rows = list(csv.reader(io.StringIO(out, newline="")))
    assert [name for (name,) in rows[1:]] == [NASTY[seed] for seed in (1, 7, 9, 13)]
    assert program("export", tmp_path / "out", "--database", nasty)[0] == 0
    options = pyarrow.csv.ParseOptions(newlines_in_values=True)
    for table in (
        pyarrow.csv.read_csv(tmp_path / "out" / "run.csv", parse_options=options),
        pyarrow.parquet.read_table(tmp_path / "out" / "run.parquet"),
    ):
        assert table["vessel"].to_pylist()[::2] == list(NASTY)


@pytest.mark.parametrize(
    "words",
    [["scrub", "--database", "a"], ["export", "a", "--csv-plain"], ["runs", "-f", "csv-plain"]],
)
def test_what_is_gone_says_so_in_one_line(program: Program, words: list[str]) -> None:
    code, out, err = program(*words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert " is gone: " in err


def test_bytes_and_other_text_in_results_are_marked_cells(program: Program, plain: Path) -> None:
    query = "SELECT x'00ff' AS a, CAST(x'41ff' AS TEXT) AS b, zeroblob(100) AS c, 1e999 AS d"
    code, out, _ = program("sql", query, "--database", f"{plain}/results.db", "--format", "json")
    assert code == 0
    cells = {"a": "(2 bytes) 00ff", "b": "A\\xff", "c": f"(100 bytes) {'00' * 16}…", "d": None}
    assert json.loads(out) == [cells]
    for query in ("SELECT '\udcff'", "SELECT '\x00'", "SELECT 1 AS '\udcff'"):
        refused_or_answered(*program("sql", query, "--database", f"{plain}/results.db"), query)


def test_types_of_postgresql_are_cells(program: Program, served_plain: str) -> None:
    query = (
        "SELECT avg(seed) AS mean, 10::numeric ^ 400 AS large, sum(id) AS total,"
        " '\\x00ff'::bytea AS bytes, now()::date AS day, '1 day'::interval AS span,"
        " ARRAY[now()] AS moments, 'infinity'::float AS inf FROM run WHERE seed < 1"
    )
    code, out, err = program("sql", query, "--database", served_plain, "--format", "json")
    assert code == 0, err
    (row,) = json.loads(out)
    assert (row["mean"], row["large"], row["inf"]) == (0, None, None)
    assert row["bytes"] == "(2 bytes) 00ff"
    assert isinstance(row["total"], int)
