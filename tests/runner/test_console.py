"""The progress of a sweep comes from the logbook, and is shown as the terminal allows."""

import logging
import logging.config
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.runs import headline
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Results, metric
from seatrial.runner.sweeps import console as progress
from seatrial.runner.sweeps.console import NewWarnings, time_left
from tests.runner.compare.conftest import logbook as logbook
from tests.runner.database.samples import make_start
from tests.runner.programs import ROOT, wait


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path}/results.db"


def test_the_time_left_is_that_of_trials_of_the_same_choices() -> None:
    assert time_left({"auto": 8}, {}, 0.0) is None
    done = {"none": [0.2, 0.2, 0.2], "auto": [6.0, 6.0]}
    assert time_left({"none": 10, "auto": 5}, done, 2.0) == 16  # two workers
    assert time_left({"plsr": 4}, done, 1.0) == 10  # as all did
    assert time_left({"none": 0, "auto": 0}, done, 1.0) == 0


def told(caplog: pytest.LogCaptureFixture, what: str) -> bool:
    """Whether a line begins with `what`."""
    return any(record.getMessage().startswith(what) for record in caplog.records)


def test_it_is_read_from_the_logbook(
    url: str, logbook: LogbookWriter, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(progress, "QUIET_S", 0.1)
    sweep_id = logbook.begin_sweep("sweep", "seatrial -m seed=0,1,2,3", ["seed=0,1,2,3"], 4)
    logbook.finish_run(logbook.begin_run(make_start(0), sweep_id).run_id, Results())
    with caplog.at_level(logging.INFO), progress.shown(url, sweep_id):
        for seed in (1, 2):
            run = logbook.begin_run(make_start(seed), sweep_id)
            if seed == 1:
                logbook.finish_run(run.run_id, Results())
            else:
                logbook.fail_run(run.run_id, "failed", "ValueError", "no wind", None)
        wait(lambda: told(caplog, "run 3 failed"))
    said = [record.getMessage() for record in caplog.records]
    assert " left" not in said[0]  # what was done before it began has no pace
    assert any(line.startswith("run 3 failed (vessel=milliampere") for line in said)
    assert sum(line.startswith("run 3 failed") for line in said) == 1


def test_a_broken_logbook_ends_the_display_not_the_sweep(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO), progress.shown(f"sqlite:///{tmp_path}/none.db", 1):
        wait(lambda: told(caplog, "the progress is no longer shown: "))


@pytest.mark.slow
def test_a_line_on_a_terminal(tmp_path: Path) -> None:
    """A sweep of two trials of no evaluation, with a terminal as its standard error."""
    master, slave = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "100"}
    command = [sys.executable, "-m", "runner", "-m", "identifier=none", "evaluation=none"]
    pipes = {"stdout": subprocess.PIPE, "stderr": slave}
    with subprocess.Popen(
        [*command, "seed=0,1"], cwd=tmp_path, env=environment, text=True, **pipes
    ) as process:
        os.close(slave)
        shown = b""
        while chunk := _read(master):
            shown += chunk
        assert process.stdout is not None
        said = process.stdout.read()
    os.close(master)
    assert process.returncode == 0, shown
    assert b"of 2 done" in shown
    assert said.startswith("sweep 1, 2 runs: 2 finished, 0 failed, 0 diverged\n")


def _read(master: int) -> bytes:
    try:
        return os.read(master, 4096)
    except OSError:  # the other end is closed
        return b""


def test_progress_lines_command_no_terminal_and_are_short(logbook: LogbookWriter) -> None:
    """Names and messages of a logbook that another program has filled."""
    run = logbook.begin_run(make_start(vessel="\x1b[2J\u202egnp")).run_id
    logbook.fail_run(run, "failed", "Bug\x07", "y" * 5000 + "\n\x9b", "trace")
    (summary,) = logbook.runs()
    line = progress.failure(summary)
    assert "vessel=\\x1b[2J\\u202egnp" in line
    assert not set(line) & {"\x1b", "\x9b", "\x07", "\u202e"}
    assert len(line) < 1100
    assert "\n" not in line


def test_runs_of_a_sweep_show_a_warning_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the settings of the program, which Hydra applies again before every job."""
    settings = yaml.safe_load((CONF / "hydra" / "job_logging" / "seatrial.yaml").read_text())
    settings["handlers"]["console"]["stream"] = "ext://sys.stderr"
    root = logging.getLogger()
    before = root.handlers[:], root.level
    NewWarnings.known.clear()
    try:
        for seed in range(2):
            logging.config.dictConfig(settings)
            monkeypatch.setattr(NewWarnings, "trial", f"identifier=ls seed={seed}")
            root.warning("excitation: %s", "v not excited")
            root.warning("excitation: %s", "r not excited")
            root.info("1 of 2 done")
    finally:
        root.handlers[:], root.level = before
        NewWarnings.known.clear()
    lines = [line.partition(" ")[2] for line in capsys.readouterr().err.splitlines()]
    first = "[identifier=ls seed=0] excitation:"
    assert lines == [f"{first} v not excited", f"{first} r not excited", *["1 of 2 done"] * 2]


def test_what_a_trial_came_to(url: str, logbook: LogbookWriter) -> None:
    """Nominal beside identified, at most five lines, a dash where a model was withheld.

    Of what is below the resolution of the metric no digit is shown.
    """
    rows = [metric("e_pos_mae", "deployment", "nominal", "position", 0.25)]
    rows.append(metric("e_pos_mae", "deployment", "identified", "position", float("nan")))
    for model, value in (("nominal", 2.0), ("identified", 3e-9)):
        for dof in ("surge", "sway", "heave", "roll", "pitch"):
            rows.append(metric("velocity_rmse_restarts", "validation", model, dof, value))
    run = logbook.begin_run(make_start())
    logbook.finish_run(run.run_id, Results(rows))
    lines = [line.split() for line in progress.result_of(run.run_id, url)]
    assert lines[0] == ["nominal", "identified"]
    assert lines[1][-2:] == ["0.25", "-"]
    assert [line[-2:] for line in lines[2:]] == [["<", "1e-06"]] * 4


def test_the_lines_after_a_trial_are_those_of_show_and_a_docking_has_its_own(
    url: str, logbook: LogbookWriter
) -> None:
    values = {
        ("e_pos_mae", "position"): 0.3, ("e_psi_mae", "heading"): 2.0,
        ("time_to_berth", "all"): 90.0, ("final_position_error", "position"): 0.01,
        ("smallest_clearance", "all"): 0.2,
        ("final_heading_error", "heading"): 0.5, ("contacts", "all"): 0.0,
    }  # fmt: skip
    rows = [
        metric(name, "deployment", model, dof, value)
        for (name, dof), value in values.items()
        for model in ("nominal", "identified")
    ]
    run = logbook.begin_run(make_start()).run_id
    logbook.finish_run(run, Results(rows))
    lines = progress.result_of(run, url)[1:]
    expected = ["Contacts", "Smallest clearance", "Time to berth", "Final position error"]
    with open_results(url) as results:
        shown = headline(results, run).rows
    assert [row[0].text for row in shown] == [*expected, "Final heading error"]
    names = [(row[0].text, row[3].text) for row in shown]
    for line, (name, nominal) in zip(lines, names, strict=True):
        assert line.strip().startswith(name)
        assert float(line.split()[-2]) == float(nominal)


def test_a_sweep_shows_its_table(url: str, logbook: LogbookWriter) -> None:
    """By the first metric that its own runs have, `none` first; nothing varied, nothing shown."""
    sweep_id = logbook.begin_sweep("sweep", "seatrial -m identifier=ls,none", [], 2)
    for trial, (identifier, error) in enumerate((("ls", 0.5), ("none", 2.0))):
        run = logbook.begin_run(make_start(trial, identifier=identifier), sweep_id)
        row = metric("velocity_rmse_restarts", "validation", "identified", "surge", error)
        logbook.finish_run(run.run_id, Results([row]))
    other = logbook.begin_run(make_start(9))
    row = metric("e_pos_mae", "deployment", "identified", "position", 0.1)
    logbook.finish_run(other.run_id, Results([row]))
    lines = progress.sweep_table(url, sweep_id, ["identifier"])
    assert lines[0].startswith("velocity_rmse_restarts [m/s], surge, validation, identified: mean")
    assert [line.split()[:2] for line in lines if line.startswith((" none", " ls"))] == [
        ["none", "2.000"],
        ["ls", "0.5000"],
    ]
    assert len(lines) <= progress.LISTED
    assert progress.sweep_table(url, sweep_id, []) == []


def test_seeds_without_anything_random_are_one_experiment(url: str, logbook: LogbookWriter) -> None:
    sweep_id = logbook.begin_sweep("sweep", "seatrial -m seed=0,1,2", [], 6)
    for trial in range(6):
        alike = make_start(trial, experiment=f"{trial // 3}", seed=trial % 3)
        run = logbook.begin_run(alike, sweep_id)
        logbook.finish_run(run.run_id, Results(drawn=["weather"] if trial < 3 else []))
    lines = progress.repeated_warnings(url, sweep_id)
    assert lines == [f"  3 runs: {progress.NOT_DRAWN} (1 in all)"]


def test_a_sweep_ends_with_the_warnings_of_several_runs(url: str, logbook: LogbookWriter) -> None:
    told = {"short": 1, "weak\x1b[2J": 3}
    told |= dict.fromkeys("abcd", 2)  # as many as are shown
    sweep_id = logbook.begin_sweep("sweep", "seatrial -m seed=0,1,2", [], 3)
    for trial in range(3):
        run = logbook.begin_run(make_start(trial), sweep_id)
        texts = [text for text, count in told.items() if trial < count]
        rows = [Diagnostic("warning", "all", None, label=text) for text in texts]
        logbook.finish_run(run.run_id, Results(diagnostics=rows))
    lines = progress.repeated_warnings(url, sweep_id)
    assert lines == ["  3 runs: weak\\x1b[2J", *(f"  2 runs: {text}" for text in "abcd")]
