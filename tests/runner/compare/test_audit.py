"""The audit names what misleads in a logbook, and nothing in one that does not."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from seatrial.runner.compare.audit import HEADERS, audit, ranges
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import Scalar, TextTable
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Metric
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program


def store(
    logbook: LogbookWriter, *more: Any, drawn: Sequence[Any] = ("noise",), **choices: Any
) -> int:
    """Store a run of `choices` with metrics, coefficients and diagnostics; returns its number."""
    metrics, *others = more or ([],)
    rows = [stored.force_mse(1.0), *metrics]
    return stored.finish(logbook, stored.start(**choices), rows, *others, drawn=drawn)


def entries(grid: TextTable) -> list[tuple[Scalar, ...]]:
    return [tuple(row[name] for name in HEADERS[:3]) for row in grid.as_records()]


def found(results: Queries) -> list[tuple[Scalar, ...]]:
    return entries(audit(results, None, None))


def validation(name: str, value: float | None, model: str = "identified") -> Metric:
    return Metric("validation", model, "all", name, value, "")


def test_replicates_in_one_cell_are_nothing_to_find(
    logbook: LogbookWriter, results: Queries
) -> None:
    for identifier in ("ls", "iv"):
        for seed in range(5):
            fine = [validation("limited_share_free_run", 0.0)]
            store(
                logbook,
                [*fine, stored.below(0.0), stored.tracking(1.0)],
                identifier=identifier,
                seed=seed,
            )
    grid = audit(results, None, None)
    assert (entries(grid), grid.title) == ([], "checked 10 runs: nothing found")


def test_runs_that_a_cell_would_average_are_named(logbook: LogbookWriter, results: Queries) -> None:
    for vessel, scale in (("milliampere", 0.5), ("milliampere", 0.7), ("supply_vessel", 0.5)):
        store(logbook, vessel=vessel, config={"plant": {"scale": scale}})
    store(logbook, identifier="iv")
    what = "identifier=ls, disturbance=calm: would be averaged over vessel, plant.scale"
    assert found(results) == [("pooled", "1-3", what)]


def test_what_differs_in_the_deployment_alone_is_found_there(
    logbook: LogbookWriter, results: Queries
) -> None:
    for evaluation in ("replay", "waypoints"):
        store(logbook, [stored.deployed("tau_mean_abs", 1.0)], evaluation=evaluation)
    what = "identifier=ls, disturbance=calm: would be averaged over evaluation"
    assert found(results) == [("pooled", "1-2", what)]


def test_versions_of_the_code_are_named(logbook: LogbookWriter, results: Queries) -> None:
    for seed, code in enumerate(("0" * 16, "1" * 16, "1" * 16)):
        store(logbook, seed=seed, code=code)
    what = "identifier=ls, disturbance=calm: computed by 2 versions of the code"
    assert found(results) == [("code", "1-3", what)]


def test_a_model_below_the_true_one_is_named(logbook: LogbookWriter, results: Queries) -> None:
    for seed, dofs in enumerate((("yaw",), (), ("surge", "yaw"))):
        flags = [stored.below(float(dof in dofs), dof) for dof in ("surge", "sway", "yaw")]
        store(logbook, flags, identifier="plsr", seed=seed)
    what = "identifier=plsr: force error below the true plant's in surge, yaw"
    assert found(results) == [("below true model", "1, 3", what)]


def test_a_diverged_validation_is_named(logbook: LogbookWriter, results: Queries) -> None:
    for seed, limited in enumerate((0.4, 0.0, 0.9)):
        rows = [validation(f"limited_share_{name}", limited) for name in ("restarts", "free_run")]
        store(logbook, rows, seed=seed)
    what = "identifier=ls, identified model: restarts, free_run diverged"
    assert found(results) == [("diverged validation", "1, 3", what)]


def test_lost_runs_are_named_by_their_reason(logbook: LogbookWriter, results: Queries) -> None:
    store(logbook, seed=9)
    for seed, error in enumerate(("singular", "singular", "too short")):
        stored.fail(logbook, stored.start(seed=seed), "failed", error)
    stored.fail(logbook, stored.start(seed=5), "diverged", "|r| = 9 rad/s")
    stored.fail(logbook, stored.start(seed=6), "failed", "mended")
    store(logbook, seed=6)
    stored.fail(logbook, stored.start(seed=7), "interrupted", "the process was lost")
    lost = audit(results, None, None).as_records()
    assert [(entry["check"], entry["runs"]) for entry in lost] == [
        ("failed run", "2-4"), ("diverged run", "5"), ("interrupted run", "8"),
    ]  # fmt: skip
    assert lost[0]["what"] == "ValueError: singular"
    assert lost[0]["remedy"] == "show 2 --traceback; retry --status failed"


def test_run_numbers_are_shortened() -> None:
    for runs, text in (([], ""), ([3, 1, 2, 2], "1-3"), ([1, 2, 4, 6, 7], "1-2, 4, 6-7")):
        assert ranges(runs) == text


def test_the_command_line_selects_and_changes_nothing(program: Program, tmp_path: Path) -> None:
    with stored.logbook_at(tmp_path) as logbook:
        for name, tags in (("first", ["old"]), ("second", [])):
            sweep = logbook.begin_sweep(name, "command", [], 2, tags=tags)
            for seed in (0, 1):
                begin = stored.start(seed=seed, disturbance=name)
                stored.finish(logbook, begin, [stored.below(1.0)], drawn=["noise"], sweep=sweep)
            logbook.end_sweep(sweep)
    file = tmp_path / "results.db"
    before = file.read_bytes()

    def runs_of(*words: str) -> list[str]:
        code, out, err = program("audit", "--database", file, "--format", "json", *words)
        assert (code, err) == (0, "")
        return [record["runs"] for record in json.loads(out)]

    assert runs_of() == ["1-4"]
    assert runs_of("--sweep", "second") == ["3-4"]
    assert runs_of("--sweep", "old", "--where", "seed=1") == ["2"]
    assert runs_of("--where", "disturbance=first") == ["1-2"]
    shown = program("audit", "--database", file, "--format", "md", "--sweep", "1")[1]
    assert "| check | runs | what | remedy |" in shown
    assert file.read_bytes() == before
    assert program("audit", "--database", file, "--where", "seed=7")[0] == 2
