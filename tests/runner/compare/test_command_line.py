"""The commands from the outside: output, exit codes, errors of one line, and speed."""

import json
import os
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from seatrial import __version__
from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.compare.cli import axes_of
from seatrial.runner.compare.runs import repeat_command
from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.engine import file_url, parse
from tests.runner.command import Command
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program


def database(folder: Path) -> tuple[str, str]:
    return "--database", f"sqlite:///{folder}/results.db"


def test_runs_lists_the_newest_first_and_failures_too(program: Program, plain: Path) -> None:
    code, out, _ = program("runs", *database(plain), "--format", "json")
    listed = json.loads(out)
    assert code == 0
    assert [run["run_id"] for run in listed] == list(range(17, 0, -1))
    assert sum(run["status"] == "failed" for run in listed) == 1
    code, out, _ = program("runs", *database(plain), "--where", "identifier=ls", "--limit", "2")
    assert (code, out.count("ls")) == (0, 2)
    assert "the newest 2; --limit shows more" in out


def test_show_tells_all_about_a_run_and_begins_with_what_came_of_it(
    program: Program, plain: Path
) -> None:
    code, out, _ = program("show", "4", *database(plain))
    assert code == 0
    for told in ("0123456789abcdef with uncommitted changes", "plant.scale", "force_mse", "u_dot"):
        assert told in out
    assert out.startswith("run 4, finished: ")
    places = [out.index(f"\n{title}\n") for title in ("metrics", "coefficients", "configuration")]
    assert places == sorted(places)
    code, out, _ = program("show", "4", *database(plain), "--format", "json")
    metrics = next(part for part in json.loads(out) if part and "stage" in part[0])
    assert metrics[0]["value"] == 50.0
    assert program("show", "latest", *database(plain))[1].startswith("run 17, ")


def test_show_traceback_of_a_failed_run_and_of_a_finished_one(
    program: Program, plain: Path
) -> None:
    for run, said in (("14", "Traceback: here"), ("1", "run 1 is finished: no traceback")):
        assert program("show", run, *database(plain), "--traceback")[1].startswith(said)


def test_show_command_repeats_the_run_into_the_same_logbook(program: Program, plain: Path) -> None:
    _, out, _ = program("show", "4", *database(plain), "--command")
    assert shlex.split(out) == [
        *("python", "-m", "runner", "identifier=ls", "seed=0"),
        *(f"results_dir={plain}", "rerun=true"),
    ]


def test_repeat_command_replaces_places_and_quotes_what_needs_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    overrides = ["seed=1", "results_dir=/elsewhere", "database=postgresql", "rerun=false"]
    here, odd = (
        parse(file_url(tmp_path / name)) for name in ("results/results.db", "my runs/it's.db")
    )
    assert repeat_command(overrides, here, rerun=False) == "python -m runner seed=1"
    assert shlex.split(repeat_command([], odd, rerun=False))[3:] == [
        "results_dir='my runs'",
        "database.url='sqlite:///my runs/it\\'s.db'",
    ]
    server = parse("postgresql://me@host/db")
    words = shlex.split(repeat_command(overrides, server, rerun=True))
    kept = ["seed=1", "results_dir=/elsewhere"]
    assert words[3:] == [*kept, "database.url='postgresql://me@host/db'", "rerun=true"]
    secret = replace(server, url=server.url.set(password="anchor"))
    assert shlex.split(repeat_command(overrides, secret, rerun=False))[3:] == [
        *kept, "database=postgresql"
    ]  # fmt: skip


def test_table_and_sql_speak_every_format(program: Program, plain: Path) -> None:
    query = "SELECT identifier, count(*) AS n FROM run GROUP BY identifier ORDER BY n"
    for form in ("rich", "md", "csv", "latex", "json"):
        for words in (("sql", query), ("table",)):
            code, out, _ = program(*words, *database(plain), "--format", form)
            assert (code, "plsr" in out) == (0, True), (words, form)
    _, out, _ = program("sql", query, *database(plain), "--format", "csv")
    assert out.splitlines()[:2] == ["identifier,n", "plsr,5"]


REFUSED = (
    (["runs", "--database", "sqlite:///nowhere/results.db"], "there is no logbook"),
    (["runs", "--database", "mysql://host/name"], "unknown database dialect"),
    (["runs", "--database", "garbage://"], "unknown database dialect"),
    (["table", "--metric", "speed"], "no metric 'speed', expected one of below_true_model"),
    (["table", "--metric", "force_ms"], "no metric 'force_ms', did you mean force_mse"),
    (["table", "--where", "seed>99"], "no runs match"),
    (["table", "--where", "1=1"], "cannot read"),
    (["table", "--format", "pdf"], "--format: got 'pdf', expected one of rich, md, csv, latex"),
    (["table", "--nonsense"], "unknown flag --nonsense, did you mean --baseline?"),
    (["runs", "--limit", "0"], "--limit: got '0', expected a number greater than or equal to 1"),
    (["runs", "--limit", "x"], "--limit: got 'x', expected an integer"),
    (["sql", "SELECT 1", "--timeout", "x"], "--timeout: got 'x', expected a number"),
    (["runs", "--status", "lost"], "expected one of running"),
    (["show", "99"], "there is no run 99"),
    (["show", "first"], "RUN: got 'first', expected the number of a run, or latest"),
    (["show"], "RUN is missing"),
    (["plot", "pie"], "plot: got 'pie', expected one of bars, "),
    (["plot", "barz"], "plot: got 'barz', did you mean bars? expected one of "),
    (["plot", "controllers"], "controllers is gone: use plot response --rows controller"),
    (["plot", "track", "--band", "90"], "--band: not an option of this figure, expected --run"),
    (["plot", "track"], "no finished run that matches has a series"),
    (["plot", "orders"], "has the diagnostic order_mse"),
    (["plot", "pareto"], "has the diagnostic pareto_objective"),
    (["plot", "bars", "--metric", "speed"], "no finished run has speed"),
    (["plot", "bars", "--metric", "force_ms"], "identified; did you mean force_mse? metrics are "),
    (["plot", "bars", "--facet", "weather"], "'weather' is not known"),
    (["plot", "residual", "--run", "99"], "no runs match"),
    (["plot", "residual", "--run", "5"], "run 5 has no series residual"),
    (["sql", "DELETE FROM run"], "sql: "),
    (["tables"], "no command 'tables', did you mean 'table'?"),
    (["list"], "no command 'list', did you mean 'runs'?"),
    (["help"], "no command 'help', did you mean '--help'?"),
    (["published", "--summary"], "published is gone: in a checkout, use make published"),
    (["runs", "-f", "csv-plain"], "csv-plain is gone: use csv"),
    (["runs", "--tag", "x"], "--tag is gone: use --sweep"),
    (["table", "--interval", "bootstrap"], "--interval is gone: intervals are those of Student"),
    (["plot", "bars", "--metric", "speed", "--output", "stats"], "no finished run has speed"),
    (["manoeuvres", "1", "--execution", "order"], "--execution is gone: measures are from"),
)


def test_bad_input_is_one_line_and_exit_code_2(
    program: Program, plain: Path, subtests: pytest.Subtests
) -> None:
    for words, expected in REFUSED:
        where = () if "--database" in words else database(plain)
        with subtests.test(words=words):
            code, out, err = program(*words, *where)
            assert (code, out, err.count("\n")) == (2, "", 1)
            assert err.startswith("seatrial-results: ")
            assert expected in err


def test_an_empty_logbook_says_so(program: Program, tmp_path: Path) -> None:
    stored.logbook_at(tmp_path).close()
    for command in (["runs"], ["table"], ["plot", "bars"]):
        code, _, err = program(*command, *database(tmp_path))
        assert code == 2
        assert "no runs in the logbook yet" in err


def test_rows_and_columns_make_room_for_each_other() -> None:
    for given, expected in (
        ((None, None), ("identifier", "disturbance")),
        (("disturbance", None), ("disturbance", "identifier")),
        ((None, "identifier"), ("disturbance", "identifier")),
        (("vessel", None), ("vessel", "disturbance")),
        ((None, "vessel"), ("identifier", "vessel")),
        (("identifier,disturbance", None), ("identifier,disturbance", "none")),
    ):
        assert axes_of(*given) == expected


def test_help_imports_nothing_slow() -> None:
    code = (
        "import sys, seatrial.runner.compare.__main__ as m; m.run(['table', '--help']);"
        "slow = {'numpy', 'scipy', 'sqlalchemy', 'matplotlib', 'pyarrow', 'pandas', 'jinja2',"
        "'hydra', 'numba', 'sklearn'} & set(sys.modules); sys.exit(str(slow) if slow else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_a_closed_pipe_is_no_error(plain: Path) -> None:
    line = f"{sys.executable} -m runner.compare runs --database {plain}/results.db | head -1"
    done = subprocess.run(line, shell=True, capture_output=True, text=True, env=dict(os.environ))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_the_command_that_show_prints_repeats_the_run_to_the_last_digit(
    program: Program, tmp_path: Path
) -> None:
    trial = [sys.executable, "-m", "runner", "identifier=plsr", "disturbance=noise", "seed=3"]
    subprocess.run([*trial, f"results_dir={tmp_path}"], check=True, capture_output=True)
    _, line, _ = program("show", "1", *database(tmp_path), "--command")
    command = shlex.split(line)
    assert command[0] == "python"
    subprocess.run([sys.executable, *command[1:]], check=True, capture_output=True)
    query = (
        "SELECT stage, model, dof, name, value FROM metric "
        "WHERE run_id = {} AND name NOT LIKE 'step_time%' ORDER BY 1, 2, 3, 4"
    )
    first, second = (
        program("sql", query.format(run), *database(tmp_path), "--format", "json")[1]
        for run in (1, 2)
    )
    assert len(json.loads(first)) > 30
    assert first == second


def test_show_says_what_the_recording_can_tell_apart(program: Program, sailed: Path) -> None:
    code, said, _ = program("show", "1", *database(sailed))
    assert code == 0
    rows = [line.split() for line in said.splitlines() if "inseparable_terms" in line]
    assert rows == [["inseparable_terms", "surge", "2.000", "u", "|u|u"]]


def test_show_says_how_uncertain_predictions_are_or_why_it_is_not_known(
    program: Program, logbook: LogbookWriter, folder: Path
) -> None:
    said = [
        Diagnostic("model_error_lambda", "all", 0.0425),
        Diagnostic("no_band", "all", 1.0, label="models drawn about it diverge"),
        Diagnostic("condition_number", "all", 17.0),
    ]
    stored.finish(logbook, stored.start("ls", "calm"), diagnostics=said)
    code, shown, _ = program("show", "1", *database(folder))
    assert code == 0
    assert "0.0425" in shown
    assert "models drawn about it diverge" in shown
    assert "condition_number" not in shown


def test_version_is_that_of_the_project(seatrial: Command, program: Program) -> None:
    version = f"{__version__} (checkout)\n"
    answer = seatrial("--version")
    assert (answer.code, answer.out, answer.err) == (0, f"seatrial {version}", "")
    assert program("--version") == (0, f"seatrial-results {version}", "")


def test_trials_that_never_started_are_listed(
    program: Program, logbook: LogbookWriter, folder: Path
) -> None:
    begins = [stored.start("ls", "noise", seed) for seed in range(3)]
    sweep = logbook.begin_sweep("night", "command", [], 3, trials=stored.planned(begins))
    stored.finish(logbook, begins[0], [stored.tracking(1.0)], sweep=sweep)
    words = ("runs", "--status", "not started", *database(folder), "--format", "json")
    code, out, _ = program(*words)
    assert code == 0
    waiting = [(row["identifier"], row["seed"]) for row in json.loads(out)]
    assert waiting == [("ls", "1"), ("ls", "2")]
    code, _, err = program(*words, "--where", "seed=0")
    assert (code, len(err.splitlines())) == (2, 1)
