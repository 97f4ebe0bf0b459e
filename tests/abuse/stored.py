"""Malformed arguments of the comparison, and damaged logbooks."""

import random
import shutil
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from seatrial.runner.compare.formats import Format
from tests.abuse.inputs import NUMBERS, WORDS, texts
from tests.abuse.isolated import Order
from tests.runner.compare import stored

READING = (
    "runs",
    "show",
    "table",
    "plot",
    "metrics",
    "stats",
    "sql",
    "report",
    "export",
    "verify",
    "published",
    "retry",
    "model",
)
QUERIES = (
    *("", ";", "SELECT", "SELECT 1; DROP TABLE run", "DROP TABLE run", "DELETE FROM run", "VACUUM"),
    *("UPDATE run SET seed = 7", "ATTACH DATABASE 'other.db' AS other", "VACUUM INTO 'copy.db'"),
    *("PRAGMA query_only = OFF", "PRAGMA journal_mode = DELETE", "PRAGMA writable_schema = ON"),
    *("SELECT load_extension('x')", "SELECT writefile('x', 'y')", "CREATE TEMP TABLE t (a)"),
    *(
        "SELECT char(27) || '[31m'",
        "SELECT CAST(x'ff' AS TEXT)",
        "SELECT x'00ff'",
        "SELECT char(55296)",
    ),
    "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT count(*) FROM c",
    "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT n FROM c",
    *(
        "SELECT length(zeroblob(2000000000))",
        "SELECT zeroblob(900000000)",
        "SELECT 9e999",
        "SELECT -9e999",
    ),
    *(
        "SELECT 1 AS a, 2 AS a",
        "SELECT " + ",".join("1" * 3000),
        "SELECT " + "(" * 2000 + "1" + ")" * 2000,
    ),
    *(
        "EXPLAIN SELECT 1",
        "SELECT * FROM nothing",
        "SELECT '" + "x" * 100_000 + "'",
        "-- nothing",
        "\udcff",
    ),
)
TERMS = (
    *(
        "identifier",
        "disturbance",
        "seed",
        "none",
        "metric",
        "dof",
        "stage",
        "model",
        "term",
        "plant.scale",
    ),
    *(
        "force_mse",
        "surge",
        "yaw",
        "all",
        "identified",
        "nominal",
        "validation",
        "identifier=none",
        "seed<10",
    ),
    *(
        "seed<1e999",
        "seed<nan",
        "seed=" + "9" * 30,
        "identifier=ls and",
        "(((",
        "seed in (1,2",
        "or",
        "a..b",
    ),
    *(
        "identifier=ls' OR 1=1 --",
        '"run"',
        "config.seed",
        "vessel.dofs",
        "lap",
        "lowpass_hz",
        "mean,std,n,ci",
    ),
)


def make_logbook(folder: Path) -> None:
    """A logbook with every kind of row and series."""
    folder.mkdir()
    with stored.logbook_at(folder) as logbook:
        stored.fill_plain(logbook)
        stored.fill_sailed(logbook)


def digest(folder: Path) -> str:
    """The content of a logbook's file."""
    return sha256((folder / "results.db").read_bytes()).hexdigest()


def _copy(logbook: Path) -> Callable[[Path], None]:
    def prepare(folder: Path) -> None:
        shutil.copytree(logbook, folder / "results")

    return prepare


def _value(name: str, kind: Any) -> st.SearchStrategy[str]:
    """Values for a parameter of the parser, by its kind."""
    if name == "query":
        return st.one_of(st.sampled_from(QUERIES), texts)
    if name == "database":
        return st.sampled_from(ADDRESSES)
    if kind in (int, int | None):
        return st.sampled_from(INTEGERS)
    if kind in (Path, Path | None):
        return st.one_of(st.sampled_from(PATHS), texts)
    if kind is Format:
        return st.one_of(st.sampled_from([form.value for form in Format]), texts)
    return st.one_of(*[st.sampled_from(pool) for pool in (TERMS, TERMS, WORDS, NUMBERS)], texts)


INTEGERS = (*NUMBERS, "3", "7", "10", str(2**64), "-" + "9" * 30, "9" * 5000)
PATHS = (
    *("results", "results/results.db", "a" * 300, "\n", "\x1b[31m", "/dev/full", "/dev/null/x"),
    *("new/folder", "é", "\udcff", "=SUM(A1)", "."),
)
ADDRESSES = (
    *(
        "sqlite:///results/results.db",
        "results/results.db",
        "sqlite:///nothing.db",
        "sqlite://",
        "sqlite:////dev/zero",
    ),
    *(
        "postgresql://me:secret@127.0.0.1:1/none",
        "postgresql://",
        "mysql://a/b",
        "",
        "://",
        "results",
        "/dev/zero",
    ),
    *(
        "sqlite:///results/results.db?mode=rwc",
        "x" * 5000,
        "\x1b[31m",
        "\udcff",
        "postgresql://127.0.0.1:99999/x",
    ),
)


def arguments(logbook: Path) -> st.SearchStrategy[Order]:
    """A command of the comparison with some options, whose values may be anything."""
    from typer.main import get_command

    from seatrial.runner.compare import commands, logbook_commands  # noqa: F401
    from seatrial.runner.compare.cli import app
    from seatrial.runner.compare.figures import figures

    parser: Any = get_command(app)
    kinds = sorted(figures())

    @st.composite
    def draw_order(draw: st.DrawFn) -> Order:
        name = draw(st.sampled_from([*READING, *READING, "prune", "scrub"]))
        words = [name]
        given = [one for one in parser.commands[name].params if one.name != "execute"]
        optional = [
            one for one in given if one.param_type_name == "option" and one.opts != ["--help"]
        ]
        chosen = (
            draw(st.lists(st.sampled_from(optional), max_size=3, unique_by=id)) if optional else []
        )
        for one in chosen:
            words.append(one.opts[0])
            if not one.is_flag:
                words.append(draw(_value(one.name, one.type_descriptor.annotation)))
        for one in given:
            if one.param_type_name == "argument":
                value = (
                    draw(st.sampled_from(kinds))
                    if one.name == "kind" and draw(st.booleans())
                    else draw(_value(one.name, one.type_descriptor.annotation))
                )
                words += [value] if not value.startswith("-") else ["--", value]
        return Order("seatrial-results", tuple(words), _copy(logbook))

    return draw_order()


# Damaged logbooks.

CELLS: tuple[Any, ...] = (
    *(
        "text",
        "",
        "\x1b[31mred",
        "not a date",
        "2026-13-45 99:00:00",
        '{"a":',
        "[]",
        "{}",
        "null",
        "=1+1",
        "x" * 5000,
    ),
    *(
        -1,
        2**63 - 1,
        -(2**63),
        1e300,
        float("inf"),
        b"\x00\xff",
        b"\xff" * 100,
        None,
        0,
        "../../x",
        "/dev/zero",
    ),
)
COMMANDS = (
    *(
        ("runs",),
        ("runs", "--format", "json"),
        ("show", "1"),
        ("show", "2", "--command"),
        ("show", "10", "--traceback"),
    ),
    *(
        ("table",),
        ("table", "--coefficients"),
        ("table", "--rows", "seed", "--columns", "plant.scale"),
        ("verify",),
    ),
    *(
        ("report",),
        ("export", "exported"),
        ("plot", "bars"),
        ("plot", "residual"),
        ("plot", "orders"),
        ("retry",),
    ),
    *(
        ("stats", "1"),
        ("sql", "SELECT * FROM run"),
        ("prune", "--status", "failed", "--yes"),
        ("prune", "--orphans", "--yes"),
    ),
    *(
        ("scrub",),
        ("published", "--summary"),
        ("runs", "--where", "seed<2"),
        ("verify",),
        ("verify",),
    ),
)


def _flip(chance: random.Random, folder: Path) -> None:
    file = chance.choice([folder / "results.db"] * 3 + sorted((folder / "series").iterdir()))
    content = bytearray(file.read_bytes())
    for _ in range(chance.choice((1, 8, 64, 1024))):
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    file.write_bytes(content)


def _cut(chance: random.Random, folder: Path) -> None:
    file = chance.choice([folder / "results.db"] * 3 + sorted((folder / "series").iterdir()))
    content = file.read_bytes()
    kept = chance.choice((0, 1, 15, 16, 100, 4096, len(content) // 2, len(content) - 1))
    file.write_bytes(content[:kept])


def _replace(chance: random.Random, folder: Path) -> None:
    file = chance.choice([folder / "results.db", *sorted((folder / "series").iterdir())])
    file.unlink()
    how = chance.choice(("absent", "folder", "loop", "noise", "beside"))
    if how == "folder":
        file.mkdir()
    elif how == "loop":
        file.symlink_to(file.name)
    elif how == "noise":
        file.write_bytes(chance.randbytes(5000))
    elif how == "beside":
        file.write_text("name,value\n1,2\n")


def _cell(chance: random.Random, folder: Path) -> None:
    with closing(sqlite3.connect(folder / "results.db")) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        names = [
            row[0]
            for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        ]
        for _ in range(chance.choice((1, 1, 5))):
            table = chance.choice([*names, "run", "run"])
            columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
            column, value = chance.choice(columns), chance.choice(CELLS)
            every = "" if chance.random() < 0.5 else "WHERE rowid IN (SELECT max(rowid) FROM run)"
            with suppress(sqlite3.Error, OverflowError):  # a constraint that cannot be left
                connection.execute(f"UPDATE {table} SET {column} = ? {every}", (value,))
            if chance.random() < 0.2:
                with suppress(sqlite3.Error):
                    connection.execute(
                        f"UPDATE {table} SET {column} = CAST(x'ff41' AS TEXT) {every}"
                    )
        connection.commit()


def _schema(chance: random.Random, folder: Path) -> None:
    statements = (
        "INSERT INTO alembic_version VALUES ('0001')",
        "DELETE FROM alembic_version",
        "UPDATE alembic_version SET version_num = 'future'",
        "DROP TABLE metric",
        "DROP TABLE series",
        "DROP TABLE run",
        "CREATE TABLE other (a)",
        "ALTER TABLE run RENAME COLUMN seed TO seeds",
        "PRAGMA user_version = 99",
        "PRAGMA journal_mode = DELETE",
        "DELETE FROM run WHERE id = 1",
        "UPDATE series SET path = '../outside.parquet'",
    )
    with closing(sqlite3.connect(folder / "results.db")) as connection:
        for statement in chance.sample(statements, chance.choice((1, 1, 2))):
            with suppress(sqlite3.Error):
                connection.execute(statement)
        connection.commit()


def _beside(chance: random.Random, folder: Path) -> None:
    (folder / chance.choice(("results.db-wal", "results.db-journal"))).write_bytes(
        chance.randbytes(9000)
    )


DAMAGE = (_flip, _flip, _flip, _cut, _replace, _cell, _cell, _cell, _cell, _schema, _beside)


def damaged(logbook: Path) -> st.SearchStrategy[Order]:
    """A command on a damaged logbook, or the runner with it."""

    def order(
        words: Sequence[str], damage: Callable[[random.Random, Path], None], seed: int
    ) -> Order:
        def prepare(folder: Path) -> None:
            shutil.copytree(logbook, folder / "results")
            damage(random.Random(seed), folder / "results")

        if words[0] == "run":
            return Order("seatrial", tuple(words[1:]), prepare)
        return Order("seatrial-results", tuple(words), prepare)

    runner = ("run", "identifier=none", "evaluation=none", "excitation.interval_s=10")
    commands = st.one_of(
        st.sampled_from(COMMANDS),
        st.sampled_from(COMMANDS),
        st.just(runner),
        st.just((*runner, "dry_run=true")),
    )
    return st.builds(order, commands, st.sampled_from(DAMAGE), st.integers(0, 2**32))
