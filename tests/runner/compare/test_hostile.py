"""Hostile arguments, damaged databases and hostile names: one line or a marked cell each time."""

import csv
import io
import json
import os
import pty
import re
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pyarrow.csv
import pyarrow.parquet
import pytest
from typer.main import get_command

from seatrial.models.findings import Finding
from seatrial.runner.compare import logbook_commands  # noqa: F401 - adds the commands
from seatrial.runner.compare.cli import app
from seatrial.runner.database import Logbook
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.postgres import Postgres

BIG = str(10**30)
ECHOED = re.compile(r"(.)\1{200}")
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
    """One line on stderr at most, nothing that commands a terminal, no long echo."""
    assert code in (0, 1, 2), what
    assert code != 2 or err.count("\n") == 1, (what, err)
    assert not CONTROL.search(out + err), what
    assert not ECHOED.search(err), (what, err)
    assert len(err) <= 4200, what


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
    "run SET config = '{broken'": "run 4, config: got '{broken', expected a JSON object",
    "run SET config = replace(hex(zeroblob(50000)), '00', '[')": "run 4, config: got '[[[",
    "run SET config = '[1]'": "run 4, config: got '[1]', expected a JSON object",
    "run SET versions = '3'": "run 4, versions: got '3', expected a JSON object",
    "run SET overrides = '{}'": "run 4, overrides: got '{}', expected a JSON list",
    "run SET started_at = 'yesterday'": "run 4, started_at: got 'yesterday', expected a time",
    "run SET started_at = x'ff00'": "run 4, started_at: got '\\\\xff\\x00', expected a time",
    "run SET started_at = 5": "run 4, started_at: got '5', expected a time",
    "run SET seed = 'many'": "run 4, seed: got 'many', expected an integer",
    "run SET seed = 1e300": "run 4, seed: got '1.0e+300', expected an integer",
    "run SET duration_s = 'long'": "run 4, duration_s: got 'long', expected a number",
    "run SET vessel = x'fffe'": "run 4, vessel: got '\\\\xff\\\\xfe', expected text in UTF-8",
    "run SET vessel = CAST(x'fffe' AS TEXT)": "run 4, vessel: got '\\\\xff\\\\xfe', expected text",
    "run SET error = x'1b5b', process = x'01'": "run 4, error: got '\\x1b[', expected text",
    "run SET git_dirty = 'maybe'": "run 4, git_dirty: got 'maybe', expected 0 or 1",
    "metric SET value = 'lots'": "value: got 'lots', expected a number",
    "metric SET value = x'00ff'": "value: got '\\x00\\\\xff', expected a number",
    "coefficient SET true_value = 'y'": "true_value: got 'y', expected a number",
}
READERS = [
    *(["runs"], ["show", "4"], ["show", "4", "--command"], ["table"], ["table", "--coefficients"]),
    *(["table", "--where", "plant.scale=0.5"], ["table", "--rows", "plant.scale"], ["stats", "4"]),
    *(["retry"], ["prune", "--where", "id=4"], ["prune", "--older-than", "1d"], ["export", "out"]),
    *(["sql", "SELECT * FROM run"], ["sql", "SELECT * FROM metric"], ["scrub"]),
    *(["plot", "track"], ["report", "--where", "id=4"]),
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
    refusals = []
    for words in READERS:
        code, out, err = program(*words[:1], "--database", damaged, *words[1:])
        refused_or_answered(code, out, err, words)
        refusals += [err] if code == 2 and "damaged: " in err else []
    assert all("verify lists every such cell" in refusal for refusal in refusals)
    if "git_dirty" not in damage:  # any other value counts as true
        assert any(DAMAGES[damage][:30] in refusal for refusal in refusals), refusals


@pytest.mark.parametrize(
    ("statement", "got"),
    [
        ("INSERT INTO seatrial_version VALUES ('0001')", "got 2 rows (0003, 0001)"),
        ("DELETE FROM seatrial_version", "got 0 rows"),
    ],
)
def test_two_version_rows_are_damage(
    program: Program, damaged: Path, statement: str, got: str
) -> None:
    change(damaged, statement)
    for words in (["verify"], ["runs"], ["sql", "SELECT 1"], ["export", "out"]):
        code, out, err = program(*words[:1], "--database", damaged, *words[1:])
        assert (code, out) == (2, "")
        assert f"{got} in seatrial_version, expected 1" in err


def test_json_of_another_shape_is_damage_on_postgresql(program: Program, served_plain: str) -> None:
    import psycopg

    with psycopg.connect(served_plain) as connection:
        connection.execute("UPDATE run SET config = '[1]', started_at = 'infinity' WHERE id = 4")
    code, out, _ = program("verify", "--database", served_plain, "--format", "json")
    assert code == 1
    assert [row["where"] for row in json.loads(out)][:2] == ["run 4, config", "run 4, started_at"]
    for words in (["runs"], ["show", "4"], ["table"], ["report"]):
        refused_or_answered(*program(*words[:1], "--database", served_plain, *words[1:]), words)


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
        *(["runs"], ["show", "1"], ["show", "2"], ["show", "2", "--traceback"], ["retry"]),
        *(["show", "1", "--command"], ["table"], ["table", "--coefficients"], ["verify"]),
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
    forms = ("rich", "md", "csv", "csv-plain", "latex", "json", "html")
    formats = "--format" in {o for one in COMMANDS[words[0]].params for o in one.opts}
    output = [["--output", str(tmp_path)]] if words[0] == "plot" else [[]]
    for more in [["--format", form] for form in forms] if formats else output:
        answer = program(*words[:1], "--database", nasty, *words[1:], *more)
        refused_or_answered(*answer, (words, more))


def test_json_gives_hostile_names_back(program: Program, nasty: Path) -> None:
    _, out, _ = program("runs", "--database", nasty, "--format", "json", "--where", "seed<100")
    assert [row["vessel"] for row in reversed(json.loads(out))] == list(NASTY)


def test_long_names_are_file_names(program: Program, nasty: Path, tmp_path: Path) -> None:
    words = ("--facet", "vessel", "--where", "seed in (2, 4)", "--output", tmp_path)
    code, out, err = program("plot", "bars", "--database", nasty, *words)
    assert code == 0, err
    assert len(out.splitlines()) == 4
    assert all(Path(line).stat().st_size for line in out.splitlines())


def on_terminal(*words: str) -> str:
    """What a terminal gets of a program, with its colours."""
    primary, secondary = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "seatrial.runner.compare", *words],
        stdout=secondary, stderr=secondary, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(secondary)
    received = b""
    while True:
        try:
            part = os.read(primary, 65536)
        except OSError:  # Linux's answer once the other end is closed
            break
        received += part
        if not part:
            break
    os.close(primary)
    assert process.wait(60) in (0, 2)
    return received.decode()


def test_a_terminal_gets_our_colours_and_no_others(nasty: Path) -> None:
    for words in (["runs"], ["show", "2", "--traceback"], ["show", "1"]):
        text = on_terminal(*words, "--database", str(nasty)).replace("\r\n", "\n")
        ours = re.sub(r"\x1b\[(?:0|1)?m", "", text)  # bold, and its end
        assert not CONTROL.search(ours), CONTROL.search(ours)
        assert words[-1] == "--traceback" or text != ours
    assert "\x1b[" in on_terminal("runs", "--help")


def test_formulas_are_quoted_in_csv_and_not_in_csv_plain(program: Program, nasty: Path) -> None:
    listed: dict[str, list[str]] = {}
    for form in ("csv", "csv-plain"):
        _, out, _ = program(
            "sql",
            'SELECT vessel, -seed AS "=x" FROM run WHERE seed IN (0, 1, 7, 13) ORDER BY id',
            "--database", nasty, "--format", form,
        )  # fmt: skip
        header, *rows = csv.reader(io.StringIO(out))
        listed[form] = [header[1], *(row[0] for row in rows)]
        assert [row[1] for row in rows] == ["0", "-1", "-7", "-13"]  # numbers stay numbers
    assert listed["csv-plain"][2:] == ["=cmd|'/C calc'!A0", "-1+2", "@x"]
    assert listed["csv"] == [f"'{t}" if t[0] in "=-@" else t for t in listed["csv-plain"]]


def test_export_quotes_formulas_in_csv_only(program: Program, nasty: Path, tmp_path: Path) -> None:
    names = {}
    for option in ("", "--csv-plain"):
        words = ["export", str(tmp_path / f"out{option}"), *([option] if option else [])]
        assert program(*words, "--database", nasty)[0] == 0
        parse = pyarrow.csv.ParseOptions(newlines_in_values=True)
        table = pyarrow.csv.read_csv(tmp_path / f"out{option}" / "run.csv", parse_options=parse)
        names[option] = table["vessel"].to_pylist()[::2]
        columns = pyarrow.parquet.read_table(tmp_path / f"out{option}" / "run.parquet")
        assert columns["vessel"].to_pylist()[::2] == list(NASTY)
    assert names["--csv-plain"] == list(NASTY)
    assert names[""] == [f"'{name}" if name[0] in "=-@\r" else name for name in NASTY]


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
